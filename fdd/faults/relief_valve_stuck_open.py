"""Relief valve stuck open: oil goes over it far below its setting."""

from fdd.faults.entry import ASSUMED, ORIFICE_FLOW, Amount, Effect, Fault, Figure, Signature

FAULT = Fault(
    id="relief_valve_stuck_open", family="relief_valve", rank=1, title="relief valve stuck open",
    thesis="Table 4.1",
    plant="flow over the relief valve far below its setting",
    severity="passes 1e-4 m³/s at 1 MPa from the chamber of higher pressure to the other (orifice)",
    amounts=(Amount(1, "e-4 m³/s", "orifice"),),
    source=ASSUMED,
    next_check="Block the rod, raise the pressure slowly and note where the pump begins to run away: this "
    "must be near the relief setting, both ways.",
    laws={
        "orifice": "held open by a fixed gap",
        "setting": "its spring gave way: it opens at a lower pressure",
    },
    figures=(
        Figure("relief_valve_flow", 1e-4, ORIFICE_FLOW, "m³/s at 1 MPa through it", grows="orifice"),
        Figure("relief_setting_loss", 0.9, (0.0, 0.99), "share of its setting that its spring has lost"),
    ),
    effects=(
        Effect("relief_open", "add", "relief_valve_flow", laws=("orifice",)),
        Effect("relief_setting", "lower", "relief_setting_loss", laws=("setting",)),
    ),
    signatures=(
        # It stays shut in ordinary duty; a check valve moves at every reversal: that sticks more often.
        Signature("relief", lambda unit: {"volume": {"relief_12": 1.0, "relief_21": 1.0}}, commonness=0.3),
        Signature("relief_12", lambda unit: {"volume": {"relief_12": 1.0}}, commonness=0.15),
        Signature("relief_21", lambda unit: {"volume": {"relief_21": 1.0}}, commonness=0.15),
    ),
)  # fmt: skip
