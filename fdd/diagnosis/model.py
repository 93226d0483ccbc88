"""What was learnt about the balances' evidence: how often healthy hours reach a score, and what a score is
worth. It is small data: two curves, with where they come from, which ``fdd train`` makes from a data set.
"""

from __future__ import annotations

import hashlib
import math
from functools import partial
from operator import eq
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fdd.bounds import MAX_MODEL_BYTES
from fdd.diagnosis.findings import is_none
from fdd.errors import input_error
from fdd.faults import ADDED_BY, fault
from fdd.files import write_text
from fdd.residuals.compiled import Array
from fdd.residuals.effects import Spreads
from fdd.yaml_reading import yaml_text

SHIPPED = "model.json"
HELD_IN_DOUBT = 0.5
"""Confidence below which a finding is a hint: it makes no verdict, and does not count as answered."""
MOST = 1e6
"""Of a score, an hour or a rate; beyond it no data set reaches."""


def root(score: float) -> float:
    """Root of twice a score: standard deviations, where it is the log likelihood ratio of one amplitude."""
    return math.sqrt(2.0 * max(score, 0.0))


def odds_of(
    roots: Array | float, hidden: Array | float, slope: float, midpoint: float, hidden_power: float
) -> Array | float:
    """Odds of a fault that were even before: of those that leave no trace, and of the others, a logistic of
    the score's `root` (Platt scaling: Niculescu-Mizil and Caruana 2005, doi 10.1145/1102351.1102430); see
    `Calibration`.

    Examples
    --------
    >>> [round(float(odds_of(r, 0.5, slope=2.0, midpoint=3.0, hidden_power=2.0)), 2) for r in (3.0, -50.0)]
    [1.0, 0.25]
    """
    traceless = hidden**hidden_power
    return traceless + (1.0 - traceless) * np.exp(np.clip(slope * (roots - midpoint), -50.0, 50.0))


class AlarmTail(BaseModel):
    """How often healthy logs pass a score's `root` r.

    It is ``rate · (1 + shape (r - height) / scale)^(-1 / shape)``, a generalised Pareto tail over a
    height (peaks over a threshold, Pickands 1975, doi 10.1214/aos/1176343003); of shape 0 it is exponential.

    Attributes
    ----------
    height : root that it was fitted above. rate_per_hour : of healthy hours' peaks above it. scale, shape :
        of their excess. hours : of healthy logs behind it.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    height: float = Field(ge=-MOST, le=MOST)
    rate_per_hour: float = Field(gt=0, le=MOST)
    scale: float = Field(gt=0, le=MOST)
    shape: float = Field(default=0.0, ge=0.0, le=1.0)
    hours: float = Field(ge=0, le=MOST)

    def threshold(self, false_alarms_per_hour: float) -> float:
        """Score that healthy logs pass at the wanted rate (1/h).

        Examples
        --------
        >>> round(AlarmTail(height=4.0, rate_per_hour=2.0, scale=1.0, hours=10.0).threshold(0.2), 2)
        19.86
        """
        returns = max(math.log(self.rate_per_hour / false_alarms_per_hour), 0.0)
        passed = math.expm1(self.shape * returns) / self.shape if self.shape else returns
        return 0.5 * (self.height + self.scale * passed) ** 2


class Calibration(BaseModel):
    """Probability that something is wrong.

    Attributes
    ----------
    prior : the same before the log was seen; learnt curves hold for even odds. midpoint, slope : logistic of
        the score's `root`, for faults that leave a trace. hidden_power : the share of faults that leave none
        is this power of the share that the log could not have shown. least : score that one healthy log in
        fifty reaches, which a verdict asks at least.
    second_midpoint, second_slope, second_gain : logistic of what tells findings beside the leading one.
    severity_doubt : std of a severity's logarithm by what no column knows, as how turbulent a leak is or how
        a seal wears.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)
    midpoint: float = Field(ge=-MOST, le=MOST)
    slope: float = Field(gt=0, le=MOST)
    hidden_power: float = Field(default=1.0, gt=0.0, le=MOST)
    least: float = Field(default=0.0, ge=0.0, le=MOST)
    second_midpoint: float = Field(default=6.0, ge=-MOST, le=MOST)
    second_slope: float = Field(default=0.3, gt=0.0, le=MOST)
    second_gain: float = Field(default=0.0, ge=0.0, le=MOST)
    severity_doubt: float = Field(default=0.15, ge=0.0, le=10.0)
    prior: float = Field(default=0.5, gt=0.0, lt=1.0, exclude_if=partial(eq, 0.5))

    def probability(self, score: float, hidden: float = 0.0) -> float:
        """Of a fault, given the largest score; `hidden` is the share of faults that this log could not have
        shown.

        Examples
        --------
        >>> round(Calibration(midpoint=4.0, slope=1.0).probability(8.0), 2)
        0.5
        >>> round(Calibration(midpoint=4.0, slope=9.0).probability(-9.0, hidden=0.25), 2)
        0.2
        """
        odds = odds_of(root(score), hidden, self.slope, self.midpoint, self.hidden_power)
        odds *= self.prior / (1.0 - self.prior)
        return float(odds / (1.0 + odds))

    def second(self, explained_root: float, log_gain_ratio: float) -> float:
        """Probability of a finding beside the leading one, by its `Found.second_evidence`; how often units
        have two faults is learnt with it.

        Examples
        --------
        >>> round(Calibration(midpoint=4.0, slope=1.0).second(6.0, -2.0), 2)
        0.5
        """
        at = explained_root + self.second_gain * log_gain_ratio
        odds = odds_of(at, 0.0, self.second_slope, self.second_midpoint, 1.0)
        return float(odds / (1.0 + odds))

    @property
    def even(self) -> float:
        """Score from which on a log is called faulty: at even odds a fault is likelier than not, and at most
        one healthy log in fifty scores as high.

        Examples
        --------
        >>> Calibration(midpoint=4.0, slope=1.0).even, Calibration(midpoint=2.0, slope=1.0, least=4.5).even
        (8.0, 4.5)
        """
        odds = math.log(self.prior / (1.0 - self.prior))
        least = max(self.midpoint, root(self.least)) - odds / self.slope
        return 0.5 * max(least, 0.0) ** 2


