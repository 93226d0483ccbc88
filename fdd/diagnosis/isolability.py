"""Which faults a set of sensors cannot tell apart: the ambiguity groups.

From the structure of the axis (what a structural analysis of its equations gives; Yu 1997,
doi 10.1016/S0967-0661(97)00130-1, for pump against piston leakage): pump and piston leakage
join the same two nodes; case and outside leakage need the balance of each chamber, so both
chamber pressures; drive faults need motor current.
"""

from __future__ import annotations

from collections.abc import Iterable

from fdd.faults import fault, faults_of

_CHAMBERS = frozenset({"pressure_1", "pressure_2"})


def ambiguity_group(family: str, channels: Iterable[str]) -> list[str]:
    """Faults of `family` that these channels cannot separate, the likeliest first.

    Examples
    --------
    >>> ambiguity_group("leakage", ["position", "pump_speed", "pressure_difference"])[:3]
    ['internal_leakage', 'pump_wear', 'external_leakage']
    >>> ambiguity_group("aeration", [])
    ['aeration']
    """
    have = frozenset(channels)
    if family == "leakage":
        group = ["internal_leakage", "pump_wear"]
        if not have >= _CHAMBERS:
            group += ["external_leakage", "case_drain_seal_failure"]
        return group
    if family == "check_valve":
        group = ["check_valve_stuck_open"]
        if not (have >= _CHAMBERS and "pressure_accumulator" in have):
            group.append("check_valve_clogged")
        return group
    if family == "sensor":
        # Without the chambers nothing contradicts a biased pressure difference but the estimators' trust.
        return ["pressure_sensor_bias", "pressure_sensor_drift"]
    return list(faults_of(family)) or ["unknown"]


def confusable_families(family: str, channels: Iterable[str]) -> tuple[str, ...]:
    """Families whose residuals point the same way with these channels."""
    have = frozenset(channels)
    table = {
        "leakage": () if have >= _CHAMBERS else ("check_valve", "relief_valve"),
        "check_valve": () if have >= _CHAMBERS else ("leakage", "relief_valve"),
        "seal_wear": () if "load_force" in have else ("friction",),
        "motor": () if "motor_current" in have else ("friction",),
    }
    return table.get(family, ())


def family_of(name: str) -> str:
    """Family of a fault of the catalogue."""
    return fault(name).family
