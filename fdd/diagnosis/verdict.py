"""From windows to the answer: which family, since when, how badly, how sure, and why."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.isolability import ambiguity_group, confusable_families
from fdd.diagnosis.model import Model
from fdd.diagnosis.sequential import CLIP_HIGH, CLIP_LOW, PageTest
from fdd.faults import FAMILIES
from fdd.residuals.features import FEATURES, HOP, RESIDUALS, USUAL_SCORE, WINDOW, WINDOW_FEATURES
from fdd.unit import Unit

Array = NDArray[np.float64]

ALARM_DOUBT = 3.0
"""Log odds of a true alarm at the threshold itself: one alarm in twenty-one would be false."""


def family_probabilities(model: Model, probabilities: Array, test: PageTest) -> dict[str, float]:
    """Probabilities of all families, given the windows that speak for a fault.

    Parameters
    ----------
    probabilities : (m, classes) of the windows since onset (or the last ones, without alarm).
    test : its statistic says how sure a fault is at all.
    """
    evidence = test.peak if test.alarmed else test.statistic
    healthy = 1.0 / (1.0 + math.exp(min(max(evidence - test.threshold + ALARM_DOUBT, -50.0), 50.0)))
    index = {c: i for i, c in enumerate(model.classes)}
    shares = np.full(len(model.classes), 1.0 / max(len(model.classes) - 1, 1))
    if probabilities.size:
        weight = 1.0 - probabilities[:, index["healthy"]]
        shares = weight @ probabilities / max(float(weight.sum()), 1e-9)
    shares[index["healthy"]] = 0.0
    shares = np.power(np.maximum(shares, 1e-6), 1.0 / model.manifest.temperature)
    shares[index["healthy"]] = 0.0
    shares /= shares.sum()
    out = dict.fromkeys(FAMILIES, 0.0)
    out["healthy"] = healthy
    for name, i in index.items():
        if name != "healthy":
            out[name] += (1.0 - healthy) * float(shares[i])
    return out


def onset_time(times: Array, healthy: Array, first_time: float) -> float:
    """Most likely time of change, s.

    The split of the windows' log odds of a fault that parts them best into two levels, the later one higher
    (Hinkley 1970, doi 10.1093/biomet/57.1.1). Levels, because on a machine that the classifier does
    not know the odds may lie anywhere before a fault, and only their rise tells. Where the first level is
    nearer to the second than to even odds, the log began with the fault. A window reaches back `WINDOW`
    seconds, so the change lies half of that before the first window that speaks for it.

    Parameters
    ----------
    times : (m,) window ends. healthy : (m,) probability of healthy. first_time : start of the log.

    Examples
    --------
    >>> odds_even_then_sure = np.array([0.5, 0.6, 0.5, 0.55, 0.02, 0.01, 0.01, 0.02])
    >>> onset_time(np.arange(8) * 0.5 + 4.0, odds_even_then_sure, 0.0)
    4.75
    """
    odds = np.clip(np.log1p(-healthy) - np.log(healthy), CLIP_LOW, CLIP_HIGH)
    n = odds.size
    if n < 2:
        return first_time
    count = np.arange(1, n)
    total = np.cumsum(odds)
    before = total[:-1] / count
    after = (total[-1] - total[:-1]) / (n - count)
    parted = count * (n - count) / n * np.square(after - before) * np.sign(after - before)
    split = int(np.argmax(parted))
    if before[split] > 0.5 * after[split]:
        return first_time
    return max(float(times[split + 1]) - 0.5 * WINDOW - 0.5 * HOP, first_time)


def leading_fault(family: str, features: Array, drifting: bool) -> str:
    """Member of the family that the residuals point at (the first of its ambiguity group else)."""
    f = dict(zip(FEATURES, features, strict=True))
    if family == "sensor":
        return "pressure_sensor_drift" if drifting else "pressure_sensor_bias"
    if family == "check_valve":
        return "check_valve_clogged" if f["refeed_deficit"] > f["valve_largest"] else "check_valve_stuck_open"
    if family == "friction":
        return "oil_degradation"
    if family == "motor":
        return "motor_degradation"
    if family == "relief_valve":
        return "relief_valve_stuck_open"
    if family == "leakage":
        # Into the inner circuit from both chambers alike: through the case. From one of them while
        # the accumulator loses oil: outside. Else across the ports.
        if min(f["valve_1"], f["valve_2"]) > f["leakage"]:
            return "case_drain_seal_failure"
        if f["valve_largest"] > f["leakage"] and f["accumulator_change"] < 0.0:
            return "external_leakage"
        return "internal_leakage"
    return family if family != "unknown" else "unknown"


def severity(name: str, features: Array, unit: Unit) -> float | None:
    """Severity on the catalogue's scale, clipped to [0, 1]; None where the residuals give no size."""
    f = dict(zip(FEATURES, features, strict=True))
    total = unit.pump.total_leakage
    if name == "internal_leakage":
        value = (math.exp(max(f["leakage"], f["loss_largest"])) - 1.0) * total / 12e-12
    elif name == "seal_wear":
        change = f["friction"]
        value = -change / 0.65 if change < 0.0 else change
    elif name == "aeration":
        p, n, atmosphere = unit.oil.reference_pressure, unit.oil.polytropic_index, 101325.0
        per_air = atmosphere ** (1.0 / n) / (n * (p + atmosphere) ** ((n + 1.0) / n))
        value = (math.exp(f["compliance"]) - 1.0) / unit.oil.bulk_modulus / per_air / 0.025
    elif name in ("check_valve_stuck_open", "relief_valve_stuck_open"):
        # An orifice of 1e-4 m³/s at 1 MPa, linearised at the working pressure of some 0.5 MPa.
        # While the load pushes one way, only a chamber's whole loss is known.
        own = f["valve_largest"] if name == "check_valve_stuck_open" else f["leakage"]
        ratio = math.exp(max(own, f["loss_largest"]))
        value = (ratio - 1.0) * total * 0.5e6 / (1e-4 * math.sqrt(0.5))
    elif name == "oil_degradation":
        ratio = math.exp(-f["leakage"])  # of viscosity: leakage goes with its inverse
        value = 2.0 * (1.0 - ratio) if ratio < 1.0 else ratio - 1.0
    elif name == "motor_degradation":
        value = (1.0 - math.exp(-f["torque"])) / 0.3
    elif name in ("pressure_sensor_bias", "pressure_sensor_drift"):
        value = abs(f["redundancy"]) * 50e3 / 250e3
    else:
        return None
    return float(min(max(value, 0.0), 1.0))


