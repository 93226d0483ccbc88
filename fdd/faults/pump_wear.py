"""Pump gear wear: the pump loses the more the faster it turns, and its flow ripples."""

from fdd.faults.entry import ASSUMED, LEAKAGE, Amount, Effect, Fault, Figure, Signature

_LOSS = 0.02
_WORN_OUT = 0.1
"""Assumption: share of its flow at no pressure that a pump has lost when it is done for."""

FAULT = Fault(
    id="pump_wear", family="leakage", rank=3, title="pump gear wear", thesis="Table 4.1",
    plant="volumetric loss that grows with pressure and speed, more flow ripple",
    severity="cross-port leakage +12e-12 m³/(s·Pa) at 100 rad/s, displacement -2 %, flow ripple +5 %; "
    "or a tenth of the displacement, where what is lost goes by speed alone; or that leakage at any speed",
    amounts=(Amount(12, "e-12 m³/(s·Pa)", "fault_leakage"),),
    source=ASSUMED,
    next_check="Measure the leakage across the ports at one pressure, at low and at full speed: only a "
    "worn gear loses more as it turns faster.",
    laws={
        "mixed": "gaps that lose with pressure and speed, some displacement, ripple",
        "displacement": "teeth that carry less at any pressure, ripple",
        "gap": "a side gap that loses by pressure alone, to the other port and to the case, ripple",
        "speed": "a gap that loses by pressure and speed alone",
    },
    figures=(
        # In proportion to speed.
        Figure(
            "pump_wear_leakage", 12e-12, LEAKAGE, "m³/(s·Pa) across the ports at 100 rad/s",
            grows="speed_leakage",
        ),
        Figure("pump_wear_displacement_loss", _LOSS, (0.0, 0.5), "share of the displacement", (0.0, 0.04)),
        Figure("pump_wear_worn_out", _WORN_OUT, (0.0, 0.5), "share of the displacement, of a pump done for"),
        Figure("pump_wear_ripple", 0.05, (0.0, 0.5), "flow ripple added, over the mean flow", (0.01, 0.1)),
    ),
    effects=(
        Effect("speed_leakage", "add", "pump_wear_leakage", over=100.0, laws=("mixed", "speed")),  # rad/s
        Effect("displacement", "lower", "pump_wear_displacement_loss", laws=("mixed",)),
        Effect("displacement", "lower", "pump_wear_worn_out", laws=("displacement",)),
        Effect("cross_leakage", "add", "internal_leakage", times=(0.7,), laws=("gap",)),
        *(
            Effect(f"case_leakage_{k}", "add", "internal_leakage", times=(0.3,), laws=("gap",))
            for k in (1, 2)
        ),
        Effect("ripple", "add", "pump_wear_ripple", laws=("mixed", "displacement", "gap")),
    ),
    # Gears wear slowly. What a worn one loses goes by pressure and speed, by speed alone at its teeth, or by
    # pressure alone at its sides: how much of each differs from pump to pump.
    signatures=(
        Signature(
            "pump wear",
            lambda unit: {"volume": {"wear": unit.leakage_ratio * unit.speed_ratio, "gain": _LOSS}},
            commonness=0.5,
        ),
        Signature(
            "worn displacement", lambda unit: {"volume": {"gain": _WORN_OUT}}, law="displacement",
            commonness=0.25,
        ),
        Signature(
            "worn gap",
            lambda unit: {"volume": {"leak": 0.7 * unit.leakage_ratio, "case": 0.3 * unit.leakage_ratio}},
            law="gap", commonness=0.25,
        ),
    ),
)  # fmt: skip
