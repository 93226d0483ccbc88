"""The motor's torque constant from its current against the pump's load torque in slow motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.identification.least_squares import Estimate, jackknife_std
from fdd.identification.record import Record

Array = NDArray[np.float64]

WINDOW = 0.1
"""s over which currents and pressures are averaged."""
LEAST_WINDOWS = 60
SLOW = 400.0
"""rad/s²: above it the rotor's inertia would hide the load torque."""
LEAST_RANGE = 0.3
"""N·m of load torque that must be covered."""
WELL_DETERMINED = 0.03
GEAR_FRICTION = (0.05, 0.03)
"""Torque by which the load rubs in gears and bearings, over D·Δp, with its standard deviation: catalogues
give gear pumps 85 to 95 % of their torque, about half of the loss being this (McCandlish and Dorey)."""
GAINS = 0.005
"""Of the sensors of current and pressures, relative: catalogues allow 0.5 % each."""
BLOCK = 20
"""Windows, 2 s: residuals nearer than that are one."""
_GROUPS = 10


def fit_torque_constant(records: list[Record], displacement: float) -> tuple[Estimate | None, str]:
    """Regress current on D·Δp, |D·Δp| and 1 with the sign of the speed, speed and its rate.

    K_t is one over the first slope; the second over the first is friction that grows with load, and where
    load and motion always go together it is known by `GEAR_FRICTION` alone.

    Parameters
    ----------
    records : logs, those without current are passed over. displacement : m³/rad, as identified.

    Returns
    -------
    The constant (N·m/A), or None with the reason.
    """
    parts = [_windows(r, displacement) for r in records if r.current is not None]
    if not parts:
        return None, "motor current is not measured"
    m = np.concatenate([p[0] for p in parts])
    y = np.concatenate([p[1] for p in parts])
    if y.size < LEAST_WINDOWS:
        return None, "too little slow motion"
    if np.ptp(m[:, 0]) < LEAST_RANGE:
        return None, f"load torque covers {np.ptp(m[:, 0]):.2f} N·m only"
    usual, doubt = GEAR_FRICTION
    slope = _slope(m, y, usual)
    group = np.arange(y.size) // BLOCK % _GROUPS
    left_out = np.array([_slope(m[group != g], y[group != g], usual) for g in range(_GROUPS)])
    std = float(jackknife_std(left_out))
    if slope <= 0.0 or std > WELL_DETERMINED * slope:
        return None, f"slope of current over load torque {slope:.3g} ± {std:.2g} A/(N·m) is not sharp enough"
    gears = _slope(m, y, usual + doubt) - slope
    relative = float(np.sqrt(std**2 + gears**2 + (GAINS * slope) ** 2)) / slope
    return Estimate(1.0 / slope, relative / slope), "friction that grows with load taken off"


def _windows(record: Record, displacement: float) -> tuple[Array, Array]:
    assert record.current is not None
    step = record.rows(WINDOW)
    n = len(record) // step * step
    _, w = record.speeds(0.02)
    rate = np.gradient(record.smooth(w, 0.02), record.period)
    drop = record.pressure_1 - record.pressure_2 if record.chambers_measured else record.difference
    drop = displacement * drop

    def mean(values: Array) -> Array:
        return np.asarray(values[:n].reshape(-1, step).mean(axis=1), dtype=np.float64)

    speed, acceleration = mean(w), mean(rate)
    slow = (np.abs(rate[:n]).reshape(-1, step).max(axis=1) < SLOW) & (np.abs(speed) > 2.0)
    slow &= ~record.gap[:n].reshape(-1, step).any(axis=1)
    load, turning = mean(drop), np.sign(speed)
    m = np.column_stack(
        [load, np.abs(load) * turning, turning, speed * 1e-2, acceleration * 1e-2, np.ones_like(speed)]
    )
    return m[slow], mean(record.current)[slow]


def _slope(m: Array, y: Array, friction: float) -> float:
    """First coefficient; the second over it is `friction`, as sure as `GEAR_FRICTION` says."""
    weights: Array = np.ones(y.size)
    theta: Array = np.zeros(m.shape[1])
    prior = np.zeros(m.shape[1])
    for _ in range(6):
        rows, wanted = np.vstack([m * weights[:, None], prior]), np.append(y * weights, 0.0)
        theta = np.asarray(np.linalg.lstsq(rows, wanted, rcond=1e-10)[0])
        residual = y - m @ theta
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weights = np.sqrt(np.minimum(1.0, 2.0 * sigma / np.maximum(np.abs(residual), 1e-12)))
        sure = np.sqrt(BLOCK) * sigma / max(GEAR_FRICTION[1] * abs(float(theta[0])), 1e-12)
        prior[:2] = -friction * sure, sure
    return float(theta[0])
