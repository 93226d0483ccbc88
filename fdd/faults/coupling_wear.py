"""Coupling wear: play between motor and pump, and a speed that swings with the shaft."""

from fdd.faults.entry import ASSUMED, Effect, Fault, Figure, Signature

FAULT = Fault(
    id="coupling_wear", family="motor", rank=3, title="coupling wear", thesis="Table 4.1",
    plant="torsional play, vibration at shaft frequency",
    severity="2 degrees of play, pump speed swings by 2 % once a turn",
    source=ASSUMED,
    next_check="Lock the pump's shaft, turn the motor by hand to both sides and measure the play, then "
    "check the coupling's insert and its alignment.",
    laws={"both": "play and a shaft out of line", "play": "play alone", "bent": "a shaft out of line alone"},
    figures=(
        Figure("coupling_play", 0.0349, (0.0, 0.5), "rad between motor and pump; 2 degrees"),
        Figure(
            "coupling_eccentricity", 0.02, (0.0, 0.5), "speed's swing once a turn, relative", (0.005, 0.04)
        ),
    ),
    effects=(
        Effect("play", "add", "coupling_play", laws=("both", "play")),
        Effect("eccentricity", "add", "coupling_eccentricity", laws=("both", "bent")),
    ),
    signatures=(
        # A bent or worn coupling shows once a turn, play twice: 0.1 of relief pressure's current (assumed).
        Signature("line once a turn", lambda unit: {"shaft": {"order_1": 0.1}}),
        Signature("line twice a turn", lambda unit: {"shaft": {"order_2": 0.1}}),
    ),
)  # fmt: skip
