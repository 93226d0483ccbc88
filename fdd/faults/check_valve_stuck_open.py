"""Check valve stuck open: one chamber stays connected to the inner circuit."""

from __future__ import annotations

from functools import partial

from fdd.faults.effect import ORIFICE_FLOW, Effect, Figure
from fdd.faults.entry import Fault
from fdd.faults.signature import Columns, Healthy, Signature


def _columns(side: int, unit: Healthy) -> Columns:
    return {"volume": {f"valve_{side}": 1.0}}


FAULT = Fault(
    id="check_valve_stuck_open",
    family="check_valve",
    rank=1,
    title="check valve stuck open",
    thesis="Table 4.1",
    plant="one chamber stays connected to the inner circuit and cannot build pressure",
    severity="passes 1e-4 m³/s at 1 MPa backwards (orifice)",
    source="about the area of the refeeding valve's seat held fully open",
    next_check="Take that side's refeeding valve out and see whether its poppet closes: look for dirt on "
    "the seat and a broken spring.",
    sides=(1, 2),
    laws={
        "gap": "held open by a fixed gap",
        "sticking": "its poppet stays up until the oil that flows back presses it shut",
    },
    figures=(
        Figure(
            "check_valve_flow",
            1e-4,
            ORIFICE_FLOW,
            "m³/s at 1 MPa backwards through a check valve stuck open; about its seat's area",
            grows="orifice",
        ),
        Figure(
            "check_valve_sticking",
            8e5,
            (0.0, 1e8),
            "Pa back over a sticking check valve without which it does not shut",
            grows="pressure",
        ),
    ),
    effects=tuple(
        effect
        for side in (1, 2)
        for effect in (
            Effect(f"open_{side}", "add", "check_valve_flow", side=side, laws=("gap",)),
            Effect(f"sticking_{side}", "add", "check_valve_sticking", side=side, laws=("sticking",)),
        )
    ),
    signatures=tuple(Signature(f"valve {side}", partial(_columns, side), side=side) for side in (1, 2)),
)
