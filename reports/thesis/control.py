"""Table 6.1 and chapter 7: dead band, position step and ultimate gain.

For the actuator's dead band there are two readings: the offset of its velocity over the command, as figure
5.1 plots it, and the command from which it slides out of rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, cont2discrete, lfilter

from fdd.identification.experiments.gain import SLIDING
from fdd.identification.experiments.gain import dead_band as find_dead_band
from fdd.identification.friction import curve
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis.flow import SLOPES, SPEEDS, speeds_of
from reports.thesis.frequency_response import TransferFunction
from reports.thesis.friction import MODES, Mode
from reports.thesis.response import HIGH, LOW
from reports.thesis.runs import (
    PERIOD,
    VOLT,
    Array,
    Figures,
    changed,
    holding_leakage,
    hydraulic_gain,
    run_position,
    run_speed,
    with_friction,
    with_leakage,
)

MOTOR = 0.0011
"""V: Table 6.1."""
MOTOR_LEVELS = np.array([0.0, 2e-4, 4e-4, 6e-4, 8e-4, 9e-4, 1e-3, 1.1e-3, 1.2e-3, 1.4e-3, 1.6e-3, 2e-3, 3e-3])
LEVELS = np.array(
    [0.02, 0.04, 0.06, 0.08, 0.10, 0.11, 0.12, 0.13, 0.14, 0.16, 0.18, 0.20, 0.22, 0.24, 0.26, 0.28]
)
"""V, each held."""
HOLD = 5.0
"""s per level; the mean over the last 2 s counts, when the pressure has followed (L_T·β/V_o is about 1/s)."""
CLIMBS = 3
_MEAN = 2.0
TURNING = 1e-4
"""rad/s: more than two counts of the encoder in 2 s."""

CUTOFF = 350.0
"""rad/s of the chatter filter, section 7.1.1."""
GAIN, STEP = 16_875.0, 0.1
"""(rad/s)/m and m, section 7.2."""
TRIALS = 10
_REST, _SECONDS = 500, 3.5
_PLATEAU = 0.97

ULTIMATE = 33_750.0
"""(rad/s)/m, by experiment on the rig."""
OSCILLATES = 20e-6
"""m, peak to peak over the last second: twenty counts of the encoder."""
MOST = 1e6
"""(rad/s)/m, highest gain tried."""


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


def measured_offset(unit: Unit, seed: int, trials: int = CLIMBS) -> float:
    """Offset (V) in section 5.1's experiment, mean over both directions and the trials."""
    runs = [offsets(SPEEDS, speeds_of(unit, seed + SPEEDS.size * i)[1]) for i in range(trials)]
    return float(np.mean(runs))


def offset_of_equations(unit: Unit, axis: str) -> float:
    """The same offset (V) by eqs 5.3 and 5.12 with the thesis's own numbers, nothing of the plant."""
    area, displacement = unit.cylinder.area_1, unit.pump.displacement

    def steady(mode: Mode) -> Array:
        speed = mode.sign * SPEEDS[mode.sign * SPEEDS > 0.0]
        found = speed * displacement / area
        for _ in range(60):
            leak = SLOPES[axis] * curve(mode.branch, np.maximum(found, 1e-6)) / area
            found = 0.5 * (found + (displacement * speed - leak) / area)
        return mode.sign * found

    forward, reverse = (m for m in MODES if m.axis == axis)
    return float(np.mean(offsets(SPEEDS, np.concatenate([steady(reverse), steady(forward)]))))


