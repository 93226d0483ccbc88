"""An axis's life as the store has it: its hours or days as answers, for the same trend as that of logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Literal

import fdd
from fdd.diagnosis.estimates import healthy_of
from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Estimate, FaultFinding, Quality
from fdd.errors import InputError
from fdd.faults import FAMILIES
from fdd.history.trend import severity_one, trend_of
from fdd.service.store import Store
from fdd.service.store.records import SPANS_S
from fdd.unit import Unit, shipped_units

Each = Literal["minute", "hour", "day"]
Row = Mapping[str, Any]

HEALTHY_LEAKAGE, LEAKAGE_FACTOR = "leakage_healthy", "leakage_factor"
"""Rolled up beside the leakage: what the profile says of it at that oil temperature, and their ratio."""
LEAST_DAYS = 8
"""From which on a life is told by the day, and not by the hour."""
MOST_ALARMS = 100_000
profile_key, said_key, worked_key = "profile {}".format, "said {}".format, "worked {}".format
"""Words of the store: a profile (YAML) by its SHA-256; by what name an axis's blocks call their profile; the
journal's last row that was worked, of an axis put off."""
_FORM = {"minute": "%Y-%m-%d %H:%M", "hour": "%Y-%m-%d %H:00", "day": "%Y-%m-%d"}


def axis_of(store: Store, name: str | None) -> tuple[str, Unit | None]:
    """An axis (None for the one that there is) and its profile, None where the store does not hold it.

    Raises InputError: no such axis, or several.
    """
    axes = {str(row["name"]): row for row in store.axes()}
    chosen = next(iter(axes)) if name is None and len(axes) == 1 else name or ""
    if chosen not in axes:
        problem, known = f"no axis {name}" if name else f"{len(axes)} axes", ", ".join(list(axes)[:20])
        raise InputError(problem, where="the store", mend=f"give --axis, of {known or 'none yet'}")
    row = axes[chosen]
    text = store.meta(profile_key(row["profile_sha256"] or ""))
    if text is not None:
        return chosen, Unit.from_yaml(text, where=f"the profile of axis {chosen}")
    return chosen, Unit.load(row["unit"]) if row["unit"] in shipped_units() else None


def answers_of(store: Store, axis: str, unit: Unit, each: Each, since: float = 0.0) -> list[Diagnosis]:
    """An axis's minutes, hours or days since a time (Unix seconds) in their order, each as a log's answer.

    The standard deviation is of the estimate: its own and what it varied by, of leakage at one temperature.
    A span has the alarms that stood in it.
    """
    names = (*ESTIMATED, HEALTHY_LEAKAGE, LEAKAGE_FACTOR)
    rows = {n: {r["start_wall"]: r for r in store.rollups(axis, n, each, since)} for n in names}
    alarms = [a for a in store.alarms(limit=MOST_ALARMS) if a["axis"] == axis]
    spans = sorted({start for found in rows.values() for start in found})
    healthy, out = healthy_of(unit), []
    for start in spans:
        stood = [
            FaultFinding.model_validate(a["body"])
            for a in reversed(alarms)
            if a["raised_wall"] < start + SPANS_S[each] and (a["returned_wall"] or math.inf) >= start
        ]
        known = {n: _estimate(n, healthy[n], rows[n].get(start)) for n in ESTIMATED}
        warm, factor = (rows[n].get(start) for n in (HEALTHY_LEAKAGE, LEAKAGE_FACTOR))
        if warm is not None:
            known["leakage"] = _estimate("leakage", warm["mean"], factor, warm["mean"])
        out.append(
            Diagnosis(
                log=f"{datetime.fromtimestamp(start, UTC):{_FORM[each]}}", axis=axis, unit=unit.name,
                duration_s=SPANS_S[each], samples=0, verdict="faulty" if stood else "healthy", faults=stood,
                probabilities=dict.fromkeys(FAMILIES, 0.0), quality=Quality(),
                versions={"fdd": fdd.__version__},
                started_at=datetime.fromtimestamp(start, UTC).isoformat().replace("+00:00", "Z"),
                estimates=known,
            )
        )  # fmt: skip
    return out


def sentence_of(store: Store, axis: str, quantity: str, each: Each, since: float) -> str:
    """Where a quantity is going, as `fdd trend` tells it; "" of another one, and without a profile."""
    if quantity not in ESTIMATED or axis not in {row["name"] for row in store.axes()}:
        return ""
    _, unit = axis_of(store, axis)
    if unit is None or not (answers := answers_of(store, axis, unit, each, since)):
        return ""
    life, _ = trend_of(answers, severity_one(unit), each)
    return next((t.sentence for t in life.trends if t.quantity == quantity), "")


def _estimate(name: str, healthy: float, row: Row | None, scale: float = 1.0) -> Estimate:
    """Of a span's row; not observable without one."""
    value, std = (None, None) if row is None else (scale * row["mean"], scale * row["std"])
    unit, known = ESTIMATED[name][0], row is not None
    return Estimate(unit=unit, baseline=healthy, value=value, std=std, observable=known)


def told_by(store: Store, axis: str, since: float) -> Each:
    """By what a life is told: by the day, where there are enough, else by the hour."""
    days = store.rollups(axis, HEALTHY_LEAKAGE, "day", since)
    return "day" if len(days) >= LEAST_DAYS else "hour"
