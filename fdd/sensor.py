"""A channel's sensor as the profile describes it: errors, noise, range, counts, current loop."""

from __future__ import annotations

from math import pi
from typing import Annotated

from pydantic import Field, model_validator

from fdd.errors import InputError
from fdd.sections import Section, si

LIVE_ZERO, FULL_SCALE = 4e-3, 20e-3
"""A, the currents at both ends of a transmitter's range (thesis A.1.1; IEC 60381-1)."""


class CurrentLoop(Section):
    """A 4 to 20 mA transmitter over a resistor into a converter (thesis A.1.1, eqs A.1 to A.4).

    `low` and `high` are what it measures at 4 and 20 mA, in the channel's SI unit; all else follows.

    Examples
    --------
    >>> loop = CurrentLoop(low=0.0, high=6.895e6, resistance=499.0)
    >>> f"{loop.sensitivity:.4g} {loop.offset:.4g} {loop.resolution:.4g}"
    '8.636e+05 1.724e+06 263.6'
    """

    low: float
    high: float
    resistance: Annotated[float, si("ohm"), Field(gt=0)]
    converter_range: Annotated[float, si("V"), Field(gt=0)] = 10.0
    """The converter takes ± this voltage."""
    converter_bits: Annotated[int, Field(ge=4, le=32)] = 16
    reversible: bool = False
    """The transmitter is turned round for the other sign (quick couplings, thesis A.1.1), so the log
    holds both: the range ends at the converter's limit on either side, instead of at 0 mA below."""

    @model_validator(mode="after")
    def _rises(self) -> CurrentLoop:
        if self.high <= self.low:
            problem = f"high {self.high:g} (at 20 mA) is not above low {self.low:g} (at 4 mA)"
            raise InputError(problem, mend="give what the transmitter measures at both currents")
        return self

    @property
    def sensitivity(self) -> float:
        """Channel units per volt, eq. A.3."""
        return (self.high - self.low) / ((FULL_SCALE - LIVE_ZERO) * self.resistance)

    @property
    def offset(self) -> float:
        """What is taken off the voltage's reading, eq. A.4: a dead loop (0 mA) shows ``-offset``."""
        return self.sensitivity * LIVE_ZERO * self.resistance - self.low

    @property
    def resolution(self) -> float:
        """One step of the converter in channel units."""
        return abs(self.sensitivity) * 2.0 * self.converter_range / 2.0**self.converter_bits

    @property
    def largest(self) -> float:
        """Reading of the converter's highest code."""
        share = 1.0 - 2.0 ** (1 - self.converter_bits)
        return self.sensitivity * self.converter_range * share - self.offset

    @property
    def smallest(self) -> float:
        """Reading of a dead loop, or the mirror image of `largest` where the transmitter is turned."""
        return -self.largest if self.reversible else -self.offset


class Sensor(Section):
    """One channel as it is measured: value = gain·truth + zero, noise, then rounding."""

    noise: Annotated[float, Field(ge=0)] = 0.0
    """White noise, standard deviation in the channel's SI unit."""
    resolution: Annotated[float, Field(ge=0)] = 0.0
    """Smallest step; where it is not given, that of `lines` or of the `loop`."""
    zero: float = 0.0
    gain: Annotated[float, Field(gt=0)] = 1.0
    low: float | None = None
    high: float | None = None
    bandwidth_hz: Annotated[float | None, Field(gt=0)] = None
    tones: list[tuple[float, float]] = Field(default_factory=list)
    """Pairs of frequency (Hz) and amplitude (SI) that ride on the signal."""
    shaft_orders: list[tuple[float, float]] = Field(default_factory=list)
    """Pairs of order (waves per turn of the pump) and amplitude (SI): vibration that the sensor picks up."""
    lines: Annotated[int | None, Field(gt=0, le=10**9)] = None
    """Lines per turn of a rotary encoder; in quadrature each gives four counts (thesis A.1.2)."""
    loop: CurrentLoop | None = None
    source: str | None = None

    @model_validator(mode="after")
    def _step_follows(self) -> Sensor:
        # Not by assignment, which would validate again without end.
        if self.resolution == 0.0 and self.loop is not None:
            self.__dict__["resolution"] = self.loop.resolution
        elif self.resolution == 0.0 and self.lines is not None:
            self.__dict__["resolution"] = 2.0 * pi / (4 * self.lines)
        return self
