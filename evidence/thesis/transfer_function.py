"""Equations 5.22 to 5.26: the hydraulic transfer function, from the profile and from the plant's motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from evidence.thesis.findings import Finding, Picture, Row
from evidence.thesis.frequency_response import TransferFunction
from evidence.thesis.runs import PERIOD, run_speed
from fdd.identification.experiments.hydraulic import Coefficients, from_profile
from fdd.plant.details import Details
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

NUMERATOR, STIFFNESS = 44.64, 1.22e5
"""A·β·Dp/(V_o·M) and A²·β/(V_o·M) of eqs 5.23 to 5.26."""
LEAKAGE_DAMPING = {"A": 1.27, "B": 0.83}
LEAKAGE_STIFFNESS = {"A": 0.343, "B": 0.225}
"""L_T·β/V_o and L_T·β/(V_o·M), by the axis that they recompute for: A's and B's are swapped in print."""
VISCOUS = 800.0
"""N·s/m, for the check with damping."""
_STEP, _REST, _SECONDS = 10.0, 100, 0.6


def small_motion(unit: Unit, viscous: float, seed: int) -> tuple[Array, Array, Array]:
    """Time (s), pump speed (rad/s) and velocity (m/s), (n,), of a small step with viscous friction alone.

    So small that neither refeeding valve opens: then both chambers work, as eq. 5.22 has it.
    """
    linear = unit.model_copy(deep=True)
    for branch in (linear.friction.forward, linear.friction.reverse):
        branch.coulomb = branch.static = 0.0
        branch.viscous = viscous
    # Valves that open sharply: at its usual width a closed one still passes half as much as the pump leaks.
    # And air that is only compressed, as eq. 5.22 has it: what dissolves and comes out again damps as well.
    details = Details(
        pump_ripple=0.0, pump_coulomb_torque=0.0, seal_damping=0.0, check_width=200.0, air_law="free"
    )
    command = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / PERIOD), _STEP)])
    truth = run_speed(linear, command, details=details, seed=seed).truth
    return truth.time, truth["pump_speed"], truth["velocity"]


def fit_second_order(pump_speed: Array, velocity: Array, start: Coefficients) -> Coefficients:
    """Coefficients whose response to the pump speed comes nearest to the velocity, both (n,) from rest."""

    def response(theta: Array) -> Array:
        return TransferFunction((theta[0],), (1.0, theta[1], theta[2]), 0.0).simulate(pump_speed, PERIOD)

    guess = np.array([start.numerator, max(start.damping, 1.0), start.stiffness])
    solved = least_squares(
        lambda theta: (response(theta) - velocity) / velocity.std(), guess, x_scale=guess, xtol=1e-12
    )
    return Coefficients(*(float(x) for x in solved.x))


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Recompute the printed coefficients, and find them again in the plant's small motion."""
    rows: list[Row] = []
    traces = {}
    for name, unit in (("A", axis_a), ("B", axis_b)):
        free, damped = (from_profile(unit, b) for b in (0.0, VISCOUS))
        _, speed, v = small_motion(unit, 0.0, seed)
        in_plant = fit_second_order(speed, v, free)
        time, speed, v = small_motion(unit, VISCOUS, seed)
        traces[name] = time, speed, v
        in_plant_damped = fit_second_order(speed, v, damped)
        slope = (in_plant_damped.stiffness - in_plant.stiffness) / VISCOUS
        eq = "eq. 5.23" if name == "A" else "eq. 5.26"
        swapped = "Eqs 5.24 and 5.25 print the other axis's value." if name == "B" else ""
        rows += [
            Row(f"A·β·Dp/(V_o·M), axis {name}, profile", eq, NUMERATOR, free.numerator, "m/(rad·s²)",
                digits=4),
            Row(f"the same, plant's motion, axis {name}", eq, NUMERATOR, in_plant.numerator, "m/(rad·s²)",
                digits=4),
            Row(f"A²·β/(V_o·M), axis {name}, profile", eq, STIFFNESS, free.stiffness, "1/s²"),
            Row(f"the same, plant's motion, axis {name}", eq, STIFFNESS, in_plant.stiffness, "1/s²"),
            Row(f"L_T·β/V_o, axis {name}, profile", eq, LEAKAGE_DAMPING[name], free.damping, "1/s",
                note=swapped),
            Row(f"the same, plant's motion, axis {name}", eq, LEAKAGE_DAMPING[name], in_plant.damping, "1/s",
                tolerance=0.1 * LEAKAGE_DAMPING[name],
                note="A tenth is allowed: damping this small is 0.2 % of critical."),
            Row(f"L_T·β/(V_o·M), axis {name}, profile", eq, LEAKAGE_STIFFNESS[name],
                (damped.stiffness - free.stiffness) / VISCOUS, "1/(kg·s)", note=swapped),
            Row(f"damping with B = 800 N·s/m, plant's motion, axis {name}", eq,
                LEAKAGE_DAMPING[name] + VISCOUS / 3.688, in_plant_damped.damping, "1/s",
                note=f"The stiffness term's change with B, {slope:.3f} 1/(kg·s), drowns in the "
                f"{STIFFNESS:.3g} 1/s² it adds to."),
        ]  # fmt: skip

    def draw(figure: Figure) -> None:
        for axes, (name, unit) in zip(figure.subplots(1, 2), (("A", axis_a), ("B", axis_b)), strict=True):
            time, speed, v = traces[name]
            c = from_profile(unit, VISCOUS)
            stiffness = STIFFNESS + LEAKAGE_STIFFNESS[name] * VISCOUS
            expected = TransferFunction((NUMERATOR,), (1.0, c.damping, stiffness), 0.0).simulate(
                speed, PERIOD
            )
            shown = (time > 0.09) & (time < 0.18)
            axes.plot(1e3 * (time - 0.1)[shown], 1e3 * v[shown], label="plant", linewidth=2.5)
            axes.plot(
                1e3 * (time - 0.1)[shown], 1e3 * expected[shown], "k--", label="thesis, printed coefficients"
            )
            axes.set(
                xlabel="time since the step (ms)",
                ylabel="velocity (mm/s)",
                title=f"axis {name}, B = 800 N·s/m",
            )
            axes.legend()

    return Finding(
        "Hydraulic transfer function",
        "Eqs 5.23 to 5.26 are eq. 5.22 with the numbers of Table 4.21 and chapter 5. They are recomputed "
        "from the unit profiles, and found a second time in the plant: its friction replaced by a "
        "viscous one (B = 0 and 800 N·s/m), its check valves made to open sharply and its air not to "
        "dissolve, it answers a step of 10 rad/s from rest, and a second-order response to the pump's true "
        "speed is fitted.",
        rows,
        pictures=[Picture("transfer_function", "Small motion of the plant against eqs 5.23 and 5.26.", draw)],
    )
