"""What a diagnosis says: the contract's answer, and the trajectories behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import is_, not_
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

import fdd
from fdd.faults import CATALOGUE, FAMILIES

ESTIMATED: dict[str, tuple[str, str, str]] = {
    "leakage": ("m^3/(s*Pa)", "1e-12 m³/(s·Pa)", "Leakage coefficient"),
    "bulk_modulus": ("Pa", "MPa", "Effective bulk modulus"),
    "coulomb_friction": ("N", "N", "Coulomb friction"),
    "viscous_friction": ("N*s/m", "N·s/m", "Viscous friction"),
}
"""Estimated quantities: SI unit in the answer, unit for people, title."""

DISPLAY_SCALE = {"leakage": 1e12, "bulk_modulus": 1e-6, "coulomb_friction": 1.0, "viscous_friction": 1.0}
is_none = partial(is_, None)


class FaultFinding(BaseModel):
    """One fault that the diagnosis sees (or one ambiguity group of faults)."""

    fault: str
    family: str
    ambiguity: list[str]
    shares: dict[str, float] = Field(default_factory=dict)
    """How likely each of the ambiguity group is, were it one of them; empty where there is but one."""
    confidence: float = Field(ge=0, le=1)
    score: float | None = Field(default=None, exclude_if=is_none)
    """Log likelihood ratio against none, by which it was found; None of what a channel's own watch says."""
    onset_s: float
    detected_s: float
    severity: float | None = None
    evidence: list[str] = Field(default_factory=list)
    severity_interval: tuple[float, float] | None = None
    """80 %."""
    onset_interval: tuple[float, float] | None = None
    """s, 80 %."""
    channel: str | None = None
    side: int | None = None
    variant: str | None = None
    next_check: str | None = None
    """What a technician does to confirm it."""

    @property
    def by_family(self) -> dict[str, float]:
        """Probability that it is of each family that its ambiguity group has."""
        out: dict[str, float] = {}
        for name, share in (self.shares or {self.fault: 1.0}).items():
            family = CATALOGUE[name].family if name in CATALOGUE else self.family
            out[family] = out.get(family, 0.0) + self.confidence * share
        return out


def present(probabilities: Mapping[str, float], faults: Sequence[FaultFinding]) -> dict[str, float]:
    """Probability of each family that it is there: the answer's own add up to one, so that a second fault has
    what the first leaves."""
    out = dict(probabilities)
    for finding in faults:
        out |= {family: max(p, out.get(family, 0.0)) for family, p in finding.by_family.items()}
    return out


class MethodEstimate(BaseModel):
    """A quantity at the end of the log by a further tracker (SI)."""

    value: float
    std: float


class Estimate(BaseModel):
    """A tracked quantity at the end of the log, beside its healthy value (SI).

    Attributes
    ----------
    value, std : what the filter says, observable or not.
    held, held_std : the last value while it was observable, and what its standard deviation has grown to
        since; None where it never was.
    age_s : s since then, 0 while it is observable.
    information_std : standard deviation that the last five seconds alone would give; None without any data.
    held_because : why an estimate that the data hold is not observable; then `held` is the profile's.
    methods : what trackers of installed packages say of it, by name (``fdd diagnose --tracker``).
    """

    unit: str
    baseline: float | None
    value: float | None
    std: float | None
    observable: bool
    held: float | None = None
    held_std: float | None = None
    age_s: float | None = None
    information_std: float | None = None
    held_because: str | None = Field(default=None, exclude_if=is_none)
    methods: dict[str, MethodEstimate] = Field(default_factory=dict, exclude_if=not_)


def no_estimates() -> dict[str, Estimate]:
    """Those of a log of which nothing is known."""
    none = {"baseline": None, "value": None, "std": None, "observable": False}
    return {name: Estimate.model_validate({"unit": si, **none}) for name, (si, _, _) in ESTIMATED.items()}


class Quality(BaseModel):
    """What was missing or odd in the data."""

    dropped_samples: int = 0
    nan_samples: int = 0
    time_jumps: int = 0
    notes: list[str] = Field(default_factory=list)


class SensorState(BaseModel):
    """What a channel is worth, since when."""

    channel: str
    state: str
    since: float | None = None


class Invisible(BaseModel):
    """A fault that this log would not have shown below a severity; None where it shows it at none.

    Attributes
    ----------
    severity : from which on each way in which the fault acts would have shown.
    side, channel, variant : of the way that is hardest to see, where the fault has several.
    hidden : share of such faults that would not have shown, in all their ways and of usual severities.
    """

    fault: str
    severity: float | None
    side: int | None = None
    channel: str | None = None
    variant: str | None = None
    hidden: float | None = None


