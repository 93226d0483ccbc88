"""External leakage: from one chamber to the outside, through a loose fitting or a hose."""

from fdd.faults.entry import ASSUMED, LEAKAGE, Amount, Effect, Fault, Figure, each_side, side_signatures

FAULT = Fault(
    id="external_leakage", family="leakage", rank=2, title="external leakage", thesis="Table 4.1, 4.6.2",
    plant="flow from one chamber to the outside; the accumulator drains",
    severity="6e-12 m³/(s·Pa) from one chamber to the outside",
    amounts=(Amount(6, "e-12 m³/(s·Pa)", "fault_leakage"),),
    source=ASSUMED,
    next_check="Wipe that chamber's fittings, hoses and rod seal dry, hold pressure in it for some "
    "minutes and look for fresh oil.",
    sides=(1, 2),
    laws={"laminar": "a gap or a porous hose", "orifice": "a hole", "opening": "a joint that pressure opens"},
    figures=(Figure("external_leakage", 6e-12, LEAKAGE, "m³/(s·Pa) from one chamber", grows="leakage"),),
    effects=each_side(
        Effect("outside_{side}", "add", "external_leakage", laws=("laminar",)),
        Effect(
            "outside_orifice_{side}", "add", "external_leakage", roots=("leakage_pressure", 1e6),
            laws=("orifice",),
        ),
        Effect(
            "outside_opening_{side}", "add", "external_leakage", over="leakage_pressure", laws=("opening",)
        ),
    ),
    # Two of its three laws look laminar.
    signatures=(
        # Half of severity 1 of internal leakage, from one chamber; the reservoir's columns have this unit.
        *side_signatures(
            "outside",
            lambda side, unit: {
                "volume": {f"outside_{side}": 0.5 * unit.leakage_ratio},
                "reservoir": {f"outside_{side}": 1.0},
            },
            commonness=0.7,
        ),
        # It looks like a check valve that stays open, of which 1e-4 m³/s is severity 1; but the oil is lost.
        *side_signatures(
            "hole",
            lambda side, unit: {"volume": {f"valve_{side}": 0.06}, "reservoir": {f"outside_{side}": 1.0}},
            law="orifice", commonness=0.3,
        ),
    ),
)  # fmt: skip