_SENTENCES = {
    "leakage": lambda v: f"leakage across the ports is {math.exp(v):.2f} times healthy at equal viscosity",
    "valve_1": lambda v: (
        f"chamber 1 loses {math.exp(v) - 1.0:.2f} times the healthy leakage to the inner circuit"
    ),
    "valve_2": lambda v: (
        f"chamber 2 loses {math.exp(v) - 1.0:.2f} times the healthy leakage to the inner circuit"
    ),
    "valve_largest": lambda v: f"one chamber alone loses {math.exp(v) - 1.0:.2f} times the healthy leakage",
    "loss_1": lambda v: f"chamber 1 loses {math.exp(v):.2f} times as much oil as when healthy, in all",
    "loss_2": lambda v: f"chamber 2 loses {math.exp(v):.2f} times as much oil as when healthy, in all",
    "loss_largest": lambda v: f"one chamber loses {math.exp(v):.2f} times as much oil as when healthy",
    "jump": lambda v: (
        f"the flow balance changed at once, by {math.expm1(v) + USUAL_SCORE:.1f} standard deviations"
    ),
    "accumulator": lambda v: f"the accumulator lies {100 * v:+.0f} kPa above its healthy pressure",
    "compliance": lambda v: f"the oil is {math.exp(v):.2f} times as compliant as when healthy",
    "friction": lambda v: f"Coulomb friction is {1.0 + v:.2f} times healthy",
    "viscous": lambda v: f"friction at 50 mm/s differs by {100 * v:+.0f} % of healthy Coulomb friction",
    "redundancy": lambda v: f"measured pressure difference is off the chambers' by {50 * v:+.0f} kPa",
    "torque": lambda v: f"motor current per shaft torque is {math.exp(v):.2f} times healthy",
    "refeed_deficit": lambda v: f"the low side lies {100 * v:.0f} kPa below what refeeding should keep",
    "low_side": lambda v: f"the low side lies {200 * v:+.0f} kPa above the accumulator, against healthy",
    "drive": lambda v: f"pump speed follows its demand at {100 * math.exp(v):.1f} %",
    "innovation": lambda v: f"innovations are {math.exp(0.5 * v):.2f} times their healthy size",
}


