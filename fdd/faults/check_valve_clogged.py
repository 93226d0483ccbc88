"""Check valve clogged: its chamber is not refed and cavitates."""

from fdd.faults.entry import DECADES, Effect, Fault, Figure, each_side, side_signatures

FAULT = Fault(
    id="check_valve_clogged", family="check_valve", rank=2, title="check valve clogged", thesis="Table 4.1",
    plant="no refeeding: the low side cavitates",
    severity="refeeding flow gain of that side's check valve falls by powers of ten, to 0.01 %",
    source="assumption: these valves are so wide that half or a tenth of their flow gain is still plenty",
    next_check="Take that side's refeeding valve out and blow through it in its free direction: look for "
    "dirt and a poppet that sticks.",
    sides=(1, 2),
    laws={
        "conductance": "its passage narrows by powers of ten",
        "cracking": "its poppet asks for more pressure before it opens",
        "starved": "its passage closes in proportion, to nothing",
    },
    figures=(
        Figure("check_valve_clogging", 4.0, DECADES, "powers of ten by which its flow gain falls"),
        Figure(
            "check_valve_cracking", 4.8e5, (0.0, 1e8), "Pa added to its cracking pressure", grows="charge"
        ),
    ),
    effects=each_side(
        Effect("refeed_{side}", "decades", "check_valve_clogging", laws=("conductance",)),
        Effect("cracking_{side}", "add", "check_valve_cracking", laws=("cracking",)),
        Effect("refeed_{side}", "lower", 1.0, laws=("starved",)),
    ),
    # Pressure below the accumulator's, measured or by its charge: vacuum is the most. A sensor's bias is no
    # such drop: by charge only rows count that its own reading puts below it.
    signatures=side_signatures(
        "clogged",
        lambda side, unit: {"refeed": {f"drop_{side}": 0.3 * unit.charge_ratio, f"low_{side}": 0.3}},
    ),
)  # fmt: skip
