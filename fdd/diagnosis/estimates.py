"""Tracked quantities as the answer carries them, and which of them to believe.

Leakage and air absorb a filter's model errors with false confidence. So an observable estimate must also
agree with the profile's healthy value, or with a finding that explains its change.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.eha import layout
from estimators.observability import Observed
from fdd.diagnosis.findings import ESTIMATED, Estimate, FaultFinding, MethodEstimate, no_estimates
from fdd.residuals.added_tracker import AddedTracker
from fdd.residuals.quantities import Scales
from fdd.residuals.tracked import Tracked
from fdd.residuals.tracking import estimates, healthy_coulomb, healthy_viscous
from fdd.unit import Unit

CHANGES = {"leakage": 0.08, "bulk_modulus": 0.25}
"""Allowed deviation (ln) of a healthy unit from its profile: 2 K between gap and sensor at 4 % a kelvin; air
that dissolves and comes out."""
UNMEASURED = 0.4
"""The same of leakage without a thermometer: 10 K."""
OF_BASE = 0.3
"""Relative standard deviation of a number that stayed the base's, as the filters take it (`Noise`)."""
SURE = 2.0
"""Allowed deviation in standard deviations, of estimate and profile together."""
ACROSS = ("internal_leakage", "pump_wear", "case_drain_seal_failure")
OTHER_FLOW = ("external_leakage", "check_valve_stuck_open", "check_valve_clogged", "relief_valve_stuck_open",
          "shaft_seal_wear")  # fmt: skip
"""Faults whose flow has another law than leakage across the ports, which the filters take for some of it."""
NAMED = 0.5
"""Confidence from which a finding may confirm an estimate."""


def believed(
    seen: Mapping[str, Observed], records: layout.Records, unit: Unit, channels: Collection[str],
    faults: Sequence[FaultFinding],
) -> tuple[dict[str, Observed], dict[str, str]]:  # fmt: skip
    """The observable estimates, without those that agree neither with the profile nor with a finding.

    Parameters
    ----------
    seen : by quantity, (n,) each, of the EKF. records : (n,), the same. channels : of the log.
    faults : findings, whose onsets count.

    Returns
    -------
    The same, where it disagrees not valid and held at the profile's healthy value (the age is NaN then); and
    why, one clause for each quantity that may disagree. A profile that was not identified says nothing of its
    unit: all agrees.
    """
    out = dict(seen)
    why: dict[str, str] = {}
    time = records["time"]
    if unit.baseline is None or not records.size:
        return out, why
    witnesses = [f for f in faults if f.confidence >= NAMED]
    level = "pressure_accumulator" in channels or {"pressure_1", "pressure_2"} <= set(channels)
    for name, healthy, own, known in (
        ("leakage", unit.pump.total_leakage / records["viscosity"],
         unit.pump.cross_port_leakage, unit.pump.std_of("cross_port_leakage")),
        ("bulk_modulus", np.full(time.size, unit.oil.bulk_modulus),
         unit.oil.bulk_modulus, unit.oil.std_of("bulk_modulus")),
    ):  # fmt: skip
        mine, share = seen[name], OF_BASE if known is None else known / max(own, 1e-300)
        left = UNMEASURED if name == "leakage" and "oil_temperature" not in channels else CHANGES[name]
        if known is not None and share > left:
            good, why[name] = np.zeros(time.size, np.bool_), "the profile itself hardly knows it"
        elif name == "bulk_modulus" and not level:
            good, why[name] = np.zeros(time.size, np.bool_), "no channel tells at which pressure it holds"
        else:
            value = np.maximum(mine.held, 1e-300)
            off = np.log(value / healthy)
            good = np.abs(off) <= left + SURE * np.hypot(mine.held_std / value, share)
            for f in witnesses:
                since = time >= f.onset_s
                if name == "bulk_modulus":
                    good |= (f.fault == "aeration") & since & (off < 0.0)
                elif f.fault in ACROSS:
                    most = healthy + 2.0 * (f.severity or 0.0) * Scales.of(unit).fault_leakage
                    good |= since & (off > 0.0) & (value < most)
            for f in witnesses if name == "leakage" else ():
                good &= (f.fault not in OTHER_FLOW) | (time < f.onset_s)
            why[name] = "it agrees neither with the healthy profile nor with a fault that was found"
        lost = ~good & np.isfinite(mine.held)
        out[name] = replace(
            mine, valid=mine.valid & good, held=np.where(lost, healthy, mine.held),
            held_std=np.where(lost, share * healthy, mine.held_std),
            age=np.where(lost, np.nan, mine.age),
        )  # fmt: skip
    return out, why


def estimates_of(
    tracked: Tracked, unit: Unit, faults: Sequence[FaultFinding], added: Sequence[AddedTracker] = (), *,
    method: str = "ekf",
) -> dict[str, Estimate]:  # fmt: skip
    """Tracked quantities at the end of what was pushed, by one of fdd's filters, and by packages' trackers.

    Which are observable follows from the EKF and `faults`.
    """
    out, records = no_estimates(), tracked.last_records[method]
    if records.size:
        values, stds = estimates(records, unit, tracked.model)
        observed = tracked.observed()
        seen, why = believed(observed, tracked.last_records["ekf"], unit, tracked.channels, faults)
        healthy = healthy_of(unit, float(records["viscosity"][-1]))
        for name, now in seen.items():
            out[name] = Estimate(
                unit=ESTIMATED[name][0], baseline=_significant(healthy[name]),
                value=_significant(values[name][-1]), std=_significant(stds[name][-1]),
                observable=bool(now.valid[-1]) and not tracked.lost,
                held=_significant(now.held[-1]), held_std=_significant(now.held_std[-1]),
                age_s=_significant(now.age[-1]), information_std=_significant(now.information_std[-1]),
                held_because=why.get(name) if observed[name].valid[-1] > now.valid[-1] else None,
            )  # fmt: skip
    for each in added:
        for name, pair in each.last().items():
            value, std = (float(f"{number:.5g}") for number in pair)
            out[name].methods[each.name] = MethodEstimate(value=value, std=std)
    return out


def healthy_of(unit: Unit, viscosity: float = 1.0) -> dict[str, float]:
    """What the profile says of each estimate (SI), at a viscosity over that at its reference temperature."""
    return {
        "leakage": unit.pump.total_leakage / viscosity,
        "bulk_modulus": unit.oil.bulk_modulus,
        "coulomb_friction": healthy_coulomb(unit),
        "viscous_friction": healthy_viscous(unit),
    }


def _significant(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
