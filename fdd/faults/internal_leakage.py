"""Internal leakage: across the pump's ports, from one chamber to the other."""

from fdd.faults.entry import LEAKAGE, SHARE, Amount, Effect, Fault, Figure, Signature

FAULT = Fault(
    id="internal_leakage", family="leakage", rank=1, title="internal leakage", thesis="4.6.8",
    plant="more flow across the ports, laminar plus orifice",
    severity="cross-port leakage +12e-12 m³/(s·Pa) at 1 MPa, a tenth of it through an orifice",
    amounts=(Amount(12, "e-12 m³/(s·Pa)", "fault_leakage"),),
    source="2 to 3 times the healthy L_T of section 5.2, 0.7 L/min at 1 MPa; assumption: the orifice's part",
    next_check="Block the rod, hold half the relief pressure and read the pump's speed: displacement "
    "times speed over pressure is the leakage across the ports.",
    laws={
        "mixed": "a laminar gap, a tenth of it an orifice",
        "laminar": "a gap alone",
        "orifice": "a hole alone",
        "opening": "a gap that pressure widens",
        "piston": "a gap at the piston's seal, past the pump",
    },
    figures=(
        Figure("internal_leakage", 12e-12, LEAKAGE, "m³/(s·Pa) at 1 MPa, orifice included", grows="leakage"),
        # The rig injects this leakage by a throttling valve (4.6.8), a worn clearance gives a laminar one,
        # and the thesis's own leakage is straight over pressure (figure 5.4).
        Figure(
            "internal_leakage_orifice_share", 0.1, SHARE, "turbulent part of that flow at 1 MPa", (0.0, 0.25)
        ),
        Figure(
            "leakage_pressure", 1e6, (1e3, 1e8), "Pa at which a leak's flow is that of any law",
            grows="pressure",
        ),
    ),
    effects=(
        Effect(
            "cross_leakage", "add", "internal_leakage", less="internal_leakage_orifice_share", laws=("mixed",)
        ),
        # An orifice is given by its flow at 1 MPa.
        Effect(
            "cross_orifice", "add", "internal_leakage", times=("internal_leakage_orifice_share", 1e6),
            laws=("mixed",),
        ),
        Effect("cross_leakage", "add", "internal_leakage", laws=("laminar",)),
        Effect(
            "cross_orifice", "add", "internal_leakage", roots=("leakage_pressure", 1e6), laws=("orifice",)
        ),
        Effect("cross_opening", "add", "internal_leakage", over="leakage_pressure", laws=("opening",)),
        Effect("seal_leakage", "add", "internal_leakage", laws=("piston",)),
    ),
    # Four of its laws look laminar. A hole looks like an open relief valve, of which 1e-4 m³/s is severity 1.
    signatures=(
        Signature("internal leakage", lambda unit: {"volume": {"leak": unit.leakage_ratio}}, commonness=0.8),
        Signature(
            "internal orifice", lambda unit: {"volume": {"relief_12": 0.12, "relief_21": 0.12}},
            law="orifice", commonness=0.2,
        ),
    ),
)  # fmt: skip
