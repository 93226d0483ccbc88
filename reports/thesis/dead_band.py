"""Table 6.1: the dead band of the motor, and that of motor and actuator.

For the actuator there are two readings: the offset of its velocity over the command, as figure 5.1 plots it,
and the command from which it slides out of rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.identification.experiments.gain import SLIDING
from fdd.identification.experiments.gain import dead_band as find_dead_band
from fdd.identification.friction import curve
from fdd.unit import Unit
from reports.thesis.flow import SLOPES, SPEEDS, speeds_of
from reports.thesis.friction import MODES, Mode
from reports.thesis.runs import (
    PERIOD,
    VOLT,
    Figures,
    holding_leakage,
    hydraulic_gain,
    run_speed,
    with_friction,
    with_leakage,
)

Array = NDArray[np.float64]

MOTOR = 0.0011
"""V: Table 6.1."""
MOTOR_LEVELS = np.array([0.0, 2e-4, 4e-4, 6e-4, 8e-4, 9e-4, 1e-3, 1.1e-3, 1.2e-3, 1.4e-3, 1.6e-3, 2e-3, 3e-3])
LEVELS = np.array(
    [0.02, 0.04, 0.06, 0.08, 0.10, 0.11, 0.12, 0.13, 0.14, 0.16, 0.18, 0.20, 0.22, 0.24, 0.26, 0.28]
)
"""V, each held."""
HOLD = 5.0
"""s per level; the mean over the last 2 s counts, when the pressure has followed (L_T·β/V_o is about 1/s)."""
TRIALS = 3
_MEAN = 2.0
TURNING = 1e-4
"""rad/s: more than two counts of the encoder in 2 s."""


def staircase(unit: Unit, levels: Array, sign: float, seed: int) -> tuple[Array, Array]:
    """Mean motor speed (rad/s) and actuator velocity (m/s) along `sign` at each level (V), from encoders."""
    rows = round(HOLD / PERIOD)
    command = sign * VOLT * np.repeat(levels, rows)
    log = run_speed(unit, command, start=-0.01 * sign, seed=seed).samples
    ends = rows * np.arange(1, levels.size + 1) - 1
    starts = ends - round(_MEAN / PERIOD)
    motor, actuator = (sign * (log[c][ends] - log[c][starts]) / _MEAN for c in ("pump_angle", "position"))
    return np.asarray(motor), np.asarray(actuator)


def slides_from(unit: Unit, levels: Array, sign: float, seed: int) -> float:
    """Dead band (V) of motor and actuator; below break-away the piston creeps as its seals bend."""
    velocity = staircase(unit, levels, sign, seed)[1]
    return find_dead_band(levels, velocity, velocity > SLIDING * hydraulic_gain(unit) * VOLT * levels)


def offsets(command: Array, velocity: Array) -> Array:
    """Where the lines through velocity over command meet zero, forward and reverse, (2,) V, both positive."""
    found = []
    for sign in (1.0, -1.0):
        way = sign * command > 0.0
        slope, rest = np.polyfit(command[way], velocity[way], 1)
        found.append(-sign * rest / slope / VOLT)
    return np.array(found)


def measured_offset(unit: Unit, seed: int, trials: int = TRIALS) -> float:
    """Offset (V) in section 5.1's experiment, mean over both directions and the trials."""
    runs = [offsets(SPEEDS, speeds_of(unit, seed + SPEEDS.size * i)[1]) for i in range(trials)]
    return float(np.mean(runs))


def offset_of_equations(unit: Unit, axis: str) -> float:
    """The same offset (V) by eqs 5.3 and 5.12 with the thesis's own numbers, nothing of the plant."""
    area, displacement = unit.cylinder.area_1, unit.pump.displacement

    def steady(mode: Mode, speed: Array) -> Array:
        found = speed * displacement / area
        for _ in range(60):
            leak = SLOPES[axis] * curve(mode.branch, np.maximum(found, 1e-6)) / area
            found = 0.5 * (found + (displacement * speed - leak) / area)
        return found

    forward, reverse = (m for m in MODES if m.axis == axis)
    velocity = np.empty_like(SPEEDS)
    velocity[SPEEDS > 0.0] = steady(forward, SPEEDS[SPEEDS > 0.0])
    velocity[SPEEDS < 0.0] = -steady(reverse, -SPEEDS[SPEEDS < 0.0])
    return float(np.mean(offsets(SPEEDS, velocity)))


def _held(unit: Unit) -> tuple[str, str]:
    """Both static frictions (N) and the commands (V) that hold them against the leakage, as text."""
    per_newton = holding_leakage(unit) / (unit.cylinder.area_1 * unit.pump.displacement * VOLT)
    statics = unit.friction.forward.static, unit.friction.reverse.static
    volts = " and ".join(f"{MOTOR + per_newton * f:.3f}" for f in statics)
    return " and ".join(f"{f:.0f}" for f in statics), volts


def dead_band(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Table 6.1: steady velocities over commands of ±1 to ±10 V, and a climb of small commands."""
    both = (1.0, -1.0)
    turns = np.mean([staircase(axis_a, MOTOR_LEVELS, s, seed)[0] for s in both], axis=0)
    axes = {}
    for name, unit in (("A", axis_a), ("B", axis_b)):
        seeds = range(seed, seed + TRIALS)
        climbs = [np.mean([slides_from(unit, LEVELS, s, i) for i in seeds]) for s in both]
        forces, volts = _held(unit)
        axes[name] = {
            "combined": measured_offset(unit, seed),
            "from_rest": np.mean(climbs),
            "falling": np.mean([slides_from(unit, LEVELS[::-1], s, seed) for s in both]),
            "by_equations": offset_of_equations(unit, name),
            "forces": forces,
            "volts": volts,
            "per_volt": 1e3 * VOLT * hydraulic_gain(unit),
        }
    cases = {
        "axis A with half its leakage": with_leakage(axis_a, axis_a, 0.5),
        "axis A with half its friction": with_friction(axis_a, 0.5),
        "axis A, friction that does not rise towards rest": with_friction(axis_a, rises=False),
        "axis B with axis A's leakage": with_leakage(axis_b, axis_a),
        "axis B with axis A's friction": axis_b.model_copy(update={"friction": axis_a.friction}),
    }
    levels = np.concatenate([np.arange(0.01, 0.06, 0.01), LEVELS[2:]])
    changes = [
        (case, measured_offset(unit, seed, 1), np.mean([slides_from(unit, levels, s, seed) for s in both]))
        for case, unit in cases.items()
    ]
    motor = find_dead_band(MOTOR_LEVELS, turns, turns > TURNING)
    return {"motor": motor, "axes": axes, "changes": changes}
