"""How good the whole path is on a generated data set: detection, isolation, delays, estimates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.campaign.dataset import Dataset, Entry
from fdd.campaign.train import identified_unit
from fdd.campaign.units import Progress, for_each_unit
from fdd.diagnosis.findings import Trajectories
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.truth import Truth
from fdd.unit import Unit

SETTLED_S = 5.0
"""After the start and after a fault's step the estimators are given this long."""


@dataclass(frozen=True)
class Outcome:
    """One log: what is true, what was answered, and how far the estimates were off.

    Attributes
    ----------
    file, family, severity, onset_s : truth; family ``healthy``, NaN where there is no fault.
    verdict, answer, confidence, answered_onset_s, detected_s : the answer; NaN and ``""`` without alarm.
    errors : ``{(method, quantity): (median relative error, share of time observable)}``, against the
        truth in units of the profile's own geometry: flow sensors measure areas and volumes of
        the profile, so leakage is compared per area, bulk modulus per volume over area.
    """

    file: str
    family: str
    severity: float
    onset_s: float
    load: str
    duty: str
    verdict: str
    answer: str
    fault: str
    confidence: float
    answered_onset_s: float
    detected_s: float
    answered_severity: float
    errors: dict[tuple[str, str], tuple[float, float]]

    @property
    def early(self) -> bool:
        """Alarmed although nothing was wrong yet."""
        return bool(np.isfinite(self.detected_s) and not self.detected_s >= self.onset_s)


def validate(
    directory: str | Path, model: str | None = None, *, workers: int = 2, progress: Progress | None = None
) -> list[Outcome]:
    """Diagnose every log of a data set on profiles identified from its units' own baselines.

    Raises
    ------
    InputError : not a data set, or an unusable model.
    """
    Model.load(model)
    data = Dataset.load(directory)
    work = partial(_unit_outcomes, str(data.directory), model)
    return for_each_unit(work, data.units, workers=workers, progress=progress)


def _unit_outcomes(directory: str, model: str | None, unit: str) -> list[Outcome]:
    data = Dataset.load(directory)
    profile = identified_unit(data, unit)
    true = data.true_unit(unit)
    loaded = Model.load(model)
    return [_outcome(data, entry, profile, true, loaded) for entry in data.logs_of(unit)]


def _outcome(data: Dataset, entry: Entry, profile: Unit, true: Unit, model: Model) -> Outcome:
    pipeline = Pipeline(profile, model, axis=entry.unit, log=entry.file)
    pipeline.push(data.samples(entry))
    found = pipeline.finish()
    truth = data.truth(entry)
    label = entry.faults[0] if entry.faults else None
    fault = found.faults[0] if found.faults else None
    nan = float("nan")
    return Outcome(
        file=entry.file, family=label.family if label else "healthy",
        severity=label.severity if label else nan, onset_s=label.onset_s if label else nan,
        load=entry.scenario.load, duty=entry.scenario.duty, verdict=found.verdict,
        answer=fault.family if fault else "", fault=fault.fault if fault else "",
        confidence=fault.confidence if fault else nan,
        answered_onset_s=fault.onset_s if fault else nan, detected_s=fault.detected_s if fault else nan,
        answered_severity=fault.severity if fault and fault.severity is not None else nan,
        errors=estimate_errors(pipeline.trajectories(), truth, profile, true),
    )  # fmt: skip


def estimate_errors(
    found: Trajectories, truth: Truth, profile: Unit, true: Unit
) -> dict[tuple[str, str], tuple[float, float]]:
    """Median relative error of each method's leakage and bulk modulus while observable.

    The profile's areas and volumes scale flows, so they are taken out: leakage is compared
    per piston area, bulk modulus per volume over area, both at the true unit's reference state.
    """
    time = found.time
    settled = time > SETTLED_S
    for severity in truth.severity.values():
        # While a fault changes the plant, and shortly after, no estimate can be right.
        changing = np.abs(np.gradient(severity, truth.time)) > 1e-3
        for t in truth.time[changing]:
            settled &= (time < t - 0.1) | (time > t + SETTLED_S)
    area = profile.cylinder.area_1 / true.cylinder.area_1
    # One bulk modulus serves both chambers, so what scales it is the oil in both.
    mine, theirs = profile.cylinder, true.cylinder
    volume = (mine.volume_1 + mine.volume_2) / (theirs.volume_1 + theirs.volume_2)
    scale = {"leakage": area, "bulk_modulus": volume / area}
    out = {}
    for method, values in found.estimates.items():
        for name, factor in scale.items():
            right = np.interp(time, truth.time, _reference(truth, name, profile, true)) * factor
            flag = found.observable[name] & settled
            error = np.abs(values[name][flag] / right[flag] - 1.0)
            out[method, name] = (float(np.median(error)) if error.size else float("nan"), float(flag.mean()))
    return out


