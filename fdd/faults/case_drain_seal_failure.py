"""Case drain seal failure: oil goes from the ports into the case and so into the accumulator."""

from fdd.faults.entry import ASSUMED, LEAKAGE, Amount, Effect, Fault, Figure, Signature

FAULT = Fault(
    id="case_drain_seal_failure", family="leakage", rank=4, title="case drain seal failure",
    thesis="Table 4.1",
    plant="case drain flow into the accumulator, its pressure rises",
    severity="case leakage of each port +24e-12 m³/(s·Pa), or twice that of one port",
    amounts=(Amount(24, "e-12 m³/(s·Pa)", "fault_leakage"),),
    source=ASSUMED,
    next_check="Lead the case drain into a measuring glass, run against a load and compare its flow with "
    "the pump's data sheet.",
    laws={"both": "both ports leak into the case", "one": "port 1 alone, twice as much"},
    figures=(
        Figure("case_leakage", 24e-12, LEAKAGE, "m³/(s·Pa), each port to the case drain", grows="leakage"),
    ),
    effects=(
        *(Effect(f"case_leakage_{port}", "add", "case_leakage", laws=("both",)) for port in (1, 2)),
        Effect("case_leakage_1", "add", "case_leakage", times=(2.0,), laws=("one",)),
    ),
    # Twice what severity 1 of internal leakage is; one seal, of the many gaps that lead across the ports.
    # What one port loses is missing in its chamber as if it went outside, but not in the accumulator.
    signatures=(
        Signature("case", lambda unit: {"volume": {"case": 2.0 * unit.leakage_ratio}}, commonness=0.25),
        Signature(
            "case 1", lambda unit: {"volume": {"outside_1": 4.0 * unit.leakage_ratio}}, law="one",
            commonness=0.125,
        ),
        Signature(
            "case 2", lambda unit: {"volume": {"outside_2": 4.0 * unit.leakage_ratio}}, law="one",
            commonness=0.125,
        ),
    ),
)  # fmt: skip
