"""Made-up answers of a unit's logs: a known course, a known scatter, an oil temperature of each log."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np

from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Quality

HEALTHY = {"leakage": 6.5e-12, "bulk_modulus": 2.1e8, "coulomb_friction": 130.0, "viscous_friction": 60.0}
SI = {"leakage": "m^3/(s*Pa)", "bulk_modulus": "Pa", "coulomb_friction": "N", "viscous_friction": "N*s/m"}
DAYS = 330.0


def made_up_answer(
    name: str, day: float | None, factors: dict[str, float], stds: dict[str, float], warm: float
):
    """An answer whose healthy leakage is exp(`warm`) times that at the reference temperature; `factors` and
    `stds` are of the healthy value at the log's own temperature."""
    estimates = {}
    for quantity, healthy in HEALTHY.items():
        base = healthy * (np.exp(warm) if quantity == "leakage" else 1.0)
        estimates[quantity] = Estimate(
            unit=SI[quantity], baseline=base, value=factors[quantity] * base, std=stds[quantity] * base,
            observable=True,
        )  # fmt: skip
    began = None if day is None else datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=day)
    return Diagnosis(
        log=name, axis="axis_a", unit="axis_a", duration_s=60.0, samples=60_000, verdict="healthy", faults=[],
        probabilities={"healthy": 1.0}, estimates=estimates, quality=Quality(),
        started_at=None if began is None else began.isoformat().replace("+00:00", "Z"),
    )  # fmt: skip


def life(
    seed: int, growth: float = 0.0, logs: int = 12, *, dated: bool = True,
    leaks_by: Callable[[float], float] = lambda warm: 1.0,
) -> list[Diagnosis]:  # fmt: skip
    """A life in which leakage grows by `growth` of the healthy one, straight, over `DAYS`.

    Every log errs by its own standard deviation, and by 2 % (friction 5 %) from log to log. `leaks_by` is how
    the leakage differs from the viscosity law, a factor by the log's warmth.
    """
    rng = np.random.default_rng(seed)
    days = np.sort(rng.uniform(0.0, DAYS, logs))
    days[0], days[-1] = 0.0, DAYS
    out = []
    for k, day in enumerate(days):
        warm = float(rng.normal(0.0, 0.4))
        stds = {name: float(rng.uniform(0.01, 0.04)) for name in HEALTHY}
        usual = {name: 0.05 if "friction" in name else 0.02 for name in HEALTHY}
        factors = {n: 1.0 + float(rng.normal(0.0, stds[n]) + rng.normal(0.0, usual[n])) for n in HEALTHY}
        factors["leakage"] = (factors["leakage"] + growth * day / DAYS) * leaks_by(warm)
        out.append(made_up_answer(f"run{k:02d}.mcap", float(day) if dated else None, factors, stds, warm))
    return out


def alarmed(answer: Diagnosis, fault: str, family: str) -> Diagnosis:
    """The same answer with a fault in it."""
    finding = FaultFinding(
        fault=fault, family=family, ambiguity=[fault], confidence=0.9, onset_s=3.0, detected_s=4.0
    )
    return answer.model_copy(update={"verdict": "faulty", "faults": [finding]})
