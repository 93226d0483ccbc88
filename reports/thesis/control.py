"""Table 6.1's dead bands; chapter 7: position step and ultimate gain."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fdd.identification.experiments.gain import SLIDING
from fdd.identification.experiments.gain import dead_band as find_dead_band
from fdd.plant.details import Details
from fdd.plant.prepare import chatter_filter
from fdd.unit import Unit
from reports.thesis import runs as rig
from reports.thesis.flow import SPEEDS, speeds_of
from reports.thesis.response import HIGH, HIGH_SPEED, LOW, respond
from reports.writing import Panel

Array = NDArray[np.float64]

MOTOR_LEVELS = np.array([0.0, 2e-4, 4e-4, 6e-4, 8e-4, 9e-4, 1e-3, 1.1e-3, 1.2e-3, 1.4e-3, 1.6e-3, 2e-3, 3e-3])
LEVELS = np.array(
    [0.02, 0.04, 0.06, 0.08, 0.10, 0.11, 0.12, 0.13, 0.14, 0.16, 0.18, 0.20, 0.22, 0.24, 0.26, 0.28]
)
"""V, each held. The actuator's dead band has two readings: the offset of its velocity over the command, as
figure 5.1 plots it, and the command from which it slides out of rest."""
HOLD = 5.0
"""s per level; the mean over the last 2 s counts, when the pressure has followed (L_T·β/V_o is about 1/s)."""
_CLIMBS = 3
_MEAN = 2.0
TURNING = 1e-4
"""rad/s: more than two counts of the encoder in 2 s."""


def staircase(unit: Unit, levels: Array, sign: float, seed: int) -> tuple[Array, Array]:
    """Mean motor speed (rad/s) and actuator velocity (m/s) along `sign` at each level (V), from encoders."""
    rows = round(HOLD / rig.PERIOD)
    command = sign * rig.VOLT * np.repeat(levels, rows)
    log = rig.run_speed(unit, command, start=-0.01 * sign, seed=seed).samples
    ends = rows * np.arange(1, levels.size + 1) - 1
    starts = ends - round(_MEAN / rig.PERIOD)
    motor, actuator = (sign * (log[c][ends] - log[c][starts]) / _MEAN for c in ("pump_angle", "position"))
    return np.asarray(motor), np.asarray(actuator)


def slides_from(unit: Unit, levels: Array, sign: float, seed: int) -> float:
    """Dead band (V) of motor and actuator; below break-away the piston creeps as its seals bend."""
    velocity = staircase(unit, levels, sign, seed)[1]
    return find_dead_band(levels, velocity, velocity > SLIDING * rig.hydraulic_gain(unit) * rig.VOLT * levels)


def offsets(command: Array, velocity: Array) -> Array:
    """Where the lines through velocity over command meet zero, forward and reverse, (2,) V, both positive."""
    found = []
    for sign in (1.0, -1.0):
        way = sign * command > 0.0
        slope, rest = np.polyfit(command[way], velocity[way], 1)
        found.append(-sign * rest / slope / rig.VOLT)
    return np.array(found)


def measured_offset(unit: Unit, seed: int, trials: int = _CLIMBS) -> float:
    """Offset (V) in section 5.1's experiment, mean over both directions and the trials."""
    runs = [offsets(SPEEDS, speeds_of(unit, seed + SPEEDS.size * i)[1]) for i in range(trials)]
    return float(np.mean(runs))


def dead_band(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Table 6.1: steady velocities over commands of ±1 to ±10 V, and a climb of small commands."""
    both = (1.0, -1.0)
    turns = np.mean([staircase(axis_a, MOTOR_LEVELS, s, seed)[0] for s in both], axis=0)
    axes = {}
    for name, unit in (("A", axis_a), ("B", axis_b)):
        seeds = range(seed, seed + _CLIMBS)
        climbs = [np.mean([slides_from(unit, LEVELS, s, i) for i in seeds]) for s in both]
        axes[name] = {
            "combined": measured_offset(unit, seed),
            "from_rest": np.mean(climbs),
            "falling": np.mean([slides_from(unit, LEVELS[::-1], s, seed) for s in both]),
        }
    cases = {
        "axis A with half its leakage": rig.with_leakage(axis_a, axis_a, 0.5),
        "axis A with half its friction": rig.with_friction(axis_a, 0.5),
        "axis A, friction that does not rise towards rest": rig.with_friction(axis_a, rises=False),
        "axis B with axis A's leakage": rig.with_leakage(axis_b, axis_a),
        "axis B with axis A's friction": axis_b.model_copy(update={"friction": axis_a.friction}),
    }
    levels = np.concatenate([np.arange(0.01, 0.06, 0.01), LEVELS[2:]])
    changes = [
        (case, measured_offset(unit, seed, 1), np.mean([slides_from(unit, levels, s, seed) for s in both]))
        for case, unit in cases.items()
    ]
    motor = find_dead_band(MOTOR_LEVELS, turns, turns > TURNING)
    return {"motor": motor, "axes": axes, "changes": changes}


GAIN, STEP = 16_875.0, 0.1
"""(rad/s)/m and m, section 7.2."""
TRIALS = 10
_REST, _SECONDS = 500, 3.5
_PLATEAU = 0.97

ULTIMATE = 33_750.0
"""(rad/s)/m, by experiment on the rig."""
OSCILLATES = 20e-6
"""m, peak to peak over the last second: twenty counts of the encoder."""


def filtered_velocity(position: Array) -> Array:
    """Velocity as section 7.2 shows it: differences of the position through eq. 7.5's filter, (n,)."""
    b1, b2, a1, a2 = chatter_filter(350.0, rig.PERIOD)
    rate = np.diff(position, prepend=position[:1]) / rig.PERIOD
    return np.asarray(lfilter([0.0, b1, b2], [1.0, a1, a2], rate))


class Steps(NamedTuple):
    """Trials of one direction: the first one's s since the step, m and m/s (filtered) along it, (n,) each;
    of all, (trials,): saturated velocity (m/s), for how long (s), final error (m)."""

    time: Array
    position: Array
    velocity: Array
    plateau: Array
    duration: Array
    error: Array


def step_trials(unit: Unit, sign: float, seed: int, **how: Any) -> Steps:
    """Step from mid-stroke by 0.1 m along `sign`; the final error is position less set-point, 3.5 s later."""
    setpoint = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / rig.PERIOD), sign * STEP)])
    found, traces = [], []
    for i in range(TRIALS):
        log = rig.run_position(unit, setpoint, GAIN, seed=seed + i, **how).samples
        speed = sign * filtered_velocity(log["position"])
        # The level is the median over the middle of the motion: break-away overshoots it.
        level = float(np.median(speed[_REST + 200 : _REST + 600]))
        fast = np.flatnonzero(speed > _PLATEAU * level)
        error = sign * float(np.mean(log["position"][-50:])) - STEP
        found.append((level, (fast[-1] - fast[0]) * rig.PERIOD, error))
        traces.append((log.time - _REST * rig.PERIOD, sign * log["position"], speed))
    return Steps(*traces[0], *np.array(found).T)


