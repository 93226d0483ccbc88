"""The motor's torque constant from its current against the pump's load torque in slow motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.identification.balance import Estimate
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
_GROUPS = 10


def fit_torque_constant(records: list[Record], displacement: float) -> tuple[Estimate | None, str]:
    """Regress current on D·Δp, sign of the speed, speed and its rate; K_t is one over the first slope.

    Friction of motor and pump that grows with load is part of it: it is an effective constant.

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
    slope = _slope(m, y)
    group = np.arange(y.size) // 20 % _GROUPS
    left_out = np.array([_slope(m[group != g], y[group != g]) for g in range(_GROUPS)])
    std = float(np.sqrt((_GROUPS - 1) / _GROUPS * np.sum((left_out - left_out.mean()) ** 2)))
    if slope <= 0.0 or std > WELL_DETERMINED * slope:
        return None, f"slope of current over load torque {slope:.3g} ± {std:.2g} A/(N·m) is not sharp enough"
    relative = float(np.hypot(std / slope, 0.01))
    return Estimate(1.0 / slope, relative / slope), "effective: friction that grows with load is in it"


def _windows(record: Record, displacement: float) -> tuple[Array, Array]:
    assert record.current is not None
    step = record.rows(WINDOW)
    n = len(record) // step * step
    _, w = record.speeds(0.02)
    rate = np.gradient(record.smooth(w, 0.02), record.period)
    drop = record.pressure_1 - record.pressure_2 if record.chambers_measured else record.difference

    def mean(values: Array) -> Array:
        return np.asarray(values[:n].reshape(-1, step).mean(axis=1), dtype=np.float64)

    speed, acceleration = mean(w), mean(rate)
    slow = (np.abs(rate[:n]).reshape(-1, step).max(axis=1) < SLOW) & (np.abs(speed) > 2.0)
    slow &= ~record.gap[:n].reshape(-1, step).any(axis=1)
    m = np.column_stack(
        [displacement * mean(drop), np.sign(speed), speed * 1e-2, acceleration * 1e-2, np.ones_like(speed)]
    )
    return m[slow], mean(record.current)[slow]


def _slope(m: Array, y: Array) -> float:
    weights: Array = np.ones(y.size)
    theta: Array = np.zeros(m.shape[1])
    for _ in range(6):
        theta = np.asarray(np.linalg.lstsq(m * weights[:, None], y * weights, rcond=1e-10)[0])
        residual = y - m @ theta
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weights = np.sqrt(np.minimum(1.0, 2.0 * sigma / np.maximum(np.abs(residual), 1e-12)))
    return float(theta[0])