def evidence(model: Model, features: Array, spread: Array | None = None, most: int = 3) -> list[str]:
    """One sentence for each residual that stands out most, with figures and units.

    A residual stands out against the unit's healthy baseline or against the log's own beginning.
    """
    z = np.abs(model.standardise(features[None, :], spread)[0])
    n = len(WINDOW_FEATURES)
    strength = np.maximum(z[: len(RESIDUALS)], z[n:])
    # The larger valve is one of the two, and a chamber that loses less than nothing is no evidence.
    valves = [RESIDUALS.index(v) for v in ("valve_1", "valve_2")]
    # A jump is zero on nearly every healthy window: its spread there is no measure.
    strength[[RESIDUALS.index(v) for v in ("valve_largest", "loss_largest", "jump")]] = 0.0
    strength[[i for i in valves if features[i] <= 0.0]] = 0.0
    # A chamber's whole loss is worth a sentence only where its parts are not known one by one.
    for loss, valve in (("loss_1", "valve_1"), ("loss_2", "valve_2")):
        if max(strength[RESIDUALS.index("leakage")], strength[RESIDUALS.index(valve)]) >= 2.0:
            strength[RESIDUALS.index(loss)] = 0.0
    out: list[str] = []
    for i in np.argsort(-strength)[:most]:
        if strength[i] < 2.0 and out:
            break
        sentence = _SENTENCES[RESIDUALS[i]](float(features[i]))
        measure = f"{z[i]:.1f} healthy standard deviations"
        if z[n + i] > z[i]:
            measure += f", {z[n + i]:.1f} against the beginning of the log"
        out.append(f"{sentence[0].upper()}{sentence[1:]} ({measure}).")
    return out


def finding(
    model: Model, unit: Unit, channels: tuple[str, ...], times: Array, features: Array, probabilities: Array,
    test: PageTest, first_time: float, spread: Array, *, refine: bool,
) -> tuple[FaultFinding, dict[str, float]]:  # fmt: skip
    """The finding behind a standing alarm, and all families' probabilities.

    Parameters
    ----------
    times, features, probabilities : (m,), (m, k), (m, classes) of all windows so far.
    spread : (k,) the unit's own healthy scale of the features.
    refine : estimate the onset from all windows (at the end of a log), not from the test alone.
    """
    column = list(model.classes).index("healthy")
    onset = onset_time(times, probabilities[:, column], first_time)
    if not refine:
        onset = max(min(onset, test.since - 0.5 * WINDOW), first_time)
    onset = min(onset, test.alarm_time)
    since = times >= onset + 0.5 * WINDOW
    if not since.any():
        since = times >= test.alarm_time
    chosen = probabilities[since]
    all_families = family_probabilities(model, chosen, test)
    family = max((k for k in all_families if k != "healthy"), key=lambda k: all_families[k])
    # Windows that speak for the fault weigh most: an intermittent fault is off half the time.
    weight = 1.0 - chosen[:, column] + 1e-6
    mean = np.asarray(weight @ features[since] / weight.sum())
    redundancy = features[since][:, FEATURES.index("redundancy")]
    half = redundancy.size // 2
    drifting = half > 4 and abs(np.median(redundancy[half:])) > 1.4 * abs(np.median(redundancy[:half])) + 0.2
    name = leading_fault(family, mean, bool(drifting))
    late = times[since] >= 0.5 * (onset + times[-1])  # ramps grow, and estimates settle
    grown = np.asarray(weight[late] @ features[since][late] / weight[late].sum()) if late.any() else mean
    group = ambiguity_group(family, channels)
    group = [name, *(g for g in group if g != name)]
    for other, p in sorted(all_families.items(), key=lambda kv: -kv[1]):
        near = p > 0.15 or (other in confusable_families(family, channels) and p > 0.05)
        if other not in ("healthy", family) and near:
            group += [g for g in ambiguity_group(other, channels)[:1] if g not in group]
    return (
        FaultFinding(
            fault=name, family=family, ambiguity=group, confidence=round(all_families[family], 4),
            onset_s=round(onset, 2), detected_s=round(test.alarm_time, 2),
            severity=_rounded(severity(name, grown, unit)), evidence=evidence(model, mean, spread),
        ),
        all_families,
    )  # fmt: skip


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
