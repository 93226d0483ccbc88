"""Two logs of a unit beside each other: estimates, balances, findings and duty.

Much that differs between two logs is their duty, what they asked of the actuator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Estimate, Trajectories
from fdd.history import Closure, Comparison, DutyRow, EstimateChange, LogSaid
from fdd.history.line import holm
from fdd.report.words import candidates
from fdd.samples import CHANNELS, PRESSURES, Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

LEAST_INFORMATIVE_FRAMES = 8
"""Fewest frames with information on a balance for a mean over the log: four seconds."""
NO_CHANGE = "no estimate changed beyond its uncertainty"
LEVEL = 0.05
TEST = (
    "two-sided z test of each difference over its standard deviation, 95 % over all rows together (Holm); "
    "which is made of both filters' own and of what healthy logs differ by"
)
BETWEEN = {"leakage": 0.05, "bulk_modulus": 0.03, "coulomb_friction": 0.09, "viscous_friction": 0.09}
"""Relative std from healthy log to healthy log: 1 to 2 K between the gap and the temperature's sensor, at
4 % a kelvin; a model that is fitted to long and to short strokes (2.4 % on a rig of another make). Air that
came or went is a change. Friction: thesis Table 5.1, where no profile tells its own (trial_spread)."""
UNMEASURED = 0.4
"""The same of leakage, where nobody measures the oil's temperature: 10 K."""
VISCOSITY_LAW_DOUBT = 0.05
"""Assumption: by how much (ln) the viscosity law errs for each factor of e that it takes out."""

SIGNALS = ("position", "pump_speed", *PRESSURES, "motor_current", "load_force", "oil_temperature")
SIGNED = ("position", "oil_temperature")
PERCENTILES = (5.0, 50.0, 95.0)


@dataclass(frozen=True)
class Side:
    """One log with its answer and what is behind it."""

    answer: Diagnosis
    trajectories: Trajectories
    samples: Samples


def compare(a: Side, b: Side, unit: Unit) -> Comparison:
    """What changed from log `a` to `b`, both diagnosed on the profile `unit`."""
    measured = has(a.samples, "oil_temperature") and has(b.samples, "oil_temperature")
    both = (a.answer.estimates, b.answer.estimates)
    changes = [_change(name, both[0][name], both[1][name], unit, measured) for name in both[0]]
    told = [row for row in changes if row.p_value is not None]
    for row, p in zip(told, holm([row.p_value or 0.0 for row in told]), strict=True):
        row.p_holm, row.changed = p, p < LEVEL
    warm = "Oil temperature is not measured in both logs: leakage is compared as it was."
    notes = [] if measured else [warm]
    notes += [note for note in a.answer.quality.notes if note in b.answer.quality.notes]
    if blind := [ESTIMATED[c.quantity][2].lower() for c in changes if c.changed is None]:
        notes.append(f"Not shown by both logs: {', '.join(blind)}.")
    one, other = (_misfits(side.trajectories) for side in (a, b))
    same = ("log", "started_at", "duration_s", "verdict", "faults")
    said = [
        LogSaid(**{name: getattr(x.answer, name) for name in same}, notes=x.answer.quality.notes)
        for x in (a, b)
    ]
    return Comparison(
        headline=_headline(changes, a.answer, b.answer), unit=unit.name, axis=a.answer.axis,
        a=said[0], b=said[1], test=TEST, estimates=changes, notes=notes,
        balances=[Closure(balance=n, a=one.get(n), b=other.get(n)) for n in dict.fromkeys([*one, *other])],
        duty=duty_rows(a.samples, b.samples),
    )  # fmt: skip


def seen(estimate: Estimate) -> tuple[float, float] | None:
    """The value that may be used, and its standard deviation; None of what the log never showed.

    While it is not observable: that at the end or the last observable one, whichever is known better.
    """
    if not estimate.observable and estimate.held is None:
        return None
    pairs = [(estimate.value, estimate.std), (estimate.held, estimate.held_std)]
    known = [(v, s) for v, s in pairs if v is not None and s is not None and s > 0.0]
    return min(known[:1] if estimate.observable else known, key=lambda pair: pair[1], default=None)


