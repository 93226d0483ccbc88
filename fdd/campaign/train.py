"""From generated data sets to a model: what healthy logs' scores reach, and what a score is worth; or to a
classifier of scikit-learn's kind, judged on units that it has not seen."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from fdd import __version__
from fdd.campaign.dataset import SPLITS, Dataset, How, over_units
from fdd.campaign.labels import HEALTHY, Entry
from fdd.campaign.spreads import identified_unit
from fdd.diagnosis.answering import hidden_share
from fdd.diagnosis.decision import SECOND_FAULT
from fdd.diagnosis.evidence import Z80
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.model import AlarmTail, Calibration, Model, odds_of, root
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.packages import CLASSIFIERS, additions
from fdd.residuals.effects import Spreads
from fdd.samples import Samples
from fdd.unit import Unit

if TYPE_CHECKING:
    from fdd.campaign.loading import LabelledData, Target
    from fdd.learning.stored import StoredClassifier

Array = NDArray[np.float64]
Figures = dict[str, float]

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
        not have shown. second : of each finding beside the leading one its `Found.second_evidence`, and
        whether it was right.
    """

    family: str
    score: float
    peak: float
    healthy_s: float
    doubt: float = float("nan")
    hidden: float = 0.0
    faults: tuple[str, ...] = ()
    laws: tuple[tuple[str, str], ...] = ()
    second: tuple[tuple[float, float, bool], ...] = ()


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
    # What a log in hand is worth, others in hand tell. Even odds before it: how many of a recipe's logs are
    # faulty says nothing of how often an actuator is.
    of_logs = np.array([root(x.score) for x in brief])
    hidden = np.array([x.hidden for x in (*brief, *ill)])
    share = as_stated(np.array([len(x.faults) > 1 for x in ill]))
    slope, midpoint, power = likeliest_odds(np.append(of_logs, faulty), hidden, share)
    doubts = np.array([x.doubt for x in logs if np.isfinite(x.doubt)])
    doubt = float(np.quantile(doubts, 0.8)) if doubts.size >= LEAST_LOGS else 0.15
    calibration = Calibration(
        midpoint=round(midpoint, 3), slope=round(slope, 4), hidden_power=round(power, 3),
        least=round(0.5 * float(np.quantile(of_logs, 1.0 - FALSE_VERDICTS)) ** 2, 3),
        severity_doubt=round(math.hypot(LAW_SPREAD, doubt), 3),
        **second_logistic([(w, *one) for x, w in zip(ill, share.tolist(), strict=True) for one in x.second]),
    )  # fmt: skip
    taught = tuple(sorted({name for x in logs for name in x.faults}))
    laws: dict[str, list[str]] = {}
    for name, law in sorted({pair for x in logs for pair in x.laws}):
        laws.setdefault(name, []).append(law)
    return Model(data=data, tail=tail, calibration=calibration, faults=taught or None, laws=laws or None)


def as_stated(pairs: NDArray[np.bool_]) -> Array:
    """(n,) weights, of sum 1, of faulty logs of which some have `pairs` of faults, as many as one unit in
    eight (`SECOND_FAULT`): a recipe may draw them more often."""
    if pairs.all() or not pairs.any():
        return np.full(pairs.size, 1.0 / pairs.size)
    share = 1.0 / (1.0 + math.exp(SECOND_FAULT))
    return np.where(pairs, share / pairs.sum(), (1.0 - share) / (~pairs).sum())


def likeliest_odds(roots: Array, hidden: Array, faulty: Array) -> tuple[float, float, float]:
    """Slope, midpoint and power of `odds_of`, of largest likelihood for logs of which the last ones are
    faulty, with weights `faulty` (k,) of sum 1, and all others together weigh as much; a normal prior holds
    the slope where they are apart. `roots` (n,) are of the logs' scores, `hidden` (n,) shares of faults that
    each could not have shown.
    """
    healthy = roots.size - faulty.size
    sign = np.where(np.arange(roots.size) < healthy, 1.0, -1.0)
    weight = 0.5 * np.append(np.full(healthy, 1.0 / healthy), faulty)

    def loss(at: Array) -> float:
        odds = odds_of(roots, hidden, np.exp(at[0]), at[1], np.exp(at[2]))
        return float(weight @ np.log1p(odds**sign)) + 0.5 * float(np.exp(2.0 * at[0])) / roots.size

    bounds = [(-7.0, 4.0), (0.0, float(roots.max()) + 1.0), (-3.0, 3.0)]
    # From several midpoints: where the logs are far apart, there are others that nothing near betters.
    starts = ([0.0, middle, 0.0] for middle in np.quantile(roots, (0.1, 0.3, 0.5, 0.7)).tolist())
    tried = [minimize(loss, start, method="Powell", bounds=bounds) for start in starts]
    found = min(tried, key=lambda each: each.fun).x
    return float(np.exp(found[0])), float(found[1]), float(np.exp(found[2]))