def position_step(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 7.2: a step of 0.1 m under proportional position control, both ways."""
    forward = step_trials(axis_a, 1.0, seed)
    cases: dict[str, tuple[Unit, dict[str, Any]]] = {
        "no dead band at the drive's input": (axis_a, {"details": Details(command_dead_band=0.0)}),
        "a tenth of its friction": (rig.with_friction(axis_a, 0.1), {}),
        "friction that does not rise towards rest": (rig.with_friction(axis_a, rises=False), {}),
        "a tenth of its leakage": (rig.with_leakage(axis_a, axis_a, 0.1), {}),
        "axis B instead": (axis_b, {}),
        "axis B, friction that does not rise towards rest": (rig.with_friction(axis_b, rises=False), {}),
        "axis B riding along, by-pass and throttle open": (axis_a, {"partner": rig.riding_partner(axis_b)}),
    }
    parts = {name: step_trials(unit, 1.0, seed, **how) for name, (unit, how) in cases.items()}
    shown = (forward.time > -0.3) & (forward.time < 2.0)
    time, along = forward.time[shown], "time since the step (s)"
    position, velocity = 1e3 * forward.position[shown], forward.velocity[shown]
    return {
        "ways": {"forward": forward, "reverse": step_trials(axis_a, -1.0, seed)},
        "parts": {"as it is": forward, **parts},
        "picture": [
            Panel([(time, position, "C0-", "plant")], {"ylabel": "position (mm)"},
                  at_y={1e3 * STEP: "set-point"}),
            Panel([(time, velocity, "C0-", "plant, filtered by eq. 7.5")],
                  {"ylabel": "velocity (m/s)", "xlabel": along}, at_y={0.117: "thesis, 0.117 m/s"},
                  at_x={0.8: "thesis, end of saturation"}),
        ],
    }  # fmt: skip


def oscillation(unit: Unit, gain: float, seed: int, partner: rig.Beside | None = None) -> float:
    """Peak to peak position (m) in the last second of four after a step of 0.1 m, less its one-way creep."""
    setpoint = np.concatenate([np.zeros(100), np.full(3900, STEP)])
    last = rig.run_position(unit, setpoint, gain, partner=partner, seed=seed).samples["position"][-1000:]
    return float(np.ptp(last) - abs(np.mean(last[-50:]) - np.mean(last[:50])))


def least_oscillating(unit: Unit, seed: int, partner: rig.Beside | None = None) -> float:
    """Least gain that oscillates, to 3 %; NaN for none."""

    def oscillates(gain: float) -> bool:
        return oscillation(unit, gain, seed, partner) > OSCILLATES

    climb = (0.5 * ULTIMATE * 2.0 ** (0.5 * step) for step in range(12))
    high = next(filter(oscillates, climb), float("nan"))
    low = max(high / np.sqrt(2.0), 0.5 * ULTIMATE)
    while high / low > 1.03:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if oscillates(middle) else (middle, high)
    return high


def linear_ultimate_gain(model: rig.TransferFunction) -> float:
    """Proportional gain at which the loop around ``model/s`` is on the verge, (rad/s)/m: where the model lags
    90°, and the integrator the other 90°."""
    frequency = np.geomspace(0.05, 400.0, 40_001)
    response = model.at(frequency) / np.sign(model.gain)
    late = np.flatnonzero(np.unwrap(np.angle(response)) < -0.5 * np.pi)
    return float(2.0 * np.pi * frequency[late[0]] / np.abs(response[late[0]])) if late.size else np.nan


def ultimate_gain(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 7.2: raise the gain on the plant until it oscillates for ever, and ask the linear models."""
    late_unit, beside = rig.changed(axis_a, "drive", delay=0.01), rig.riding_partner(axis_b)
    return {
        "thesis": ULTIMATE,
        "low": linear_ultimate_gain(LOW),
        "high": linear_ultimate_gain(HIGH),
        "plant": least_oscillating(axis_a, seed),
        "own": linear_ultimate_gain(respond(axis_a, HIGH_SPEED, seed, sines=(10.0,)).model),
        "riding": least_oscillating(axis_a, seed, beside),
        "late_riding": least_oscillating(late_unit, seed, beside),
        "late": least_oscillating(late_unit, seed),
        "soft": least_oscillating(rig.changed(late_unit, "oil", bulk_modulus=4e7), seed),
        "oscillates": OSCILLATES,
    }
