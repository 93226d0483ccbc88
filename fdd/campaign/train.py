"""From a generated data set to a model: what healthy logs' scores reach, and what a score is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import expit, logit

from fdd.campaign.dataset import Dataset, How, over_units
from fdd.campaign.labels import HEALTHY, Entry
from fdd.diagnosis.answering import Z80, hidden_share
from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.model import AlarmTail, Calibration, Model, root
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.identify import identify_unit
from fdd.residuals.effects import Spreads
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

TAIL_FROM = 0.7
"""Quantile of healthy logs' peaks from which on they are their tail."""
FALSE_VERDICTS = 0.02
"""Share of healthy logs that a verdict may call faulty."""
LASTING_S = 120.0
"""s of a healthy log from which on it stands for hours of work."""
LAW_SPREAD = 0.6
"""Std of a severity's logarithm by its law, which the logs learnt from share with the signatures: a leak goes
by the root of pressure to its square, of which a machine uses a decade (0.6 times 0.66), and a part opens
by its wear or by the square of it (half of ln severity, 1 root mean square). Assumed."""
LEAST_LOGS = 8
"""Healthy, and faulty, logs below which nothing is learnt."""


@dataclass(frozen=True)
class ScoredLog:
    """What one log's evidence came to.

    Attributes
    ----------
    family, faults : true ones. laws : fault and law of those that may have several.
    score : of the whole log. peak : the largest that stood meanwhile.
    healthy_s : s before a fault acts. doubt : std of the severity's logarithm that its 80 % interval lacked
        to hold the true one; NaN where another fault was answered. hidden : share of faults that it could
        not have shown. later : of each finding beside a surer one its log odds and whether it was right.
    """

    family: str
    score: float
    peak: float
    healthy_s: float
    doubt: float = float("nan")
    hidden: float = 0.0
    faults: tuple[str, ...] = ()
    laws: tuple[tuple[str, str], ...] = ()
    later: tuple[tuple[float, bool], ...] = ()


def train(directories: Sequence[str | Path], *, spreads: Spreads | None = None, **how: Unpack[How]) -> Model:
    """Learn a model from data sets; an InputError where one is none, has no baselines, or they are too small.

    `spreads` are what healthy units and logs differ by, of `learn_spreads`; None takes the shipped ones.
    """
    logs = over_units(_scored, directories, spreads, **how)
    model = learnt(logs, ", ".join(Dataset.load(d).described for d in directories))
    model.spreads = spreads
    return model


def learnt(logs: list[ScoredLog], data: str) -> Model:
    """Tail and calibration of scored logs; an InputError where too few are healthy, or faulty."""
    from sklearn.linear_model import LogisticRegression  # a second, which readers of data sets need not wait

    healthy, ill = ([x for x in logs if (x.family == HEALTHY) == well] for well in (True, False))
    faulty = np.array([root(x.score) for x in ill])
    if min(len(healthy), faulty.size) < LEAST_LOGS:
        problem = f"{len(healthy)} healthy and {faulty.size} faulty logs"
        raise InputError(problem, mend=f"at least {LEAST_LOGS} of each are needed")
    # Alarms an hour are those of hours: each short log begins anew, as one hour in many does.
    lasting, brief = ([x for x in healthy if (x.healthy_s >= LASTING_S) == long] for long in (True, False))
    lasting, brief = (x if len(x) >= LEAST_LOGS else healthy for x in (lasting, brief))
    hours = sum(x.healthy_s for x in lasting) / 3600.0
    peaks = np.array([root(x.peak) for x in lasting])
    height = float(np.quantile(peaks, TAIL_FROM))
    over = peaks[peaks > height] - height
    if not over.size:  # they all score alike: as if one had lain a standard deviation above the others
        over = np.ones(1)
    scale, shape = pareto(over)
    tail = AlarmTail(
        height=round(height, 3), rate_per_hour=round(over.size / hours, 4),
        scale=round(scale, 4), shape=round(shape, 4), hours=round(hours, 2),
    )  # fmt: skip
    # What a log in hand is worth, others in hand tell: the odds are a logistic of the root (Platt scaling:
    # Niculescu-Mizil and Caruana 2005, doi 10.1145/1102351.1102430). Even odds before it: how many of a
    # recipe's logs are faulty says nothing of how often an actuator is.
    of_logs = np.array([root(x.score) for x in brief])
    kinds = np.repeat([False, True], [of_logs.size, faulty.size])
    curve = LogisticRegression(class_weight="balanced").fit(np.append(of_logs, faulty)[:, None], kinds)
    slope = max(float(curve.coef_[0, 0]), 1e-3)
    midpoint = -float(curve.intercept_[0]) / slope
    # Half of the healthy logs lie below their median, and so do faults that leave no trace. Some of these the
    # log could not have shown: what is learnt are the others.
    missed = min(2.0 * float(np.mean(faulty < np.median(of_logs))), 1.0)
    hidden = float(np.mean([x.hidden for x in ill]))
    unseen = max(1.0 - (1.0 - missed) / max(1.0 - hidden, 1e-3), 0.0)
    doubts = np.array([x.doubt for x in logs if np.isfinite(x.doubt)])
    doubt = float(np.quantile(doubts, 0.8)) if doubts.size >= LEAST_LOGS else 0.15
    calibration = Calibration(
        midpoint=round(midpoint, 3), slope=round(slope, 4), unseen=round(unseen, 3),
        least=round(0.5 * float(np.quantile(of_logs, 1.0 - FALSE_VERDICTS)) ** 2, 3),
        severity_doubt=round(math.hypot(LAW_SPREAD, doubt), 3),
        second=round(second_odds([pair for x in logs for pair in x.later]), 3),
    )  # fmt: skip
    taught = tuple(sorted({name for x in logs for name in x.faults}))
    laws: dict[str, list[str]] = {}
    for name, law in sorted({pair for x in logs for pair in x.laws}):
        laws.setdefault(name, []).append(law)
    return Model(data=data, tail=tail, calibration=calibration, faults=taught or None, laws=laws or None)


