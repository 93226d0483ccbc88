"""The plant world: runs of the faulty-plant simulator on units that differ from what the estimators think.

The estimators get axis A's profile. The unit that is simulated differs from it as the filter's initial spread
says: leakage, free air (and with it the bulk modulus), pump gain, the friction curve's height and viscous
friction are drawn around the profile's; what no profile knows (bristles, ripple, line losses, …) is drawn
from its usual range. Geometry and sensors are as the profile says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.eha import model as eha
from evidence.estimators.cases import LOADS, MOTIONS, Case
from evidence.estimators.model import Assumed
from evidence.estimators.trajectory import Trajectory
from fdd.plant.details import Details
from fdd.plant.oil import air_compliance, viscosity_ratio
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import Simulation
from fdd.plant.truth import Truth
from fdd.unit import Unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rig:
    """A drawn unit with its plant's details, and its pump's gain error over the profile's."""

    unit: Unit
    details: Details
    gain: float


def draw_rig(profile: Unit, prior: Assumed, rng: np.random.Generator) -> Rig:
    """A unit that the estimators' profile describes as well as their initial spread says."""
    z = np.clip(rng.standard_normal(5), -2.5, 2.5)
    leak = max(1.0 + prior.spread[eha.LEAK] * z[0], 0.2)
    gain = prior.spread[eha.GAIN] * z[2]
    pump = profile.pump.model_copy(
        update={
            "cross_port_leakage": profile.pump.cross_port_leakage * leak,
            "case_leakage": profile.pump.case_leakage * leak,
            "displacement": profile.pump.displacement * (1.0 + gain),
        }
    )
    return Rig(
        profile.model_copy(
            update={
                "pump": pump,
                "oil": _oil(profile, prior.spread[eha.AIR] * 1e-3 * z[1]),
                "friction": _friction(profile, prior, z[3], z[4]),
            }
        ),
        Details(**_details(rng)),
        gain,
    )


def _oil(profile: Unit, more_air: float) -> Any:
    oil = profile.oil
    air = max(oil.air_fraction + more_air, 2e-4)
    added = (air - oil.air_fraction) * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    return oil.model_copy(
        update={"air_fraction": air, "bulk_modulus": 1.0 / (1.0 / oil.bulk_modulus + added)}
    )


def _friction(profile: Unit, prior: Assumed, height: float, viscous: float) -> Any:
    factor = max(1.0 + prior.spread[eha.FRIC] * height, 0.2)
    branches = {}
    for name in ("forward", "reverse"):
        branch = getattr(profile.friction, name)
        branches[name] = branch.model_copy(
            update={
                "coulomb": branch.coulomb * factor,
                "static": branch.static * factor,
                "viscous": max(branch.viscous + prior.spread[eha.VISC] * viscous, 0.0),
            }
        )
    return profile.friction.model_copy(update=branches)


def _details(rng: np.random.Generator) -> dict[str, Any]:
    drawn: dict[str, Any] = {name: float(rng.uniform(*bounds)) for name, bounds in Details.usual.items()}
    drawn["pump_teeth"] = round(drawn["pump_teeth"])
    return drawn


def scenario_of(case: Case, rig: Rig, duration: float, seed: int, faults: list[dict[str, Any]] | None = None,
                scales: dict[str, float] | None = None) -> Scenario:  # fmt: skip
    """The case's run on a drawn unit."""
    return Scenario(
        unit=rig.unit.name, duration=duration, duty=MOTIONS[case.duty], load=LOADS[case.load],
        details=rig.details, seed=seed, recording=Recording.perfect(), faults=faults or [],
        fault_scales=scales or {},
    )  # fmt: skip


def plant_trajectory(out: Simulation, profile: Unit, model: eha.Parameters, gain: float) -> Trajectory:
    """The plant's truth as the estimators' states, so far as they have one for it."""
    return trajectory_of_truth(out.truth, profile, model, gain)


def trajectory_of_truth(truth: Truth, profile: Unit, model: eha.Parameters, gain: float) -> Trajectory:
    """As `plant_trajectory`, from the truth's columns alone."""
    x = np.zeros((len(truth), eha.STATES))
    x[:, eha.X], x[:, eha.V] = truth["position"] * 1e3, truth["velocity"]
    x[:, eha.TH], x[:, eha.W] = truth["pump_angle"], truth["pump_speed"] * 1e-3
    x[:, eha.P1], x[:, eha.P2] = truth["pressure_1"] * 1e-6, truth["pressure_2"] * 1e-6
    viscosity = viscosity_ratio(profile.oil, truth["oil_temperature"])
    x[:, eha.LEAK] = truth["leakage"] / profile.pump.total_leakage * viscosity
    per_air = 1e-3 * eha.air_curve(profile.oil.reference_pressure * 1e-6, model.polytropic_index)
    x[:, eha.AIR] = (1e6 / truth["bulk_modulus"] - model.stiff_compliance) / per_air
    x[:, eha.GAIN] = gain
    healthy = 0.5 * (profile.friction.forward.coulomb + profile.friction.reverse.coulomb)
    x[:, eha.FRIC] = truth["coulomb_friction"] / healthy
    x[:, eha.VISC] = truth["viscous_friction"]
    x[:, eha.LOAD] = truth["load_force"]
    return Trajectory(x, truth["pressure_accumulator"] * 1e-6, viscosity)
