"""Relief valve stuck shut: nothing flows over it at or above its setting."""

from fdd.faults.entry import ASSUMED, SHARE, Effect, Fault, Figure

# No balance shows it below the setting, where it is sound oil's way that is missing: no signature.
FAULT = Fault(
    id="relief_valve_stuck_shut", family="relief_valve", rank=2, title="relief valve stuck shut",
    thesis="Table 4.1",
    plant="no flow at or above its setting",
    severity="99 % of its flow beyond the setting is gone; by the law of the setting: it opens at three "
    "times the setting",
    source=ASSUMED,
    next_check="Block the rod, raise the pressure slowly and stop at the relief setting: from there on the "
    "pressure must no longer follow the pump.",
    laws={"shut": "passes next to nothing", "setting": "opens at a higher pressure"},
    figures=(
        Figure("relief_flow_loss", 0.99, SHARE, "share of its flow that a relief valve stuck shut has lost"),
        Figure("relief_setting_gain", 2.0, (0.0, 20.0), "rise of its setting, relative"),
    ),
    effects=(
        Effect("relief_gain", "lower", "relief_flow_loss", laws=("shut",)),
        Effect("relief_setting", "raise", "relief_setting_gain", laws=("setting",)),
    ),
)  # fmt: skip