def second_odds(later: Sequence[tuple[float, bool]]) -> float:
    """Log odds against findings beside a surer one, by which as many are right as said.

    `later` : log odds of each, as if it had stood alone, and whether it was right.
    """
    if len(later) < LEAST_LOGS:
        return Calibration.model_fields["second"].default
    odds, right = np.array(later, dtype=np.float64).T
    share = (right.sum() + 0.5) / (right.size + 1.0)

    def excess(second: float) -> float:
        return float(np.mean(expit(odds - second))) - share

    return float(brentq(excess, 0.0, 100.0)) if excess(0.0) > 0.0 else 0.0


def pareto(excess: Array) -> tuple[float, float]:
    """Scale and shape of a generalised Pareto distribution, by probability weighted moments (Hosking and
    Wallis 1987, doi 10.1080/00401706.1987.10488243).

    The shape is held between 0, an exponential tail, and 0.5, beyond which there is no variance.
    """
    x = np.sort(excess)
    mean = float(x.mean())
    weighted = float(np.mean(x * np.arange(x.size - 1, -1, -1) / max(x.size - 1, 1)))
    shape = float(np.clip(2.0 - mean / (mean - 2.0 * weighted), 0.0, 0.5)) if mean > 2.0 * weighted else 0.0
    return mean * (1.0 - shape), shape


def identified_unit(data: Dataset, unit: str, spreads: Spreads | None = None) -> Unit:
    """The unit's profile from its baseline runs and the profile that it was varied from."""
    runs = data.baseline(unit)
    if not runs:
        mend = "set baseline: true in the recipe"
        raise InputError("data set without baseline runs", where=data.directory, mend=mend)
    return add_baseline(identify_unit(runs, data.base_unit(unit), unit).unit, runs, spreads)


def _scored(data: Dataset, unit: str, spreads: Spreads | None) -> list[ScoredLog]:
    profile = identified_unit(data, unit, spreads)
    model = Model.load().model_copy(update={"spreads": spreads})
    out = []
    for entry in data.logs_of(unit):
        out.append(_score(entry, data.samples(entry), profile, model))
        if (twin := data.twin(entry)) is not None:
            out.append(_score(entry.model_copy(update={"faults": ()}), twin, profile, model))
    return out


def _score(entry: Entry, samples: Samples, profile: Unit, model: Model) -> ScoredLog:
    pipeline = Pipeline(profile, model, log=entry.file, keep_trajectories=False)
    pipeline.push(samples)
    found = pipeline.finish()
    hydraulic = [f for f in found.faults if f.family != "sensor" or f.severity is not None]
    names, calibration = {f.fault for f in entry.faults}, pipeline.model.calibration
    onset = min((f.onset_s for f in entry.faults), default=found.duration_s)
    return ScoredLog(
        family=entry.family, score=pipeline.score, peak=pipeline.largest_score, healthy_s=onset,
        doubt=_doubt(entry, hydraulic, calibration.severity_doubt),
        hidden=hidden_share(found.not_visible), faults=tuple(f.fault for f in entry.faults),
        laws=tuple((f.fault, f.law) for f in entry.faults if f.law is not None),
        later=tuple(
            (calibration.second + float(logit(f.confidence)), bool(names.intersection(f.ambiguity)))
            for f in hydraulic[1:]
        ),
    )  # fmt: skip


def _doubt(entry: Entry, found: list[FaultFinding], known: float) -> float:
    """What the std of the leading severity's logarithm must be for its 80 % interval to reach the true one;
    `known` : what the interval allows for already."""
    if len(entry.faults) != 1 or not found or found[0].fault != entry.faults[0].fault:
        return float("nan")
    size, interval = found[0].severity, found[0].severity_interval
    if not size or interval is None:
        return float("nan")
    own = (np.log(interval[1] / size) / Z80) ** 2 - known**2
    missing = (np.log(size / entry.faults[0].severity) / Z80) ** 2 - max(own, 0.0)
    return float(np.sqrt(max(missing, 0.0)))
