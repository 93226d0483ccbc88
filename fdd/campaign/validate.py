"""How good the whole path is on a generated data set: detection, isolation, delays, estimates."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.campaign.card import table
from fdd.campaign.dataset import Dataset, How, over_units
from fdd.campaign.labels import CLASSES, ROWS_LOST, SEVERAL, visibility_class
from fdd.campaign.scores import Outcome, figures, wilson
from fdd.campaign.spreads import identified_unit
from fdd.diagnosis.findings import Trajectories
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import fault
from fdd.plant.oil import air_compliance
from fdd.plant.state import Truth
from fdd.unit import Unit

HAD, NEVER, UNSIGNED = "law of signatures or training", "law it never saw", "fault without a signature"
SETTLED_S = 5.0
"""After the start and after a fault's step the estimators are given this long."""


def validate(directory: str | Path, model: Model | None = None, **how: Unpack[How]) -> list[Outcome]:
    """Diagnose every log of a data set on profiles identified from its units' own baselines; an InputError
    where it is no data set, or one without baselines."""
    return over_units(_unit_outcomes, [directory], model or Model.load(), **how)


def _unit_outcomes(data: Dataset, unit: str, model: Model) -> list[Outcome]:
    profile, true, outcomes = identified_unit(data, unit), data.true_unit(unit), []
    for entry in data.logs_of(unit):
        pipeline = Pipeline(profile, model, axis=entry.unit, log=entry.file)
        alarms = len(pipeline.push(data.samples(entry)))
        found = pipeline.finish()
        errors = estimate_errors(pipeline.trajectories(), data.truth(entry), profile, true)
        outcomes.append(Outcome(entry, found, errors, alarms))
    return outcomes


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
    right = {"leakage": truth["leakage"], "bulk_modulus": _true_modulus(truth, profile, true)}
    out = {}
    for method, values in found.estimates.items():
        for name, factor in scale.items():
            expected = np.interp(time, truth.time, right[name]) * factor
            flag = found.observable[name] & settled
            error = np.abs(values[name][flag] / expected[flag] - 1.0)
            out[method, name] = (float(np.median(error)) if error.size else float("nan"), float(flag.mean()))
    return out


def _true_modulus(truth: Truth, profile: Unit, true: Unit) -> NDArray[np.float64]:
    """True bulk modulus at the profile's (not the true unit's) reference pressure."""
    oil = true.oil
    there, here = (
        float(air_compliance(p, oil.polytropic_index))
        for p in (oil.reference_pressure, profile.oil.reference_pressure)
    )
    stiff = 1.0 / oil.bulk_modulus - oil.air_fraction * there
    air = (1.0 / np.asarray(truth["bulk_modulus"]) - stiff) / there
    return np.asarray(1.0 / (stiff + air * here))


def summary(outcomes: list[Outcome], model: Model | None = None) -> str:
    """What ``reports/validation.md`` says (Markdown); `model` is the one that was asked, None the shipped."""
    rows = []
    for kind in sorted({f.fault for o in outcomes for f in o.entry.faults}):
        mine = [o for o in outcomes if kind in {f.fault for f in o.entry.faults}]
        hits = [o for o in mine if o.timely]
        answers = Counter(o.timely[0].fault.replace("_", " ") for o in hits)
        late = [o.timely[0].detected_s - min(f.onset_s for f in o.entry.faults) for o in hits]
        rows.append([
            kind.replace("_", " "), str(len(mine)), str(len(hits)),
            ", ".join(f"{a} {n}" for a, n in answers.most_common()) or "-",
            f"{np.median(late):.1f} s" if late else "-",
        ])  # fmt: skip
    head = ["true fault", "logs", "found", "leading answers", "median alarm after"]
    lines = ["", *table(head, rows)]
    rows = []
    for method in ("ekf", "svsf"):
        for name in ("leakage", "bulk_modulus"):
            errors = np.array([o.errors[method, name] for o in outcomes])
            known = errors[np.isfinite(errors[:, 0])]
            if known.size:
                rows.append([
                    f"{method.upper()} {name.replace('_', ' ')}", f"{100 * np.median(known[:, 0]):.1f} %",
                    f"{100 * np.percentile(known[:, 0], 90):.1f} %", f"{len(known)} of {len(errors)}",
                    f"{100 * errors[:, 1].mean():.0f} %",
                ])  # fmt: skip
    head = ["estimate", "median error", "90 % of logs below", "logs with it observable", "share of time"]
    more = [*by_visibility(outcomes), *by_law(outcomes, model or Model.load())]
    return figures(outcomes) + "\n".join([*lines, *table(head, rows), *more])


