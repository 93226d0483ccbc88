"""Check valve stuck open: one chamber stays connected to the inner circuit."""

from fdd.faults.entry import ORIFICE_FLOW, Amount, Effect, Fault, Figure, each_side, side_signatures

FAULT = Fault(
    id="check_valve_stuck_open", family="check_valve", rank=1, title="check valve stuck open",
    thesis="Table 4.1",
    plant="one chamber stays connected to the inner circuit and cannot build pressure",
    severity="passes 1e-4 m³/s at 1 MPa backwards (orifice)",
    amounts=(Amount(1, "e-4 m³/s", "orifice"),),
    source="about the area of the refeeding valve's seat held fully open",
    next_check="Take that side's refeeding valve out and see whether its poppet closes: look for dirt on "
    "the seat and a broken spring.",
    sides=(1, 2),
    laws={
        "gap": "held open by a fixed gap",
        "sticking": "its poppet stays up until the oil that flows back presses it shut",
    },
    figures=(
        Figure("check_valve_flow", 1e-4, ORIFICE_FLOW, "m³/s at 1 MPa backwards through it", grows="orifice"),
        Figure(
            "check_valve_sticking", 8e5, (0.0, 1e8), "Pa back over it that it takes to shut", grows="pressure"
        ),
    ),
    effects=each_side(
        Effect("open_{side}", "add", "check_valve_flow", laws=("gap",)),
        Effect("sticking_{side}", "add", "check_valve_sticking", laws=("sticking",)),
    ),
    signatures=side_signatures("valve", lambda side, unit: {"volume": {f"valve_{side}": 1.0}}),
)  # fmt: skip
