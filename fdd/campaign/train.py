"""From a generated data set to a model: identify each unit, track each log, train, and say how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdd.campaign.dataset import Dataset, Entry
from fdd.campaign.units import Progress, for_each_unit
from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.model import Model
from fdd.diagnosis.training import LabelledLog, data_digest, run_test, train_model, verdict_of
from fdd.errors import InputError
from fdd.identify import identify_unit
from fdd.residuals.features import FEATURES, WINDOW
from fdd.residuals.windows import ResidualWindows, baseline_spread
from fdd.unit import Unit

ACTING, ABSENT = 0.1, 0.02
"""Mean severity within a window from which it counts as faulty, and below which as healthy."""


@dataclass(frozen=True)
class TrainingReport:
    """Cross-validated results over logs.

    Attributes
    ----------
    families : families of the logs, then answers that no log has: the columns of `confusion`.
    confusion : (true families, families + 1) logs by true family and answer, the last column not detected.
    false_alarms, healthy_hours : alarms before any fault acts, and the hours looked at.
    delays : s from onset to alarm of the detected logs.
    """

    families: list[str]
    confusion: np.ndarray[Any, np.dtype[np.int64]]
    false_alarms: int
    healthy_hours: float
    delays: np.ndarray[Any, np.dtype[np.float64]]

    @property
    def isolated(self) -> float:
        """Share of faulty logs whose family is the answer."""
        faulty = [i for i in range(self.confusion.shape[0]) if self.families[i] != "healthy"]
        return float(sum(self.confusion[i, i] for i in faulty) / max(self.confusion[faulty].sum(), 1))


def train(
    directory: str | Path, *, workers: int = 2, progress: Progress | None = None
) -> tuple[Model, TrainingReport]:
    """Train a model on a data set.

    Parameters
    ----------
    directory : of a data set with baselines. workers : processes. progress : (done, total) units.

    Raises
    ------
    InputError : not a data set, without baselines, or too small.
    """
    data = Dataset.load(directory)
    logs = labelled_logs(data, workers=workers, progress=progress)
    sha = data_digest(logs)
    name = f"{data.recipe.name} (seed {data.recipe.seed}, {len(data.units)} units, {len(data.logs)} logs)"
    model = train_model(logs, data=name, data_sha256=sha)
    return model, cross_validated(logs, model)


def labelled_logs(data: Dataset, *, workers: int = 2, progress: Progress | None = None) -> list[LabelledLog]:
    """Windows and labels of every log, on profiles identified from each unit's own baseline."""
    work = partial(_unit_logs, str(data.directory))
    return for_each_unit(work, data.units, workers=workers, progress=progress)


def identified_unit(data: Dataset, unit: str) -> Unit:
    """The unit's profile from its baseline runs and the profile that it was varied from."""
    runs = data.baseline(unit)
    if not runs:
        raise InputError(
            "data set without baseline runs", where=data.directory, mend="set baseline: true in the recipe"
        )
    return add_baseline(identify_unit(runs, data.base_unit(unit), unit).unit, runs)


def _unit_logs(directory: str, unit: str) -> list[LabelledLog]:
    data = Dataset.load(directory)
    profile = identified_unit(data, unit)
    out = []
    for entry in data.logs_of(unit):
        times, features = ResidualWindows(profile).push(data.samples(entry))
        log = _labelled(data, entry, times, features)
        log.spread = baseline_spread(profile)
        out.append(log)
    return out


def _labelled(data: Dataset, entry: Entry, times: Any, features: Any) -> LabelledLog:
    family = entry.faults[0].family if entry.faults else "healthy"
    labels = np.full(len(times), "healthy", dtype="U20")
    onset = np.nan
    if entry.faults:
        onset = entry.faults[0].onset_s
        truth = data.truth(entry)
        severity = np.max([truth.severity[f.fault] for f in entry.faults], axis=0)
        ever = False
        for k, end in enumerate(times):
            within = (truth.time > end - WINDOW) & (truth.time <= end)
            mean = float(severity[within].mean()) if within.any() else 0.0
            ever = ever or mean > ABSENT
            # In between, and while an intermittent fault pauses, neither label would be right.
            labels[k] = family if mean >= ACTING else ("" if ever else "healthy")
    return LabelledLog(entry.unit, family, times, features.reshape(-1, len(FEATURES)), labels, onset)


def cross_validated(logs: list[LabelledLog], model: Model) -> TrainingReport:
    """Detection and isolation over logs from out-of-fold probabilities."""
    families = sorted({log.family for log in logs})
    columns = [*families, *sorted(set(model.classes) - set(families))]
    confusion = np.zeros((len(families), len(columns) + 1), dtype=np.int64)
    false_alarms, hours, delays = 0, 0.0, []
    for log in logs:
        if not log.features.shape[0]:
            continue
        test = run_test(log, model)
        row = families.index(log.family)
        healthy_s = (log.times[-1] if np.isnan(log.onset) else log.onset) - log.times[0]
        hours += max(float(healthy_s), 0.0) / 3600.0
        early = test.alarmed and (np.isnan(log.onset) or test.alarm_time < log.onset)
        false_alarms += int(early)
        if not test.alarmed:
            confusion[row, -1] += 1
            continue
        shares = verdict_of(log, model, test)
        answer = max((c for c in model.classes if c != "healthy"), key=lambda c: shares[c])
        confusion[row, columns.index(answer)] += 1
        if not np.isnan(log.onset) and not early:
            delays.append(test.alarm_time - log.onset)
    return TrainingReport(columns, confusion, false_alarms, hours, np.array(delays))
