"""Windows of residual features: dimensionless, zero on a healthy unit, shrunk where unknown.

An estimate that the data do not pin down says nothing about a fault. So each estimated
deviation ``d`` with variance ``s²`` enters as its posterior mean under a healthy prior of
spread ``s₀``, ``d s₀²/(s₀² + s²)``: it tends to zero, which means "no evidence", when the
quantity is not observable.

=====================  =====================================================================
feature                meaning
=====================  =====================================================================
leakage                log of leakage across the ports over healthy, at equal viscosity
valve_1, valve_2       log of one plus a chamber's leakage into the accumulator over healthy leakage
valve_largest          the larger of the two
loss_1, loss_2         log of a chamber's whole loss over healthy: leakage and its valve's together, which
                       stays known while the load pushes one way and neither of them is
loss_largest           the larger of the two
jump                   log of one plus how far the largest score of the flow parameters passes its usual
                       size: something changed at once
accumulator            accumulator pressure less the charge, per 100 kPa: oil that left the circuit
compliance             log of oil compliance at reference pressure over healthy: air
friction               Coulomb and Stribeck friction over healthy, less one
viscous                change of viscous friction at 50 mm/s over healthy Coulomb friction
redundancy             pressure difference less the chambers' difference, per 50 kPa
torque                 log of motor current per shaft torque over healthy
refeed_deficit         how far the low side lies below the accumulator, per 100 kPa
low_side               low side less accumulator pressure, per 200 kPa
drive                  log of speed over demanded speed
innovation             log of the normalised innovation squared per channel
load_throttle          log of one plus a throttled partner's force at 50 mm/s over Coulomb friction
load_unrest            log of how much faster than usual the load moves
=====================  =====================================================================

The last two are no residuals but say how far friction can be trusted against this load. Each
residual comes twice: against the unit's healthy baseline, and as its change since the log began
(``…_change``), which load, temperature and sensor gains that last through the log drop out of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from estimators import eha_model as eha
from fdd.residuals.tracking import Channels, healthy_coulomb, healthy_viscous
from fdd.unit import Unit

Array = NDArray[np.float64]

RESIDUALS = (
    "leakage", "valve_1", "valve_2", "valve_largest", "loss_1", "loss_2", "loss_largest", "jump",
    "compliance", "friction", "viscous", "redundancy", "torque", "refeed_deficit", "low_side", "accumulator",
    "drive", "innovation",
)  # fmt: skip
CONTEXT = ("load_throttle", "load_unrest")
"""Features that describe the load and not the unit's health."""
WINDOW_FEATURES = RESIDUALS + CONTEXT
"""What one window gives by itself."""
CHANGES = tuple(f"{name}_change" for name in RESIDUALS)
"""Residuals less their mean over the log's first `REFERENCE_WINDOWS` windows."""
FEATURES = WINDOW_FEATURES + CHANGES
REFERENCE_WINDOWS = 8
FEATURE_VERSION = "2"
"""Goes up when a feature's meaning changes: models and baselines of another version do not fit."""

WINDOW = 2.0
HOP = 0.5
PRIOR_LOG = 0.3
"""Healthy spread of a log ratio: what the prior of the shrinkage holds for plausible."""
PRIOR_FRICTION = 0.5
"""Seals differ more, from trial to trial and with the load, than leakage and oil do."""
VISCOUS_SPEED = 0.05
USUAL_SCORE = 3.0
"""Largest of some forty scores in a healthy window: N(0, 1) passes it in one of ten."""
AVERAGING = 10
"""Samples averaged before a regression: takes tones and ripple out."""


def shrink(value: float, variance: float, prior: float = PRIOR_LOG) -> float:
    """Posterior mean of a deviation under a healthy prior of standard deviation `prior`."""
    if not np.isfinite(value) or not np.isfinite(variance):
        return 0.0
    return float(value * prior**2 / (prior**2 + max(variance, 0.0)))


