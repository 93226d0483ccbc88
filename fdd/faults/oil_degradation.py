"""Oil degradation: viscous friction and leakage change with viscosity."""

from functools import partial

from fdd.faults.entry import ASSUMED, Columns, Effect, Fault, Figure, Healthy, Signature

_VISCOSITY = {"thin": 0.5, "thick": 2.0}


def _columns(ratio: float, unit: Healthy) -> Columns:
    laminar = ("leak", "leak_square", "case", "wear")
    return {
        "volume": {name: (1.0 / ratio - 1.0) * unit.mean("volume", name) for name in laminar},
        "torque": {"viscous": (ratio - 1.0) * unit.mean("torque", "viscous")},
    }


FAULT = Fault(
    id="oil_degradation", family="friction", rank=1, title="oil degradation", thesis="Table 4.1",
    plant="viscous friction and leakage change with viscosity",
    severity="thin: viscosity falls to 50 %; thick: it rises to 200 %; wet: a percent of emulsified water, "
    "whose vapour pressure is 25 times the oil's, and viscosity to 140 %",
    source=ASSUMED,
    next_check="Take an oil sample at working temperature and have its viscosity at 40 °C compared with "
    "its grade.",
    variants=(*_VISCOSITY, "wet"),
    figures=(
        Figure("thin_viscosity", _VISCOSITY["thin"], (0.05, 1.0), "of the oil over that of sound oil"),
        Figure("thick_viscosity", _VISCOSITY["thick"], (1.0, 20.0), "of the oil over that of sound oil"),
        Figure("wet_viscosity", 1.4, (1.0, 20.0), "of an emulsion over that of sound oil"),
        # Water has 7.4 kPa at 40 °C.
        Figure("wet_vapour", 25.0, (1.0, 1e3), "vapour pressure over sound oil's"),
    ),
    # The plant itself takes viscosity into leakages and viscous friction.
    effects=(
        *(Effect("viscosity", "towards", f"{v}_viscosity", variants=(v,)) for v in (*_VISCOSITY, "wet")),
        Effect("vapour", "towards", "wet_vapour", variants=("wet",)),
    ),
    signatures=tuple(
        # Oil ages over hundreds of hours, a clearance or a seal gives within minutes.
        Signature(variant, partial(_columns, ratio), variant=variant, commonness=0.1)
        for variant, ratio in _VISCOSITY.items()
    ),
)  # fmt: skip