def dead_band(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Table 6.1: steady velocities over commands of ±1 to ±10 V, and a climb of small commands."""
    both, axes = (1.0, -1.0), {}
    turns = np.mean([staircase(axis_a, MOTOR_LEVELS, s, seed)[0] for s in both], axis=0)
    for name, unit in (("A", axis_a), ("B", axis_b)):
        climbs = [slides_from(unit, LEVELS, s, i) for s in both for i in range(seed, seed + CLIMBS)]
        # The commands (V) that hold both static frictions (N) against the leakage.
        statics = np.array([unit.friction.forward.static, unit.friction.reverse.static])
        per_newton = holding_leakage(unit) / (unit.cylinder.area_1 * unit.pump.displacement * VOLT)
        axes[name] = {
            "combined": measured_offset(unit, seed),
            "from_rest": np.mean(climbs),
            "by_equations": offset_of_equations(unit, name),
            "forces": " and ".join(f"{f:.0f}" for f in statics),
            "volts": " and ".join(f"{v:.3f}" for v in MOTOR + per_newton * statics),
            "per_volt": 1e3 * VOLT * hydraulic_gain(unit),
        }
    cases = {
        "axis B with axis A's leakage": with_leakage(axis_b, axis_a),
        "axis B with axis A's friction": axis_b.model_copy(update={"friction": axis_a.friction}),
    }
    return {
        "motor": find_dead_band(MOTOR_LEVELS, turns, turns > TURNING),
        "axes": axes,
        "changes": [(case, measured_offset(unit, seed, 1)) for case, unit in cases.items()],
    }


def filtered_velocity(position: Array) -> Array:
    """Velocity as section 7.2 shows it: differences of the position through eq. 7.5's filter, (n,).

    The filter is a Butterworth one of second order; printed are the coefficients of the zero-order hold,
    and not of Tustin's rule as the text has it.
    """
    top, bottom, _ = cont2discrete(butter(2, CUTOFF, analog=True), PERIOD, method="zoh")
    return np.asarray(lfilter(np.ravel(top), bottom, np.diff(position, prepend=position[:1]) / PERIOD))


@dataclass(frozen=True)
class Steps:
    """(trials,) of one direction: saturated velocity (m/s), for how long (s), final error (m)."""

    plateau: Array
    duration: Array
    error: Array


def step_trials(
    unit: Unit, sign: float, seed: int, trials: int = TRIALS, details: Details | None = None
) -> Steps:
    """Step from mid-stroke by 0.1 m along `sign`; the final error is position less set-point, 3.5 s later."""
    setpoint = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / PERIOD), sign * STEP)])
    found = []
    for i in range(trials):
        log = run_position(unit, setpoint, GAIN, details=details, seed=seed + i).samples
        speed = sign * filtered_velocity(log["position"])
        # The level is the median over the middle of the motion: break-away overshoots it.
        level = float(np.median(speed[_REST + 200 : _REST + 600]))
        fast = np.flatnonzero(speed > _PLATEAU * level)
        error = sign * float(np.mean(log["position"][-50:])) - STEP
        found.append((level, (fast[-1] - fast[0]) * PERIOD, error))
    return Steps(*np.array(found).T)


def position_step(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 7.2: a step of 0.1 m under proportional position control, both ways."""
    forward, no_band = step_trials(axis_a, 1.0, seed), Details(command_dead_band=0.0)
    band, command = Details().command_dead_band, GAIN * abs(float(np.mean(forward.error)))
    per_speed = axis_a.pump.displacement * axis_a.cylinder.area_1 / holding_leakage(axis_a)
    return {
        "ways": {"forward": forward, "reverse": step_trials(axis_a, -1.0, seed)},
        "parts": {
            "as it is": forward,
            "no dead band at the drive's input": step_trials(axis_a, 1.0, seed, details=no_band),
            "a tenth of its friction": step_trials(with_friction(axis_a, 0.1), 1.0, seed),
            "a tenth of its leakage": step_trials(with_leakage(axis_a, axis_a, 0.1), 1.0, seed),
        },
        "ratio": hydraulic_gain(axis_a),
        "area": axis_a.cylinder.area_1,
        "command": command,
        "force": (command - band) * per_speed,
        "needed": (GAIN * 21e-6 - band) * per_speed,
        "band": band / GAIN,
        "rig_band": 0.06 * VOLT / GAIN,
    }


def least_oscillating(unit: Unit, seed: int) -> float:
    """Least gain that oscillates, to 3 %; NaN for none."""

    def oscillates(gain: float) -> bool:
        """Whether the last second of four after a step of 0.1 m does, less its one-way creep."""
        setpoint = np.concatenate([np.zeros(100), np.full(3900, STEP)])
        last = run_position(unit, setpoint, gain, seed=seed).samples["position"][-1000:]
        return float(np.ptp(last) - abs(np.mean(last[-50:]) - np.mean(last[:50]))) > OSCILLATES

    low, high = 0.5 * ULTIMATE, float("nan")
    for gain in 0.5 * ULTIMATE * np.sqrt(2.0) ** np.arange(12):
        if gain <= MOST and oscillates(float(gain)):
            high = float(gain)
            break
        low = float(gain)
    while high / low > 1.03:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if oscillates(middle) else (middle, high)
    return high


def linear_ultimate_gain(model: TransferFunction) -> float:
    """Proportional gain at which the loop around ``model/s`` is on the verge, (rad/s)/m.

    Where velocity over demanded speed lags 90°, and the integrator the other 90°.
    """
    frequency = np.geomspace(0.05, 400.0, 40_001)
    response = model.at(frequency) / np.sign(model.gain)
    late = np.flatnonzero(np.unwrap(np.angle(response)) < -0.5 * np.pi)
    if late.size == 0:
        return float("nan")
    return float(2.0 * np.pi * frequency[late[0]] / np.abs(response[late[0]]))


def ultimate_gain(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 7.2: raise the gain on the plant until it oscillates for ever, and ask the linear models."""
    return {
        "thesis": ULTIMATE,
        "low": linear_ultimate_gain(LOW),
        "high": linear_ultimate_gain(HIGH),
        "plant": least_oscillating(axis_a, seed),
        "late": least_oscillating(changed(axis_a, "drive", delay=0.01), seed),
        "crossing": ULTIMATE * hydraulic_gain(axis_a) / (2 * np.pi),
        "oscillates": OSCILLATES,
    }