def second_logistic(found: Sequence[tuple[float, float, float, bool]]) -> Figures:
    """Fields of `Calibration.second` by logistic regression in which neither score nor gain speaks against a
    fault; none where there are few findings, or larger scores were wrong more often. `found` : weight,
    `Found.second_evidence` and rightness of findings beside a leading one."""
    if len({right for *_, right in found}) < 2 or len(found) < LEAST_LOGS:
        return {}
    weight, *evidence, right = np.array(found, dtype=np.float64).T
    m = np.column_stack([*evidence, np.ones(right.size)]) * (1.0 - 2.0 * right)[:, None]

    def loss(at: Array) -> float:
        return float(weight @ np.logaddexp(0.0, m @ at) / weight.mean()) + 0.5 * float(at[:2] @ at[:2])

    bounds = [(0.0, None), (0.0, None), (None, None)]
    slope, gain, start = minimize(loss, [0.3, 0.1, -2.0], bounds=bounds).x.tolist()
    if slope < 1e-3:
        return {}
    return {
        "second_midpoint": round(-start / slope, 3), "second_slope": round(slope, 4),
        "second_gain": round(gain / slope, 4),
    }  # fmt: skip


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
    names = {f.fault for f in entry.faults}
    onset = min((f.onset_s for f in entry.faults), default=found.duration_s)
    return ScoredLog(
        family=entry.family, score=pipeline.score, peak=pipeline.largest_score, healthy_s=onset,
        doubt=_doubt(entry, hydraulic, model.calibration.severity_doubt),
        hidden=hidden_share(found.not_visible), faults=tuple(f.fault for f in entry.faults),
        laws=tuple((f.fault, f.law) for f in entry.faults if f.law is not None),
        second=tuple(
            (*beside, not names.isdisjoint(f.group))
            for f in pipeline.found if (beside := f.second_evidence) is not None
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


def made(name: str) -> Any:
    """A new classifier, by the name of an entry point of the group ``fdd.classifiers`` or as
    ``module:function``, where the module may lie in the working folder; an InputError where there is none, it
    does not load, or what it makes is no classifier."""
    known = {a.name: a for a in additions(CLASSIFIERS)}
    module, colon, function = name.partition(":")
    if not colon and name not in known:
        mend = f"give {', '.join(sorted(known)) or 'none is installed'}, or MODULE:FUNCTION"
        raise InputError("no classifier of that name", where=name, mend=mend)
    try:
        if colon and str(Path.cwd()) not in sys.path:
            sys.path.append(str(Path.cwd()))
        make = getattr(import_module(module), function) if colon else known[name].load()
        estimator = make()
    except InputError:
        raise
    except Exception as error:
        problem = f"makes no classifier ({type(error).__name__}: {error})"
        mend = "give a function without arguments that returns one"
        raise InputError(problem, where=name, mend=mend) from None
    if not all(hasattr(estimator, method) for method in ("fit", "predict_proba", "get_params")):
        problem = "makes no classifier of scikit-learn's kind with probabilities"
        mend = "return one with predict_proba, e.g. in CalibratedClassifierCV"
        raise InputError(problem, where=name, mend=mend)
    return estimator


def train_classifier(
    name: str, sets: Sequence[LabelledData], target: Target = "family"
) -> tuple[StoredClassifier, Figures]:
    """Train a classifier `made` by name on the units of train and validation, judge it on those of test.

    It comes with its figures: accuracy, macro_f1, brier, and how many rows and units of test they rest on;
    beside it accuracy and macro_f1 of fdd's own answers on the same rows. An InputError where features
    differ, there is too little to learn or to judge by, or the classifier refuses the data.
    """
    import pandas as pd
    from sklearn.utils.validation import has_fit_parameter

    from fdd.learning.stored import StoredClassifier

    estimator = made(name)
    names = sets[0].names
    for each in sets[1:]:
        if each.names != names:
            problem = f"features unlike those of {sets[0].data.directory}"
            raise InputError(problem, where=each.data.directory, mend="make them all with one version")
    splits = [(k, one.rows(split)) for k, one in enumerate(sets) for split in SPLITS]
    rows = pd.concat([part.assign(unit=f"{k}/" + part["unit"]) for k, part in splits])
    x, test = rows[list(names)].to_numpy(dtype=np.float64), (rows["split"] == "test").to_numpy()
    y, groups, own = (rows[c].to_numpy(dtype=np.str_) for c in (target, "unit", f"answer_{target}"))
    judges = np.unique(groups[test]).size
    if not judges or np.unique(y[~test]).size < 2:
        problem = f"{judges} units to judge by, {np.unique(y[~test]).size} classes to learn"
        raise InputError(problem, where=sets[0].data.directory, mend="generate more units and logs")
    more = {"groups": groups[~test]} if has_fit_parameter(estimator, "groups") else {}
    try:
        estimator.fit(x[~test], y[~test], **more)
        probabilities = np.asarray(estimator.predict_proba(x[test]), dtype=np.float64)
        classes = [str(c) for c in estimator.classes_]
    except Exception as error:
        raise InputError(f"refuses the data ({type(error).__name__}: {error})", where=name) from None
    figures = {
        **judged(y[test], np.array(classes)[probabilities.argmax(axis=1)]),
        "brier": brier(y[test], probabilities, classes), "rows": int(test.sum()), "units": judges,
    }  # fmt: skip
    data = {s.data.manifest.name: s.data.manifest.sha256 for s in sets}
    stored = StoredClassifier(estimator, list(names), target, None, name, __version__, data, figures)
    return stored, judged(y[test], own[test])


def judged(true: Any, said: Any) -> Figures:
    """Shares of answers (n,) against the truth (n,)."""
    from sklearn.metrics import accuracy_score, f1_score

    macro = f1_score(true, said, average="macro", zero_division=0.0)
    return {"accuracy": float(accuracy_score(true, said)), "macro_f1": float(macro)}


def brier(true: Any, probabilities: Any, classes: Sequence[str]) -> float:
    """Mean over rows of the squared errors of all classes' probabilities, 0 to 2.

    Not scikit-learn's: a class that was not learnt has probability 0.
    """
    true = np.asarray(true, dtype=np.str_)
    hit = true[:, None] == np.asarray(classes, dtype=np.str_)
    return float(np.mean(np.sum(np.square(probabilities - hit), axis=1) + ~hit.any(axis=1)))
