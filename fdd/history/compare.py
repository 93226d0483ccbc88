"""Two logs of a unit beside each other: estimates, balances, findings, duty and spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Trajectories
from fdd.history.answers import Closure, Comparison, EstimateChange, LogSaid
from fdd.history.changes import TEST, estimate_changes
from fdd.history.duty import duty_rows, has
from fdd.history.spectra import Spectrum, changed_lines, spectra_of
from fdd.report.words import candidates
from fdd.samples import Samples
from fdd.unit import Unit

LEAST_INFORMATIVE_FRAMES = 8
"""Fewest frames with information on a balance for a mean over the log: four seconds."""
NO_CHANGE = "no change beyond uncertainty"


@dataclass(frozen=True)
class Side:
    """One log with its answer and what is behind it."""

    answer: Diagnosis
    trajectories: Trajectories
    samples: Samples


def compare(a: Side, b: Side, unit: Unit) -> tuple[Comparison, list[Spectrum]]:
    """What changed from log `a` to log `b`, both diagnosed on the profile `unit`.

    Returns
    -------
    The answer, and the spectra that its lines are of.
    """
    measured = has(a.samples, "oil_temperature") and has(b.samples, "oil_temperature")
    changes = estimate_changes(a.answer, b.answer, unit, measured=measured)
    spectra = spectra_of(a.samples, b.samples)
    warm = "Oil temperature is not measured in both logs: leakage is compared as it was."
    notes = [] if measured else [warm]
    notes += [note for note in a.answer.quality.notes if note in b.answer.quality.notes]
    blind = [ESTIMATED[c.quantity][2].lower() for c in changes if c.changed is None]
    if blind:
        notes.append(f"Not shown by both logs: {', '.join(blind)}.")
    found = Comparison(
        headline=_headline(changes, a.answer, b.answer), unit=unit.name, axis=a.answer.axis,
        a=_said(a.answer), b=_said(b.answer), test=TEST, estimates=changes, notes=notes,
        balances=_closures(a.trajectories, b.trajectories), duty=duty_rows(a.samples, b.samples),
        lines=changed_lines(spectra, a.samples, b.samples),
    )  # fmt: skip
    return found, spectra


def _headline(changes: list[EstimateChange], a: Diagnosis, b: Diagnosis) -> str:
    """The faults that are found in one log only, then what changed most, in its own uncertainty."""
    parts = []
    for only, other, name in ((b, a, "B"), (a, b, "A")):
        known = {f.fault for f in other.faults}
        if new := [candidates(f) for f in only.faults if f.fault not in known]:
            parts.append(f"{', '.join(new)} found in {name} only")
    return "; ".join([*parts, _most_changed(changes)])


def _most_changed(changes: list[EstimateChange]) -> str:
    changed = [c for c in changes if c.changed and c.p_value is not None]
    # A large change's p value is 0: by the ratio then.
    most = max(changed, key=lambda c: abs(c.difference or 0.0) / (c.std or 1.0), default=None)
    if most is None:
        return NO_CHANGE
    title = ESTIMATED[most.quantity][2].lower()
    if not (most.a and most.difference is not None and most.std is not None):
        return f"{title} changed"
    share, spread = 100.0 * most.difference / most.a, 100.0 * 1.96 * most.std / abs(most.a)
    word = "rose" if share > 0.0 else "fell"
    others = [ESTIMATED[c.quantity][2].lower() for c in changed if c is not most]
    more = f"; changed as well: {', '.join(others)}" if others else ""
    return f"{title} {word} by {abs(share):.0f} ± {spread:.0f} % (95 %){more}"


def _said(answer: Diagnosis) -> LogSaid:
    same = ("log", "started_at", "duration_s", "verdict", "faults")
    return LogSaid(**{name: getattr(answer, name) for name in same}, notes=answer.quality.notes)


def _closures(a: Trajectories, b: Trajectories) -> list[Closure]:
    one, other = _misfits(a), _misfits(b)
    return [Closure(balance=n, a=one.get(n), b=other.get(n)) for n in dict.fromkeys([*one, *other])]


def _misfits(found: Trajectories) -> dict[str, float]:
    # Frames without information on a balance are 0.
    return {
        name: float(f"{np.sqrt(np.mean(np.square(part))):.4g}")
        for name, column in zip(found.feature_names, found.features.T, strict=True)
        if (part := column[column != 0.0]).size >= LEAST_INFORMATIVE_FRAMES
    }
