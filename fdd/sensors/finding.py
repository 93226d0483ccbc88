"""What is said of a sensor: the kind of failure, its time, its size and the reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from fdd.faults import fault as catalogue_fault

Kind = Literal[
    "dead",
    "stuck",
    "saturated",
    "out_of_range",
    "spikes",
    "step",
    "slip",
    "supply_loss",
    "noisy",
    "dropout",
    "clipped",
]

FAILING = ("dead", "stuck", "saturated", "out_of_range", "step", "supply_loss", "noisy", "dropout")
"""Kinds that take the channel out of what follows while they last; the others leave it usable."""
CONFIDENCE: dict[str, float] = {
    "dead": 0.99, "stuck": 0.97, "saturated": 0.99, "out_of_range": 0.97, "spikes": 0.98, "step": 0.95,
    "slip": 0.98, "supply_loss": 0.99, "noisy": 0.9, "dropout": 0.99, "clipped": 0.99,
}  # fmt: skip
"""How sure a finding of a kind is: not calibrated. Chance plays no part (see the thresholds); what is left is
that the profile is wrong."""


@dataclass(frozen=True)
class SensorFinding:
    """One failure of one channel.

    Attributes
    ----------
    channel : contract's name; of a lost supply the first of `channels`.
    kind : what it looks like.
    onset_s, until_s : when it began; when the channel was good again, None while it is not, or where the
        kind has no end (a slip stays).
    detected_s : end of the frame in which it was decided.
    confidence : see `CONFIDENCE`.
    size : SI: metres or radians lost by an encoder (sum of magnitudes), pascals of a step, the value of a
        stuck channel, the factor of a noise, seconds lost by a dropout, rows of spikes.
    evidence : one sentence with figures and units.
    count : how many events it sums up.
    channels : all that are concerned.
    """

    channel: str
    kind: Kind
    onset_s: float
    until_s: float | None
    detected_s: float
    confidence: float
    size: float
    evidence: str
    count: int = 1
    channels: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether the sensor is sound: a pressure peak went beyond its range for a moment."""
        return self.kind == "clipped"

    @property
    def fault(self) -> str:
        """The catalogue's id.

        Examples
        --------
        >>> SensorFinding("position", "slip", 1.0, None, 1.5, 0.98, 1e-3, "").fault
        'position_sensor_slip'
        """
        if self.kind in ("slip", "step") and self.channel == "position":
            return catalogue_fault("position_sensor_slip").id
        if self.kind == "step" and self.channel.startswith("pressure"):
            return catalogue_fault("pressure_sensor_bias").id
        return catalogue_fault("sensor_dropout").id

    def to_plain(self) -> dict[str, Any]:
        """JSON-able; `from_plain` reads it."""
        return {**vars(self), "channels": list(self.channels)}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> SensorFinding:
        """What `to_plain` gave."""
        return cls(**{**plain, "channels": tuple(plain["channels"])})
