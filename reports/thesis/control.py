"""Chapter 7: chatter filter, position step and ultimate gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, lfilter

from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis.frequency_response import TransferFunction
from reports.thesis.response import HIGH, HIGH_SPEED, LOW, respond
from reports.thesis.runs import (
    PERIOD,
    VOLT,
    Beside,
    Figures,
    changed,
    holding_leakage,
    hydraulic_gain,
    riding_partner,
    run_position,
    with_friction,
    with_leakage,
)
from reports.writing import Panel

Array = NDArray[np.float64]

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


def discrete_filter(method: str) -> tuple[Array, Array]:
    """Second-order Butterworth filter of 350 rad/s at 1 kHz: numerator and denominator, (3,) each.

    `method`: ``zoh`` or ``bilinear`` (Tustin's rule).
    """
    top, bottom, _ = cont2discrete(butter(2, CUTOFF, analog=True), PERIOD, method=method)
    return np.ravel(top), np.asarray(bottom)


def filtered_velocity(position: Array) -> Array:
    """Velocity as section 7.2 shows it: differences of the position through eq. 7.5's filter, (n,)."""
    numerator, denominator = discrete_filter("zoh")
    return np.asarray(lfilter(numerator, denominator, np.diff(position, prepend=position[:1]) / PERIOD))


def chatter_filter(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 7.1.1: recompute eq. 7.5 by zero-order hold and by Tustin's rule; no plant is needed."""
    return {"zoh": discrete_filter("zoh"), "tustin": discrete_filter("bilinear")}


@dataclass(frozen=True)
class Steps:
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
    setpoint = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / PERIOD), sign * STEP)])
    found, traces = [], []
    for i in range(TRIALS):
        log = run_position(unit, setpoint, GAIN, seed=seed + i, **how).samples
        speed = sign * filtered_velocity(log["position"])
        # The level is the median over the middle of the motion: break-away overshoots it.
        level = float(np.median(speed[_REST + 200 : _REST + 600]))
        fast = np.flatnonzero(speed > _PLATEAU * level)
        error = sign * float(np.mean(log["position"][-50:])) - STEP
        found.append((level, (fast[-1] - fast[0]) * PERIOD, error))
        traces.append((log.time - _REST * PERIOD, sign * log["position"], speed))
    return Steps(*traces[0], *np.array(found).T)


def position_step(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 7.2: a step of 0.1 m under proportional position control, both ways."""
    forward = step_trials(axis_a, 1.0, seed)
    cases: dict[str, tuple[Unit, dict[str, Any]]] = {
        "no dead band at the drive's input": (axis_a, {"details": Details(command_dead_band=0.0)}),
        "a tenth of its friction": (with_friction(axis_a, 0.1), {}),
        "friction that does not rise towards rest": (with_friction(axis_a, rises=False), {}),
        "a tenth of its leakage": (with_leakage(axis_a, axis_a, 0.1), {}),
        "axis B instead": (axis_b, {}),
        "axis B, friction that does not rise towards rest": (with_friction(axis_b, rises=False), {}),
        "axis B riding along, by-pass and throttle open": (axis_a, {"partner": riding_partner(axis_b)}),
    }
    parts = {name: step_trials(unit, 1.0, seed, **how) for name, (unit, how) in cases.items()}
    band, command = Details().command_dead_band, GAIN * abs(float(np.mean(forward.error)))
    per_speed = axis_a.pump.displacement * axis_a.cylinder.area_1 / holding_leakage(axis_a)
    shown = (forward.time > -0.3) & (forward.time < 2.0)
    time, along = forward.time[shown], "time since the step (s)"
    position, velocity = 1e3 * forward.position[shown], forward.velocity[shown]
    return {
        "ways": {"forward": forward, "reverse": step_trials(axis_a, -1.0, seed)},
        "parts": {"as it is": forward, **parts},
        "ratio": hydraulic_gain(axis_a),
        "area": axis_a.cylinder.area_1,
        "command": command,
        "force": (command - band) * per_speed,
        "needed": (GAIN * 21e-6 - band) * per_speed,
        "band": band / GAIN,
        "rig_band": 0.06 * VOLT / GAIN,
        "picture": [
            Panel([(time, position, "C0-", "plant")], {"ylabel": "position (mm)"},
                  at_y={1e3 * STEP: "set-point"}),
            Panel([(time, velocity, "C0-", "plant, filtered by eq. 7.5")],
                  {"ylabel": "velocity (m/s)", "xlabel": along}, at_y={0.117: "thesis, 0.117 m/s"},
                  at_x={0.8: "thesis, end of saturation"}),
        ],
    }  # fmt: skip


def oscillation(unit: Unit, gain: float, seed: int, partner: Beside | None = None) -> float:
    """Peak to peak position (m) in the last second of four after a step of 0.1 m, less its one-way creep."""
    setpoint = np.concatenate([np.zeros(100), np.full(3900, STEP)])
    last = run_position(unit, setpoint, gain, partner=partner, seed=seed).samples["position"][-1000:]
    return float(np.ptp(last) - abs(np.mean(last[-50:]) - np.mean(last[:50])))


def least_oscillating(unit: Unit, seed: int, partner: Beside | None = None) -> float:
    """Least gain that oscillates, to 3 %; NaN for none."""
    low, high = 0.5 * ULTIMATE, float("nan")
    for gain in 0.5 * ULTIMATE * np.sqrt(2.0) ** np.arange(12):
        if gain <= MOST and oscillation(unit, float(gain), seed, partner) > OSCILLATES:
            high = float(gain)
            break
        low = float(gain)
    while high / low > 1.03:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if oscillation(unit, middle, seed, partner) > OSCILLATES else (middle, high)
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
    late_unit, beside = changed(axis_a, "drive", delay=0.01), riding_partner(axis_b)
    return {
        "thesis": ULTIMATE,
        "low": linear_ultimate_gain(LOW),
        "high": linear_ultimate_gain(HIGH),
        "plant": least_oscillating(axis_a, seed),
        "own": linear_ultimate_gain(respond(axis_a, HIGH_SPEED, seed, sines=(10.0,)).model),
        "riding": least_oscillating(axis_a, seed, beside),
        "late_riding": least_oscillating(late_unit, seed, beside),
        "late": least_oscillating(late_unit, seed),
        "soft": least_oscillating(changed(late_unit, "oil", bulk_modulus=4e7), seed),
        "crossing": ULTIMATE * hydraulic_gain(axis_a) / (2 * np.pi),
        "oscillates": OSCILLATES,
    }