def window_features(
    records: Array, rows: Array, command: Array, current: Array, unit: Unit, model: Array, channels: Channels
) -> Array:
    """Features of one window.

    Parameters
    ----------
    records : (k, RECORD) of the EKF within the window.
    rows : (n, 9) the tracker's columns within the window.
    command, current : (n,) rad/s and A, NaN where not measured.
    unit, model : profile, and its reduced model's parameters.

    Returns
    -------
    (len(WINDOW_FEATURES),) finite.
    """
    x = records[:, layout.R_STATE : layout.R_STATE + eha.STATES].mean(axis=0)
    var = records[:, layout.R_VARIANCE : layout.R_VARIANCE + eha.STATES].mean(axis=0)
    f = dict.fromkeys(WINDOW_FEATURES, 0.0)
    f["leakage"] = shrink(float(np.log(x[eha.LEAK])), float(var[eha.LEAK] / x[eha.LEAK] ** 2))
    for name, i in (("valve_1", eha.VALVE1), ("valve_2", eha.VALVE2)):
        f[name] = shrink(float(np.log1p(x[i])), float(var[i] / (1.0 + x[i]) ** 2))
    f["valve_largest"] = max(f["valve_1"], f["valve_2"])
    for name, i, column in (
        ("loss_1", eha.VALVE1, layout.R_LEAK_VALVE1),
        ("loss_2", eha.VALVE2, layout.R_LEAK_VALVE2),
    ):
        loss = float(x[eha.LEAK] + x[i])
        spread = float(var[eha.LEAK] + var[i] + 2.0 * records[:, column].mean())
        f[name] = shrink(float(np.log(loss)), spread / loss**2)
    f["loss_largest"] = max(f["loss_1"], f["loss_2"])
    scores = records[:, layout.R_SCORE : layout.R_SCORE + layout.FLOW_PARAMETERS]
    f["jump"] = float(np.log1p(max(np.abs(scores).max() - USUAL_SCORE, 0.0)))
    pressure = unit.oil.reference_pressure * 1e-6
    healthy, _, slope = eha.compliance(pressure, unit.oil.air_fraction * 1e3, model)
    now, _, _ = eha.compliance(pressure, float(x[eha.AIR]), model)
    f["compliance"] = shrink(float(np.log(now / healthy)), float((slope / now) ** 2 * var[eha.AIR]))
    f["friction"] = shrink(float(x[eha.FRIC] - 1.0), float(var[eha.FRIC]), prior=PRIOR_FRICTION)
    coulomb = max(healthy_coulomb(unit), 1.0)
    scale = VISCOUS_SPEED / coulomb
    f["viscous"] = shrink(
        float((x[eha.VISC] - healthy_viscous(unit)) * scale), float(var[eha.VISC] * scale**2), prior=0.5
    )
    force = abs(float(x[eha.THROT])) * VISCOUS_SPEED**2
    f["load_throttle"] = float(np.log1p(force / coulomb))
    f["load_unrest"] = float(np.log(max(float(records[:, layout.R_UNREST].mean()), 1e-2)))
    # What the load hides: a throttled partner's force is modelled to some 15 %, and a load that moves by
    # itself pushes the piston its own way, which looks like less friction.
    hidden = (0.15 * force / coulomb) ** 2 + (0.2 * float(records[:, layout.R_UNREST].mean())) ** 2
    for name in ("friction", "viscous"):
        f[name] = shrink(f[name], hidden, prior=PRIOR_FRICTION)
    channels_used = max(float(records[:, layout.R_CHANNELS].mean()), 1.0)
    nis = float(records[:, layout.R_NIS].mean()) / channels_used
    f["innovation"] = float(np.log(max(nis, 1e-3)))
    _pressure_features(f, rows, unit, channels)
    _drive_features(f, rows, command, current, unit, channels)
    return np.array([f[name] if np.isfinite(f[name]) else 0.0 for name in WINDOW_FEATURES])


