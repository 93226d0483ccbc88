"""A scenario: everything about one simulated run beside the unit, validated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from fdd.errors import InputError
from fdd.plant.details import Details
from fdd.plant.duty import AnyDuty, ConstantSpeed, Steps
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.load import AnyLoad, NoLoad
from fdd.plant.oil import ATMOSPHERE
from fdd.plant.validated import Validated

MAX_DURATION = 3600.0
"""s; a millisecond takes about 350 bytes while it is simulated."""


class Control(Validated):
    """How the pump speed is commanded.

    Attributes
    ----------
    mode : position (a P loop on the encoder, thesis 7.2) or speed (no feedback).
    gain : (rad/s)/m of the position loop; its command saturates at the drive's largest speed. The
        thesis's ultimate gain is 33750 (section 7.2), that of its linear models ten times as much.
    """

    mode: Literal["position", "speed"] = "position"
    gain: Annotated[float, Field(gt=0.0, le=1e6)] = 16_875.0


class Recording(Validated):
    """How the log is taken.

    Attributes
    ----------
    dropped : probability that a row is missing.
    late : probability that a row is taken late; its stamp says so.
    latest : s, most that it is late.
    nan_bursts_per_minute : bursts of NaN, 5 to 30 rows long, each in one to four channels.
    load_force : whether the load is measured.
    """

    dropped: Annotated[float, Field(ge=0.0, le=0.5)] = 0.001
    late: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0005
    latest: Annotated[float, Field(ge=0.0, le=0.9e-3)] = 0.9e-3
    nan_bursts_per_minute: Annotated[float, Field(ge=0.0, le=60.0)] = 0.2
    load_force: bool = False

    @classmethod
    def perfect(cls) -> Recording:
        """Every row, on time, whole."""
        return cls(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)


class Scenario(Validated):
    """One run.

    Attributes
    ----------
    unit : name of the unit, kept with the data; `simulate` takes the unit itself.
    duration : s, one row per millisecond.
    duty, control, load : what is done, how, and against what.
    oil_temperature, warming : °C at the start, and °C/s from then on.
    charge_factor : accumulator charge (gauge) over the unit's.
    ambient : Pa, absolute pressure around the actuator.
    faults : any number, each kind at most once.
    recording : dropped rows, late stamps, NaN.
    details : of the plant, which no unit profile knows.
    seed : fixes everything random.

    Raises
    ------
    InputError : names the field and what is allowed.

    Examples
    --------
    >>> Scenario(duration=5.0, faults=[{"fault": "aeration", "severity": 0.5, "onset": 2.0}]).faults[0].family
    'aeration'
    """

    unit: str = "axis_a"
    duration: Annotated[float, Field(ge=0.01, le=MAX_DURATION)] = 60.0
    duty: AnyDuty = Steps()
    control: Control = Control()
    load: AnyLoad = NoLoad()
    oil_temperature: Annotated[float, Field(ge=-20.0, le=110.0)] = 40.0
    warming: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    charge_factor: Annotated[float, Field(ge=0.2, le=3.0)] = 1.0
    ambient: Annotated[float, Field(ge=15_000.0, le=120_000.0)] = ATMOSPHERE
    faults: list[FaultSpec] = Field(default_factory=list)
    recording: Recording = Recording()
    details: Details = Details()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    @model_validator(mode="after")
    def _together(self) -> Scenario:
        seen: set[str] = set()
        for spec in self.faults:
            if spec.onset >= self.duration:
                raise InputError(
                    f"fault {spec.fault}: onset {spec.onset:g} s is past the end, {self.duration:g} s",
                    mend="set an earlier onset or a longer duration",
                )
            if spec.fault in seen:
                raise InputError(f"fault {spec.fault} is given twice", mend="give each fault once")
            seen.add(spec.fault)
        if isinstance(self.duty, ConstantSpeed) and self.control.mode != "speed":
            raise InputError(
                "duty constant_speed needs speed control", mend="set control mode to speed, or use strokes"
            )
        final = self.oil_temperature + self.warming * self.duration
        if not -40.0 <= final <= 140.0:
            raise InputError(
                f"the oil would end at {final:.0f} °C", mend="lower warming; -40 to 140 °C is modelled"
            )
        return self

    @property
    def rows(self) -> int:
        """Milliseconds in the run."""
        return max(round(self.duration * 1000.0), 1)
