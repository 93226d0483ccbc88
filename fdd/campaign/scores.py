"""Answers against truth: what is found, named and dated, how sure, and how often wrongly."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, chi2
from sklearn.linear_model import LogisticRegression

from fdd.campaign.labels import Entry
from fdd.diagnosis.findings import Diagnosis, FaultFinding
from fdd.diagnosis.model import HELD_IN_DOUBT
from fdd.faults import fault

CLASSES = ("healthy", "leakage", "seal_wear", "check_valve", "aeration", "other")
EARLY_S = 2.0
"""How long before the true onset an answered one may lie."""
RESAMPLED = 2000
"""Draws of logs, and of what calibrated statements would come to."""
LEAST_FOR_CURVE = 30
"""Logs of a fault from which on a curve of finding it over its severity is drawn."""

Classes = tuple[set[str], set[str]]
"""True and answered ones of a log."""


@dataclass(frozen=True)
class Outcome:
    """One log of a data set with its answer.

    Attributes
    ----------
    errors : ``{(method, quantity): (median relative error, share of time observable)}`` of the estimates,
        against the truth in units of the profile's own geometry.
    alarms : raised while the log was pushed.
    """

    entry: Entry
    found: Diagnosis
    errors: dict[tuple[str, str], tuple[float, float]]
    alarms: int = 0

    @property
    def said(self) -> list[FaultFinding]:
        """Faults that the answer holds for more likely than not, the surest first."""
        return said_of(self.found)

    @property
    def timely(self) -> list[FaultFinding]:
        """Those whose onset is not before anything was wrong."""
        first = min((f.onset_s for f in self.entry.faults), default=np.inf)
        return [f for f in self.said if f.onset_s >= first - EARLY_S]

    @property
    def led(self) -> bool:
        """Whether the first timely answer is one of the faults."""
        return bool(self.timely) and self.timely[0].fault in {f.fault for f in self.entry.faults}

    @property
    def named(self) -> bool:
        """Whether the first timely answer has the fault in its group; of several faults: each in one."""
        groups = [f.ambiguity for f in self.timely[: None if len(self.entry.faults) > 1 else 1]]
        return bool(groups) and all(any(f.fault in g for g in groups) for f in self.entry.faults)

    @property
    def classes(self) -> Classes:
        """True and answered classes."""
        return classes_of({f.fault for f in self.entry.faults}, self.found)

    @property
    def sureness(self) -> tuple[float, bool]:
        """What the leading statement gives itself, and whether it holds."""
        first = min((f.onset_s for f in self.entry.faults), default=np.inf)
        return sureness_of({f.fault for f in self.entry.faults}, first, self.found)


def said_of(found: Diagnosis) -> list[FaultFinding]:
    """Faults that an answer holds for more likely than not, the surest first."""
    return [f for f in found.faults if f.confidence >= HELD_IN_DOUBT]


def classes_of(true: Set[str], found: Diagnosis) -> Classes:
    """Classes of a log's true faults, and of what is said of it."""
    said = {class_of(f.fault) for f in said_of(found)}
    return {class_of(f) for f in true} or {"healthy"}, said or {"healthy"}


def sureness_of(true: Set[str], first: float, found: Diagnosis) -> tuple[float, bool]:
    """What the leading statement gives itself, and whether it holds, of a log whose faults begin at `first`
    (s)."""
    said = said_of(found)
    if not said:
        return found.probabilities["healthy"], not true
    timely = any(f.onset_s >= first - EARLY_S for f in said)
    return said[0].confidence, timely and not true.isdisjoint((said[0].fault, *said[0].ambiguity))


def class_of(kind: str) -> str:
    """One of `CLASSES`."""
    family = fault(kind).family
    return family if family in CLASSES else "other"


