"""What a data set says of itself and of each log: faults, conditions, and how visible these faults are.

A fault's visibility is that of the log less its twin, which lacks the fault, in standard deviations of noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from fdd.plant import Validated
from fdd.plant.sensors import KNOWN
from fdd.plant.sensors.recording import Recording
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

HEALTHY = "healthy"
RelativePath = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-]+/[A-Za-z0-9_.\-]+$", max_length=200)]
SUMMARISED = (*PRESSURES, "motor_current")
"""Channels of which a log's figure is the largest rms. Encoders count so finely, and travel adds up so far,
that in angle and position any fault would be visible."""
EDGES = (1.0, 3.0, 10.0)
"""Of the largest rms, in standard deviations of noise: visible is a fault from the first one on."""
CLASSES = ("below 1", "1 to 3", "3 to 10", "above 10")
ROWS_LOST = "rows lost"
"""Class of what changes no value by a deviation but takes values out of the log (a loose contact)."""

SEVERAL = "several at once"
"""Where tables go by fault: logs of more than one, of which no difference says which fault made it."""


class ChannelVisibility(Validated):
    """What a log's faults do to a channel.

    Attributes
    ----------
    noise : standard deviation that the others are over, SI unit of the channel.
    rms, peak : of log less twin over the whole log, over `noise`; rows where either is NaN are left out.
    lost : share of the log's rows that are NaN in the log and not in its twin.
    """

    noise: float
    rms: float
    peak: float
    lost: float


class Label(Validated):
    """One injected fault, as the plant labels it; data of versions without laws have none."""

    fault: str
    family: str
    severity: float
    onset_s: float
    profile: str
    side: int | None = None
    variant: str | None = None
    law: str | None = None
    axis: int = 1
    channel: str | None = None


class Conditions(Validated):
    """What a table of results is broken down by."""

    load: str
    duty: str
    control: str
    oil_temperature: float
    charge_factor: float
    seed: int


class Entry(Validated):
    """One log of a data set.

    Attributes
    ----------
    file, truth : paths below the data set's folder.
    base : profile that its unit was varied from.
    structure, condition : of the recipe; empty where it has none.
    fault_scales : figures of severity 1, see `fdd.plant.faults.FaultScales`; empty without structures.
    truth_medians : true leakage (m³/(s·Pa)), bulk modulus (Pa), Coulomb (N) and viscous friction
        (N·s/m): medians while all faults act, or over the log if healthy.
    twin : path of the same log without its faults; None for a healthy log, or where none was made.
    visibility : by channel, with a twin, what the faults do to the log, over the sensor's noise.
    largest_rms, visible : of it, see `fdd.campaign.labels`.
    """

    file: RelativePath
    truth: RelativePath
    unit: str
    base: str
    structure: str = ""
    condition: str = ""
    fault_scales: dict[str, float] = Field(default_factory=dict)
    duration_s: float
    samples: int
    faults: tuple[Label, ...]
    scenario: Conditions
    truth_medians: dict[str, float]
    twin: RelativePath | None = None
    visibility: dict[str, ChannelVisibility] | None = None
    largest_rms: float | None = None
    visible: bool | None = None

    @property
    def healthy(self) -> bool:
        """Whether no fault was injected."""
        return not self.faults

    @property
    def family(self) -> str:
        """Family of the first fault, or ``healthy``."""
        return self.faults[0].family if self.faults else HEALTHY

    @property
    def told(self) -> dict[str, Any]:
        """What tables say of it: file, unit, and the first fault with its severity and onset."""
        lead = self.faults[0] if self.faults else None
        return {
            "file": self.file, "unit": self.unit, "fault": lead.fault if lead else HEALTHY,
            "faults": " ".join(f.fault for f in self.faults) or HEALTHY, "family": self.family,
            "severity": lead.severity if lead else 0.0, "onset_s": lead.onset_s if lead else None,
            "structure": self.structure,
        }  # fmt: skip


class Manifest(Validated):
    """What a data set says of itself; it is written last."""

    schema_: Annotated[Literal["fdd.dataset/1"], Field(alias="schema")]
    name: str
    version: str
    seed: int
    units: int
    number: int
    hours: float
    baselines: dict[str, tuple[RelativePath, ...]]
    sha256: str


def noise_deviation(unit: Unit, channel: str, recording: Recording) -> float:
    """Standard deviation of a channel's noise, SI; 0 for one that is known, not measured.

    White noise, tones (amplitude a: a²/2) and rounding (step q: q²/12; Widrow and Kollár 2008, doi
    10.1017/CBO9780511754661) of the true unit's sensors, as independent. A speed counted from the angle is
    rounded twice. Shaft orders are left out: they belong to the motion.
    """
    if channel in KNOWN:
        return 0.0
    sensor = unit.sensor(channel)
    step = sensor.resolution
    if channel == "pump_speed" and recording.speed == "counts":
        step = max(step, math.sqrt(2.0) * unit.sensor("pump_angle").resolution / recording.period)
    tones = sum(amplitude**2 for _, amplitude in sensor.tones)
    return math.sqrt(sensor.noise**2 + tones / 2.0 + step**2 / 12.0)


def visibility(log: Samples, twin: Samples, unit: Unit, recording: Recording) -> dict[str, ChannelVisibility]:
    """What the faults of a log, of the same rows as its twin, do to each of its channels that has noise."""
    found = {}
    for channel in log.channels:
        noise = noise_deviation(unit, channel, recording)
        if noise > 0.0:
            gone = np.isnan(log[channel]) & ~np.isnan(twin[channel])
            change = log[channel] - twin[channel]
            change = change[~np.isnan(change)] / noise
            rms = np.sqrt(np.mean(change**2)) if change.size else 0.0
            peak = np.abs(change).max(initial=0.0)
            figures = {"noise": noise, "rms": rms, "peak": peak, "lost": gone.mean()}
            found[channel] = ChannelVisibility(**{n: float(f"{v:.6g}") for n, v in figures.items()})
    return found


def largest_rms(found: Mapping[str, ChannelVisibility]) -> float:
    """Largest rms over the pressures and the motor's current, in standard deviations of noise."""
    return max((each.rms for name, each in found.items() if name in SUMMARISED), default=0.0)


def visibility_class(found: Mapping[str, ChannelVisibility]) -> str:
    """One of `CLASSES`, or `ROWS_LOST`."""
    rms = largest_rms(found)
    if rms < EDGES[0] and any(each.lost > 0.0 for each in found.values()):
        return ROWS_LOST
    return CLASSES[int(np.searchsorted(EDGES, rms, side="right"))]