class Model(BaseModel):
    """A learnt layer on top of the evidence."""

    model_config = ConfigDict(populate_by_name=True, extra="forbid", allow_inf_nan=False, strict=True)
    schema_: Literal["fdd.model/5"] = Field(default="fdd.model/5", alias="schema")
    data: str
    """The data set that it was learnt on."""
    tail: AlarmTail
    calibration: Calibration
    faults: tuple[str, ...] | None = Field(default=None, strict=False, exclude_if=is_none)
    """Faults of the logs that it was learnt on; None stands for those that fdd ships."""
    laws: dict[str, list[str]] | None = Field(default=None, exclude_if=is_none)
    """Fault to the laws by which it was there in these logs; None stands for the first of each."""
    spreads: Spreads | None = Field(default=None, exclude_if=is_none)
    """What healthy units and logs differ by; None stands for what fdd ships."""

    def with_prior(self, prior: float) -> Model:
        """The same for logs of which such a share is faulty (0 to 1, without the ends)."""
        calibration = self.calibration.model_copy(update={"prior": prior})
        return self.model_copy(update={"calibration": calibration})

    def knows(self, name: str) -> bool:
        """Whether logs with this fault were among those that it was learnt on."""
        return name not in ADDED_BY if self.faults is None else name in self.faults

    def had(self, name: str, law: str) -> bool:
        """Whether a fault was there by this law in what was learnt, or has a signature for it.

        Examples
        --------
        >>> Model.load().had("internal_leakage", "mixed"), Model.load().had("internal_leakage", "opening")
        (True, False)
        """
        entry = fault(name)
        known = (*tuple(entry.laws)[:1], *(s.law for s in entry.signatures))
        return law in (*known, *(self.laws or {}).get(name, ()))

    @classmethod
    def load(cls, path: str | Path | None = None) -> Model:
        """Read a model file; None takes the shipped one. Raises InputError: names file and field."""
        where = SHIPPED if path is None else str(path)
        file = Path(__file__).with_name(SHIPPED) if path is None else Path(path)
        text = yaml_text(file, "model file", MAX_MODEL_BYTES, "give a file that fdd train wrote")
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise input_error(error, where, "train the model anew") from None

    def save(self, path: str | Path) -> None:
        """Write the model whole or not at all."""
        write_text(path, self.model_dump_json(by_alias=True, indent=1) + "\n")

    @property
    def sha256(self) -> str:
        """Of what it says."""
        return hashlib.sha256(self.model_dump_json(by_alias=True).encode()).hexdigest()