class SecondOpinion(BaseModel):
    """What a classifier that users trained says of the log; it changes nothing in the rest of the answer.

    Attributes
    ----------
    classifier : its file. target : what it tells: ``family`` or ``fault``. answer : the likeliest, or
        ``healthy``. probability : of that. probabilities : of all that it knows.
    """

    classifier: str
    target: str
    answer: str
    probability: float
    probabilities: dict[str, float]


class Diagnosis(BaseModel):
    """The answer for one log, as ``fdd diagnose --json`` prints it.

    Attributes
    ----------
    started_at : when the log's time was 0 (ISO 8601, UTC), where the log tells. prior : probability of a
        fault before the log was seen, that confidence and verdict rest on. versions : of fdd and model, and
        of packages that added faults or trackers. sha256 : of the files log, map, profile and model, as far
        as they were given. error : of a log among several that could not be read, why; the rest of the answer
        is empty then. second_opinion : of a classifier, where one was asked (``fdd diagnose --classifier``).
    """

    model_config = ConfigDict(populate_by_name=True, json_schema_serialization_defaults_required=True)

    schema_: Literal["fdd.diagnosis/1"] = Field(default="fdd.diagnosis/1", alias="schema")
    log: str
    axis: str
    unit: str
    duration_s: float
    samples: int
    verdict: Literal["healthy", "faulty", "inconclusive"]
    faults: list[FaultFinding]
    probabilities: dict[str, float]
    estimates: dict[str, Estimate]
    quality: Quality
    sensors: list[SensorState] = Field(default_factory=list)
    not_visible: list[Invisible] = Field(default_factory=list)
    prior: float = 0.5
    versions: dict[str, str] = Field(default_factory=dict)
    sha256: dict[str, str] = Field(default_factory=dict)
    started_at: str | None = Field(default=None, exclude_if=is_none)
    error: str | None = Field(default=None, exclude_if=is_none)
    second_opinion: SecondOpinion | None = Field(default=None, exclude_if=is_none)

    @classmethod
    def unreadable(cls, log: str, error: str, sha256: dict[str, str]) -> Diagnosis:
        """The answer for a log that could not be read: whole, and without anything in it.

        Examples
        --------
        >>> answer = Diagnosis.unreadable("a.csv", "a.csv: the file is empty; record or copy it again", {})
        >>> answer.verdict, answer.samples, answer.estimates["leakage"].observable
        ('inconclusive', 0, False)
        """
        return cls(
            log=log, axis="", unit="", duration_s=0.0, samples=0, verdict="inconclusive", faults=[],
            probabilities=dict.fromkeys(FAMILIES, 0.0), estimates=no_estimates(),
            quality=Quality(notes=[error]), versions={"fdd": fdd.__version__}, sha256=sha256, error=error,
        )  # fmt: skip


@dataclass
class Trajectories:
    """Everything over time that the report and the annotated MCAP show.

    Estimates are sampled every few samples (`time`, (n,)), windows at each one's end (`window_time`, (m,)).

    Attributes
    ----------
    estimates, stds : ``{"ekf": {"leakage": (n,), …}, "svsf": {…}}``, SI. observable : ``{"leakage": (n,)
        bool, …}``. held, held_std, information_std : quantity to (n,), of the EKF: the last value while
        observable and its standard deviation, NaN before; the standard deviation that the last seconds alone
        would give. nis : normalised innovation squared of each filter per sample kept, (n,).
    feature_names : (k,) names of the residual features. features : (m, k) how badly each balance closes, in
        what a healthy unit's does.
    statistic, threshold, even : the sequential test's statistic (m,), its threshold for an alarm, and the
        score from which the log in hand is rather faulty than healthy. probabilities : family to (m,).
    """

    time: NDArray[np.float64]
    estimates: dict[str, dict[str, NDArray[np.float64]]]
    stds: dict[str, dict[str, NDArray[np.float64]]]
    observable: dict[str, NDArray[np.bool_]]
    nis: dict[str, NDArray[np.float64]]
    window_time: NDArray[np.float64]
    feature_names: list[str]
    features: NDArray[np.float64]
    statistic: NDArray[np.float64]
    threshold: float
    even: float = np.nan
    probabilities: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    held: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    held_std: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    information_std: dict[str, NDArray[np.float64]] = field(default_factory=dict)
