"""Motor degradation: a worn winding gives less torque for its current."""

from fdd.faults.entry import ASSUMED, SHARE, Effect, Fault, Figure, Signature, more_current

_MORE_CURRENT = 0.43
"""1/0.7 - 1: what the same torque takes, of a motor with 70 % of its torque constant."""

FAULT = Fault(
    id="motor_degradation", family="motor", rank=1, title="motor degradation", thesis="Table 4.1",
    plant="torque constant down, winding resistance up, current limit down",
    severity="torque constant -30 %, winding resistance +50 %, current limit -20 %",
    source=ASSUMED,
    next_check="Measure each phase's winding resistance cold and the back EMF at a known speed, and "
    "compare both with the motor's data sheet.",
    laws={
        "winding": "a hot, worn winding: less torque, more resistance, a lower limit",
        "magnets": "weak magnets: less torque and back EMF alone",
        "shorted": "shorted turns: less resistance and torque, and a brake that grows with speed",
        "phase": "a phase that conducts badly: torque swings twice an electrical turn",
    },
    figures=(
        Figure("torque_loss", 0.3, (0.0, 0.95), "share of the torque constant"),
        Figure("resistance_gain", 0.5, (0.0, 10.0), "rise of the winding resistance, relative", (0.2, 0.8)),
        # A drive lowers the limit for a winding that runs hot.
        Figure("current_limit_loss", 0.2, SHARE, "share of the current limit", (0.0, 0.4)),
        # 0.2 N·m at 100 rad/s.
        Figure(
            "shorted_braking", 2e-3, (0.0, 1.0), "N·m·s/rad that shorted turns brake with", grows="torque"
        ),
    ),
    effects=(
        Effect("torque", "lower", "torque_loss", laws=("winding", "magnets")),
        Effect("resistance", "raise", "resistance_gain", laws=("winding",)),
        Effect("current_limit", "lower", "current_limit_loss", laws=("winding",)),
        Effect("torque", "lower", "torque_loss", times=(0.5,), laws=("shorted",)),
        Effect("resistance", "lower", "torque_loss", laws=("shorted",)),
        Effect("braking", "add", "shorted_braking", laws=("shorted",)),
        Effect("phase", "add", "torque_loss", times=(2.0,), laws=("phase",)),
    ),
    signatures=(Signature("motor", more_current(_MORE_CURRENT)),),
)  # fmt: skip
