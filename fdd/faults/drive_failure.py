"""Drive failure: the drive no longer follows its command."""

from fdd.faults.entry import ASSUMED, SHARE, Effect, Fault, Figure, Signature, more_current

FAULT = Fault(
    id="drive_failure", family="motor", rank=2, title="drive failure", thesis="Table 4.1",
    plant="the drive does not follow its command: open phase, no supply, tripped",
    severity="the current limit falls by 100 %: no current at all; by the law of the phase: one of three "
    "phases open, current limit -50 %",
    source=ASSUMED,
    next_check="Read the drive's fault memory and its supply, then measure the resistance between each two "
    "of the motor's phases.",
    laws={"dead": "no current: no supply, or tripped", "phase": "one phase open"},
    figures=(
        Figure("drive_current_loss", 1.0, SHARE, "share of the current limit that a dead drive has lost"),
        Figure("open_phase", 1.0, SHARE, "share by which one of three phases is open"),
    ),
    effects=(
        Effect("current_limit", "lower", "drive_current_loss", laws=("dead",)),
        Effect("phase", "add", "open_phase", laws=("phase",)),
        Effect("current_limit", "lower", "drive_current_loss", times=(0.5,), laws=("phase",)),
    ),
    signatures=(
        Signature("dead drive", lambda unit: {"drive": {"gain": -unit.mean("drive", "gain")}}),
        # Two phases of three give half the torque of the same current, on average.
        Signature("open phase", more_current(1.0), commonness=0.3),
    ),
)  # fmt: skip