def wilson(hits: int, n: int) -> str:
    """A share with its 95 % interval (Wilson 1927, doi 10.1080/01621459.1927.10502953).

    Examples
    --------
    >>> wilson(8, 10)
    '0.80 (0.49 to 0.94) of 10'
    """
    if not n:
        return "- of 0"
    low, high = binomtest(hits, n).proportion_ci(method="wilson")
    return f"{hits / n:.2f} ({low:.2f} to {high:.2f}) of {n}"


def rate(count: int, hours: float) -> str:
    """Events per hour with Poisson's 95 % interval.

    Examples
    --------
    >>> rate(0, 10.0)
    '0 in 10.0 h: 0.00 (0.00 to 0.37) an hour'
    """
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    per = 1.0 / max(hours, 1e-9)
    return f"{count} in {hours:.1f} h: {count * per:.2f} ({low * per:.2f} to {high * per:.2f}) an hour"


def macro_f1(both: Sequence[Classes]) -> tuple[float, tuple[float, float], dict[str, float]]:
    """Mean F1 over those of `CLASSES` that occur in logs' true and answered ones; its 95 % interval, by logs
    drawn anew (bootstrap: Efron 1979, doi 10.1214/aos/1176344552); and each class's."""
    n = len(both)
    true, said = (
        np.array([[c in each[k] for c in CLASSES] for each in both], dtype=np.float64) for k in (0, 1)
    )
    drawn = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), RESAMPLED)
    drawn = np.vstack([np.ones(n), drawn])
    total = drawn @ (true + said)
    f1 = np.divide(2.0 * drawn @ (true * said), total, out=np.full_like(total, np.nan), where=total > 0.0)
    means = np.nanmean(f1, axis=1)
    low, high = np.quantile(means[1:], (0.025, 0.975))
    each_one = {c: float(v) for c, v in zip(CLASSES, f1[0], strict=True) if np.isfinite(v)}
    return float(means[0]), (float(low), float(high)), each_one


def calibration_error(
    sureness: Sequence[tuple[float, bool]], faulty: Sequence[bool], bins: int = 10
) -> tuple[float, float, float]:
    """Expected calibration error of logs' leading statements (Naeini et al. 2015, AAAI): what each gives
    itself and whether it holds, of logs of which some are `faulty`. Beside it, the mean and the 90 % quantile
    were each statement right as often as it says (Bröcker and Smith 2007, doi 10.1175/WAF993.1): of few logs
    in a bin more or fewer are right by chance.

    Healthy and faulty logs weigh the same in all: the odds before a log is seen are even, and how many of a
    recipe's logs are faulty says nothing of how often an actuator is.
    """
    (p, right), ill = np.array(sureness, dtype=np.float64).T, np.array(faulty, dtype=np.bool_)
    weight = np.where(ill, 1.0 / max(ill.sum(), 1), 1.0 / max((~ill).sum(), 1))
    within = np.minimum((p * bins).astype(int), bins - 1) == np.arange(bins)[:, None]
    came = np.vstack([right, np.random.default_rng(0).random((RESAMPLED, p.size)) < p])
    errors = np.abs((weight * (p - came)) @ within.T).sum(axis=1) / weight.sum()
    return float(errors[0]), float(errors[1:].mean()), float(np.quantile(errors[1:], 0.9))


def visible_from(outcomes: Sequence[Outcome], kind: str, share: float = 0.9) -> float:
    """Severity from which on a share of a fault's logs is found, by logistic regression; NaN where it is not
    bracketed."""
    mine = [o for o in outcomes if [f.fault for f in o.entry.faults] == [kind]]
    severity = np.array([o.entry.faults[0].severity for o in mine])
    found = np.array([bool(o.timely) for o in mine])
    if found.size < LEAST_FOR_CURVE or found.all() or not found.any():
        return float("nan")
    fitted = LogisticRegression(C=1e6).fit(np.log(severity)[:, None], found)
    slope, offset = float(fitted.coef_[0, 0]), float(fitted.intercept_[0])
    at = float(np.exp((np.log(share / (1.0 - share)) - offset) / slope)) if slope > 0.0 else np.inf
    return at if at <= severity.max() else float("nan")


