"""Air in the oil: it is softer, most of all at low pressure."""

from fdd.faults.entry import Effect, Fault, Figure, Signature

FAULT = Fault(
    id="aeration", family="aeration", rank=1, title="air in the oil", thesis="4.6.3, 5.4",
    plant="entrained air: the effective bulk modulus falls, most at low pressure",
    severity="2.5 % more free air (volume at atmospheric pressure over volume of oil)",
    source="eqs 5.20 and 5.21: halves to thirds the bulk modulus at charge pressure",
    next_check="Draw oil from the low side into a glass and look for bubbles, then bleed both chambers "
    "and take the log again.",
    figures=(
        Figure("free_air", 0.025, (0.0, 0.2), "volume of free air added over that of oil (eqs 5.20, 5.21)"),
    ),
    laws={
        "exchange": "air in both chambers, in place of oil that is lost",
        "ingress": "air in both chambers beside their oil, which gives way into the accumulator",
        "chamber_1": "air in chamber 1 alone, in place of oil",
        "chamber_2": "air in chamber 2 alone, in place of oil",
    },
    effects=(
        *(Effect(f"air_{k}", "add", "free_air", laws=("exchange", f"chamber_{k}")) for k in (1, 2)),
        Effect("ingress", "add", "free_air", laws=("ingress",)),
    ),
    # Air is softer than oil: the chambers give way, and a pump delivers less of what it draws in. Two of four
    # laws have it in both chambers.
    signatures=(
        Signature(
            "air",
            lambda unit: {"volume": {"air": 1.0, "air_filled": max(unit.mean("volume", "filled"), 0.0)}},
            commonness=1 / 2,
        ),
        Signature(
            "air 1", lambda unit: {"volume": {"air": 0.5, "air_sides": 0.5}}, law="chamber_1",
            commonness=1 / 4,
        ),
        Signature(
            "air 2", lambda unit: {"volume": {"air": 0.5, "air_sides": -0.5}}, law="chamber_2",
            commonness=1 / 4,
        ),
    ),
)  # fmt: skip