def _pressure_features(f: dict[str, float], rows: Array, unit: Unit, channels: Channels) -> None:
    """What the pressures say among themselves."""
    if "pressure_accumulator" in channels.names:
        store = rows[:, layout.ACCUMULATOR]
        if np.isfinite(store).any():
            f["accumulator"] = float((np.nanmean(store) - unit.accumulator.charge_pressure) / 100e3)
    if not channels.chambers:
        return
    p1, p2 = rows[:, layout.PRESSURE_1], rows[:, layout.PRESSURE_2]
    if "pressure_difference" in channels.names:
        gap = rows[:, layout.DIFFERENCE] - (p1 - p2)
        if np.isfinite(gap).any():
            f["redundancy"] = float(np.nanmedian(gap) / 50e3)
    if "pressure_accumulator" in channels.names:
        below = np.fmin(p1, p2) - rows[:, layout.ACCUMULATOR]
        if np.isfinite(below).sum() > AVERAGING:
            low = _means(below)
            low = low[np.isfinite(low)]
            if low.size:
                missing = -low - unit.accumulator.refeed_cracking_pressure - 10e3
                f["refeed_deficit"] = float(np.mean(np.maximum(missing, 0.0)) / 100e3)
                f["low_side"] = float(np.mean(low) / 200e3)


def _drive_features(
    f: dict[str, float], rows: Array, command: Array, current: Array, unit: Unit, channels: Channels
) -> None:
    """What motor current and command say about the drive."""
    speed = rows[:, layout.SPEED]
    if not np.isfinite(speed).any():
        angle, time = rows[:, layout.ANGLE], rows[:, layout.TIME]
        if time.size < 3 or not np.isfinite(angle).any():
            return
        speed = np.gradient(angle, time)
    w = _means(speed)
    if "command" in channels.names and np.isfinite(command).any():
        u = _means(command)
        good = np.isfinite(u) & np.isfinite(w) & (np.abs(u) > 0.05 * unit.drive.max_speed)
        if good.sum() > 10:
            gain = float(np.dot(u[good], w[good]) / np.dot(u[good], u[good]))
            spread = float(np.var(w[good] - gain * u[good]) / np.dot(u[good], u[good]))
            if gain > 0.05:
                f["drive"] = shrink(float(np.log(gain)), spread / gain**2)
    if "motor_current" not in channels.names or not np.isfinite(current).any():
        return
    drop = rows[:, layout.DIFFERENCE]
    if channels.chambers:
        drop = rows[:, layout.PRESSURE_1] - rows[:, layout.PRESSURE_2]
    i, p = _means(current), _means(drop)
    dt = AVERAGING * float(np.median(np.diff(rows[:, layout.TIME])))
    acceleration = np.gradient(w, dt) if w.size > 2 else np.zeros_like(w)
    torque = unit.pump.displacement * p + unit.drive.inertia * acceleration
    good = np.isfinite(i) & np.isfinite(torque) & np.isfinite(w)
    if good.sum() < 30:
        return
    columns = np.column_stack([torque[good], w[good] / 100.0, np.tanh(w[good] / 2.0), np.ones(good.sum())])
    solution, *_ = np.linalg.lstsq(columns, i[good], rcond=None)
    residual = i[good] - columns @ solution
    # Neighbouring means are not independent: count one in five.
    normal = np.linalg.pinv(columns.T @ columns) * 5.0 * max(float(np.var(residual)), 1e-6)
    ratio = float(solution[0] * unit.drive.torque_constant)
    if ratio > 0.05:
        f["torque"] = shrink(
            float(np.log(ratio)), float(normal[0, 0]) * (unit.drive.torque_constant / ratio) ** 2
        )


def _means(values: Array) -> Array:
    """Means of `AVERAGING` neighbours; NaN where most are missing."""
    n = values.size // AVERAGING
    parts = values[: n * AVERAGING].reshape(n, AVERAGING)
    known = np.isfinite(parts)
    count = known.sum(axis=1)
    total = np.where(known, parts, 0.0).sum(axis=1)
    return np.where(count > AVERAGING // 2, total / np.maximum(count, 1), np.nan)