def _reference(truth: Truth, name: str, profile: Unit, true: Unit) -> NDArray[np.float64]:
    """True leakage, or bulk modulus at the profile's (not the true unit's) reference pressure."""
    if name == "leakage":
        return np.asarray(truth["leakage"])
    atmosphere, n = 101325.0, true.oil.polytropic_index

    def per_air(p: float) -> float:
        return float(atmosphere ** (1.0 / n) / (n * (p + atmosphere) ** ((n + 1.0) / n)))

    at_true = 1.0 / np.asarray(truth["bulk_modulus"])
    stiff = 1.0 / true.oil.bulk_modulus - true.oil.air_fraction * per_air(true.oil.reference_pressure)
    air = (at_true - stiff) / per_air(true.oil.reference_pressure)
    return np.asarray(1.0 / (stiff + air * per_air(profile.oil.reference_pressure)))


def summary(outcomes: list[Outcome]) -> str:
    """The tables of ``reports/validation.md`` (Markdown)."""
    families = sorted({o.family for o in outcomes if o.family != "healthy"})
    answers = sorted({o.answer for o in outcomes if o.answer} | set(families))
    head = ["true family", "logs", "detected", "right family", *answers, "median delay", "median onset error"]
    lines = ["| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
    for family in families:
        mine = [o for o in outcomes if o.family == family]
        hits = [o for o in mine if o.answer and not o.early]
        right = [o for o in hits if o.answer == family]
        delay = np.median([o.detected_s - o.onset_s for o in hits]) if hits else float("nan")
        onset = np.median([abs(o.answered_onset_s - o.onset_s) for o in hits]) if hits else float("nan")
        counts = " | ".join(str(sum(o.answer == a for o in mine) or "·") for a in answers)
        share = f"{len(right)} ({100 * len(right) / len(mine):.0f} %)"
        lines.append(
            f"| {family} | {len(mine)} | {len(hits)} | {share} | {counts} | {delay:.1f} s | {onset:.1f} s |"
        )
    faulty = [o for o in outcomes if o.family != "healthy"]
    healthy = [o for o in outcomes if o.family == "healthy"]
    right_share = np.mean([o.answer == o.family and not o.early for o in faulty]) if faulty else float("nan")
    alarms = sum(bool(o.answer) for o in healthy)
    early = sum(o.early for o in faulty)
    commonest = max((sum(o.family == f for o in faulty) for f in families), default=0)
    lines += [
        "",
        f"- right family: **{100 * right_share:.0f} %** of {len(faulty)} faulty logs",
        f"- alarms on {len(healthy)} healthy logs: **{alarms}**; "
        f"before the onset of {len(faulty)} faulty ones: {early}",
        f"- baselines: always answering the commonest family is right in "
        f"{100 * commonest / max(len(faulty), 1):.0f} %; "
        "never alarming in 0 %, with no false alarm; always alarming has every healthy log as a false alarm",
    ]  # fmt: skip
    lines += ["", "| said confidence | answers | mean confidence | right |", "| --- | --- | --- | --- |"]
    answered = [o for o in outcomes if o.answer]
    for low, high in ((0.0, 0.6), (0.6, 0.8), (0.8, 0.95), (0.95, 1.01)):
        part = [o for o in answered if low <= o.confidence < high]
        if part:
            lines.append(
                f"| {100 * low:.0f} to {min(100 * high, 100):.0f} % | {len(part)} "
                f"| {100 * np.mean([o.confidence for o in part]):.0f} % "
                f"| {100 * np.mean([o.answer == o.family for o in part]):.0f} % |"
            )
    head = ["estimate", "median error", "90 % of logs below", "logs with it observable", "share of time"]
    lines += ["", "| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
    for method in ("ekf", "svsf"):
        for name in ("leakage", "bulk_modulus"):
            errors = np.array([o.errors[method, name] for o in outcomes])
            known = errors[np.isfinite(errors[:, 0])]
            if known.size:
                lines.append(
                    f"| {method.upper()} {name.replace('_', ' ')} | {100 * np.median(known[:, 0]):.1f} % "
                    f"| {100 * np.percentile(known[:, 0], 90):.1f} % | {len(known)} of {len(errors)} "
                    f"| {100 * errors[:, 1].mean():.0f} % |"
                )
    return "\n".join(lines) + "\n"


def report_text(outcomes: list[Outcome], data: Dataset) -> str:
    """The whole of ``validation.md``, with how it was made."""
    return (
        f"# Validation on {data.recipe.name}\n\n"
        f"{data.recipe.description}\n\n"
        f"Made by `fdd validate` on the data set of `datasets/{data.recipe.name}.yaml` "
        f"(seed {data.recipe.seed}, {len(data.units)} units, {len(data.logs)} logs). Each unit's profile is "
        "identified from its own healthy calibration runs; no unit was in the training data.\n\n"
        f"{summary(outcomes)}"
    )


def outcomes_csv(outcomes: list[Outcome]) -> str:
    """One line per log: truth, answer and errors of the estimates."""
    keys = [(m, n) for m in ("ekf", "svsf") for n in ("leakage", "bulk_modulus")]
    fields = (
        "file", "family", "severity", "onset_s", "load", "duty", "verdict", "answer", "fault", "confidence",
        "answered_onset_s", "detected_s", "answered_severity",
    )  # fmt: skip
    lines = [",".join((*fields, *(f"{m}_{n}_error" for m, n in keys)))]
    for o in outcomes:
        values = [str(getattr(o, f)) for f in fields] + [f"{o.errors[k][0]:.4f}" for k in keys]
        lines.append(",".join(values))
    return "\n".join(lines) + "\n"