def _share(outcomes: list[Outcome], what: str) -> str:
    return wilson(sum(bool(getattr(o, what)) for o in outcomes), len(outcomes))


def by_visibility(outcomes: list[Outcome]) -> list[str]:
    """What is found and named, by what the faults do to their logs; [] without twins (Markdown)."""
    seen: dict[tuple[str, str], list[Outcome]] = {}
    for o in outcomes:
        if o.entry.visibility is not None:
            faults = [f.fault.replace("_", " ") for f in o.entry.faults]
            for name in ("all", faults[0] if len(faults) == 1 else SEVERAL):
                seen.setdefault((name, visibility_class(o.entry.visibility)), []).append(o)
    kinds = sorted({name for name, _ in seen} - {"all", SEVERAL})
    rows = [
        [name, each, _share(mine, "timely"), _share(mine, "named")]
        for name in ("all", *kinds, SEVERAL) for each in (*CLASSES, ROWS_LOST)
        if (mine := seen.get((name, each)))
    ]  # fmt: skip
    head = ["true fault", "largest rms, deviations of noise", "found", "named, or in the group named"]
    return table(head, rows) if rows else []


def by_law(outcomes: list[Outcome], model: Model) -> list[str]:
    """What is found and named of single faults, by whether the training had their law and by each law; [] for
    data without laws (Markdown)."""
    seen: dict[tuple[str, ...], list[Outcome]] = {key: [] for key in ((HAD,), (NEVER,), (UNSIGNED,))}
    for o in outcomes:
        if len(o.entry.faults) == 1 and (law := o.entry.faults[0].law) is not None:
            true = fault(o.entry.faults[0].fault)
            group = UNSIGNED if not true.signatures else HAD if model.had(true.id, law) else NEVER
            seen[group,].append(o)
            seen.setdefault((true.id, law, group), []).append(o)
    rows = [
        [key[0].replace("_", " "), *(key[1:] or ("", "")),
         *(_share(mine, what) for what in ("timely", "led", "named"))]
        for key, mine in (*list(seen.items())[:3], *sorted(list(seen.items())[3:])) if mine
    ]  # fmt: skip
    head = ["true fault", "law", "training", "found", "named by the leading answer", "or in its group"]
    return table(head, rows) if rows else []


def report_text(outcomes: list[Outcome], data: Dataset, model: Model | None = None) -> str:
    """The whole of ``validation.md``, with how it was made; `model` as in `summary`."""
    recipe = data.recipe
    return (
        f"# Validation on {recipe.name}\n\n{recipe.description}\n\n"
        f"Made by `fdd validate` on the data set of `datasets/{recipe.name}.yaml` "
        f"(seed {recipe.seed}, {len(data.units)} units, {len(data.logs)} logs). Each unit's profile is "
        "identified from its own healthy calibration runs; no unit was in the training data.\n\n"
        f"{summary(outcomes, model)}"
    )


def outcomes_csv(outcomes: list[Outcome]) -> str:
    """One line per log: truth, answer, errors of the estimates; with twins, how visible its faults are."""
    keys = [(m, n) for m in ("ekf", "svsf") for n in ("leakage", "bulk_modulus")]
    twins = any(o.entry.twin for o in outcomes)
    rows = []
    for o in outcomes:
        row: dict[str, object] = {
            "file": o.entry.file, "structure": o.entry.structure, "load": o.entry.scenario.load,
            "duty": o.entry.scenario.duty, "verdict": o.found.verdict,
        }  # fmt: skip
        for name, faults in (("true", o.entry.faults), ("answered", o.found.faults)):
            for what in ("fault", "severity", "onset_s"):
                row[f"{name}_{what}"] = " ".join(str(getattr(f, what)) for f in faults)
        row["true_law"] = " ".join(f.law or "-" for f in o.entry.faults)
        row["true_profile"] = " ".join(f.profile for f in o.entry.faults)
        row["confidence"] = " ".join(str(f.confidence) for f in o.found.faults)
        row |= {f"{m}_{n}_error": round(o.errors[m, n][0], 4) for m, n in keys}
        if twins:
            seen = o.entry.visibility
            row |= {
                "visible": o.entry.visible, "largest_rms": o.entry.largest_rms,
                "visibility": "" if seen is None else visibility_class(seen),
                "found": bool(o.timely), "named": o.named,
            }  # fmt: skip
        rows.append(row)
    return str(pd.DataFrame(rows).to_csv(index=False))