def _change(name: str, a: Estimate, b: Estimate, unit: Unit, measured: bool) -> EstimateChange:
    """One estimate in both logs, under the same conditions, and the test of its difference."""
    scales, law, conditions = (1.0, 1.0), 0.0, ""
    if name == "leakage" and a.baseline and b.baseline:
        # The healthy value at each log's own temperature tells what the viscosity law makes of it.
        scales = (unit.pump.total_leakage / a.baseline, unit.pump.total_leakage / b.baseline)
        law = VISCOSITY_LAW_DOUBT * abs(math.log(a.baseline / b.baseline)) if measured else UNMEASURED
        conditions = f"at {unit.oil.reference_temperature:.3g} °C" if measured else "temperature not measured"
    elif name == "bulk_modulus":
        conditions = f"at {unit.oil.reference_pressure * 1e-5:.3g} bar"
    (value_a, std_a), (value_b, std_b) = (
        (None, None) if (pair := seen(e)) is None else (pair[0] * k, pair[1] * k)
        for e, k in zip((a, b), scales, strict=True)
    )
    difference = std = p_value = None
    if value_a is not None and std_a is not None and value_b is not None and std_b is not None:
        between = unit.friction.trial_spread if "friction" in name else BETWEEN[name]
        usual, doubt = math.hypot(value_a, value_b) * between, 0.5 * (abs(value_a) + abs(value_b)) * law
        difference, std = value_b - value_a, float(np.linalg.norm([std_a, std_b, usual, doubt]))
        p_value = float(2.0 * ndtr(-abs(difference) / std))
    return EstimateChange(
        quantity=name, unit=a.unit, conditions=conditions, a=value_a, a_std=std_a, b=value_b, b_std=std_b,
        difference=difference, std=std, p_value=p_value, p_holm=None, changed=None,
    )  # fmt: skip


def _headline(changes: list[EstimateChange], a: Diagnosis, b: Diagnosis) -> str:
    """The faults that are found in one log only, then what changed most, in its own uncertainty."""
    parts = []
    for only, other, name in ((b, a, "B"), (a, b, "A")):
        known = {f.fault for f in other.faults}
        if new := [candidates(f) for f in only.faults if f.fault not in known]:
            parts.append(f"{', '.join(new)} found in {name} only")
    changed = [c for c in changes if c.changed and c.p_value is not None]
    # A large change's p value is 0: by the ratio then.
    most = max(changed, key=lambda c: abs(c.difference or 0.0) / (c.std or 1.0), default=None)
    if most is None:
        return "; ".join([*parts, NO_CHANGE])
    title = ESTIMATED[most.quantity][2].lower()
    if not (most.a and most.difference is not None and most.std is not None):
        return "; ".join([*parts, f"{title} changed"])
    share, spread = 100.0 * most.difference / most.a, 100.0 * 1.96 * most.std / abs(most.a)
    word = "rose" if share > 0.0 else "fell"
    parts.append(f"{title} {word} by {abs(share):.0f} ± {spread:.0f} % (95 %)")
    if others := [ESTIMATED[c.quantity][2].lower() for c in changed if c is not most]:
        parts.append(f"changed as well: {', '.join(others)}")
    return "; ".join(parts)


def _misfits(found: Trajectories) -> dict[str, float]:
    return {
        name: float(f"{np.sqrt(np.mean(np.square(part))):.4g}")
        for name, column in zip(found.feature_names, found.features.T, strict=True)
        # Frames without information on a balance are 0.
        if (part := column[column != 0.0]).size >= LEAST_INFORMATIVE_FRAMES
    }


def column(samples: Samples, channel: str) -> Array:
    """A channel, (n,), NaN where there is none; the pump's speed is its angle's where only that is there.

    Examples
    --------
    >>> log = Samples([0.0, 0.1, 0.2], {"pump_angle": [0.0, 1.0, 2.0]})
    >>> column(log, "pump_speed").tolist()
    [10.0, 10.0, 10.0]
    """
    if channel == "pump_speed" and not has(samples, channel) and "pump_angle" in samples and len(samples) > 1:
        return np.asarray(np.gradient(samples["pump_angle"], samples.time))
    return samples.get(channel)


def has(samples: Samples, channel: str) -> bool:
    """Whether the channel has any value."""
    return channel in samples and bool(np.isfinite(samples[channel]).any())


def duty_rows(a: Samples, b: Samples) -> list[DutyRow]:
    """Percentiles of the signals that either log has."""

    def percentiles(samples: Samples, name: str) -> tuple[float, float, float] | None:
        values = column(samples, name)
        values = values[np.isfinite(values)]
        if not values.size:
            return None
        low, middle, high = np.percentile(values if name in SIGNED else np.abs(values), PERCENTILES)
        return float(f"{low:.5g}"), float(f"{middle:.5g}"), float(f"{high:.5g}")

    found = [
        DutyRow(signal=name, unit=CHANNELS[name].unit, a=percentiles(a, name), b=percentiles(b, name))
        for name in SIGNALS
    ]
    return [row for row in found if row.a is not None or row.b is not None]