def figures(outcomes: Sequence[Outcome]) -> str:
    """All of it as a list (Markdown)."""
    healthy = [o for o in outcomes if not o.entry.faults]
    faulty = [o for o in outcomes if o.entry.faults]
    single = [o for o in faulty if len(o.entry.faults) == 1]
    pairs = [o for o in faulty if len(o.entry.faults) > 1]
    hits = [(o.entry.faults[0], o.timely[0]) for o in single if o.timely]
    named = [sum(any(f.fault in a.ambiguity for a in o.timely) for f in o.entry.faults) for o in pairs]
    steps = [abs(a.onset_s - t.onset_s) for t, a in hits if t.profile == "step" and t.onset_s > 0.0]
    sized = [
        a.severity_interval[0] <= t.severity <= a.severity_interval[1]
        for t, a in hits
        if t.fault == a.fault and a.severity_interval is not None
    ]
    # One that was there before the log, by the answer, has no interval, and does not hold an onset within it.
    dated = [
        a.onset_interval is not None and a.onset_interval[0] <= t.onset_s <= a.onset_interval[1]
        for t, a in ((o.entry.faults[0], a) for o in single for a in o.said[:1])
        if t.onset_s > 0.0 and t.fault in a.ambiguity and a.severity is not None
    ]
    mean, (low, high), each = macro_f1([o.classes for o in outcomes])
    error, by_chance, most = calibration_error(
        [o.sureness for o in outcomes], [bool(o.entry.faults) for o in outcomes]
    )
    # Of a log that is its twin but for the noise nobody can tell the fault.
    shown = [o.classes for o in outcomes if o.entry.visible is not False]
    beside = ""
    if 0 < len(shown) < len(outcomes):
        beside = f", {macro_f1(shown)[0]:.2f} of the {len(shown)} healthy and visible"
    lines = [
        f"macro-F1 **{mean:.2f}** ({low:.2f} to {high:.2f}){beside}: "
        + ", ".join(f"{c.replace('_', ' ')} {v:.2f}" for c, v in each.items()),
        f"faulty logs found: {wilson(sum(bool(o.timely) for o in faulty), len(faulty))}",
        "of single faults found, class right: "
        + wilson(sum(class_of(t.fault) == class_of(a.fault) for t, a in hits), len(hits)),
        "kind right or in the group that is named: "
        + wilson(sum(t.fault in a.ambiguity for t, a in hits), len(hits)),
        f"two faults at once, both named: {wilson(sum(n > 1 for n in named), len(named))}; "
        f"one of them: {wilson(sum(n > 0 for n in named), len(named))}",
        f"healthy logs with a fault in their answer: "
        f"{wilson(sum(bool(o.found.faults) for o in healthy), len(healthy))}; alarms raised on the way: "
        + rate(sum(o.alarms for o in healthy), sum(o.entry.duration_s for o in healthy) / 3600.0),
        f"80 % intervals of severity hold the true one: {wilson(sum(sized), len(sized))}",
        f"80 % intervals of the onset hold the true one: {wilson(sum(dated), len(dated))}",
        f"calibration error of all leading statements: {error:.3f}; of calibrated ones, on as many logs, "
        f"{by_chance:.3f}, nine in ten below {most:.3f}",
    ]
    if steps:
        middle, late = np.median(steps), np.quantile(steps, 0.9)
        lines.insert(5, f"onset error of {len(steps)} steps: median {middle:.2f} s, 90 % below {late:.1f} s")
    for kind in sorted({f.fault for o in single for f in o.entry.faults}):
        if np.isfinite(at := visible_from(outcomes, kind)):
            lines.append(f"{kind.replace('_', ' ')}: 90 % are found from severity {at:.2f} on")
    return "".join(f"- {line}\n" for line in lines)
