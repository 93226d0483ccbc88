"""The matched world, runs drawn from the estimators' own model with the noise that they assume; the bound.

Parameters begin a draw of the filter's initial spread away from its first estimate and walk at random as it
assumes; chamber volumes take the unmodelled flow; measurements have its noise, white and Gaussian.

The one thing that cannot be drawn is motion: an axis whose velocity changed by almost a metre per second
within a millisecond, as the filter allows, would shake itself to pieces. So position follows a duty, the pump
turns as the model's own equations then demand, and both enter as the noise that the model already has on
velocity and speed. The circuit has no case leakage and, with all sensors, an accumulator below both chambers:
no check valve opens. With the minimum set the filter takes the low side for fed and near the charge; there it
is held so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, lfilter, sosfiltfilt

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.update import MOVING, propagate
from estimators.kernels import scalar_update
from fdd.plant.duty import DUTIES
from fdd.unit import Unit
from reports.estimators import cases
from reports.estimators.cases import Array, Assumed, Case, Rows, Trajectory, chamber_noise
from reports.estimators.compiled import njit

FASTEST = 0.1
"""m/s; the set-point is followed no faster."""
SMOOTH_HZ = 4.0
SMOOTHING = 12.0
"""ms, standard deviation of the Gaussian, both ways in time, that forces are smoothed by: friction turns
round with the motion, and no pump could follow that within a millisecond."""
RESPONSE = 10.0
"""ms within which the pump corrects forces: at once it would have to jump with each millisecond's noise."""
LOWEST = 0.4
"""MPa, lowest pressure of a run in either chamber: near axis A's charge, where a real low side stays."""
LOW_SMOOTHING, LEAST_PRESSURE = 100.0, 0.1
"""ms of smoothing, and MPa, of the low side where it is fed."""
CLEARANCE = 0.1
"""MPa by which both chambers stay above the accumulator."""
MOST_THROTTLE = 2.5e5
"""N/(m/s)²: more would open the relief valves at the fastest motion."""
LEAST = {eha.LEAK: 0.1, eha.VALVE1: 0.0, eha.VALVE2: 0.0, eha.FRIC: 0.1, eha.AIR: -1.5}
"""Where a walk is turned back: less is not physical, and the estimators' own limits lie there."""
_LOADS = {"constant": (eha.LOAD,), "spring": (eha.LOAD, eha.STIF), "throttle": (eha.THROT,),
          "gust": (eha.LOAD,)}  # fmt: skip
_OF_LOAD = (eha.LOAD, eha.STIF, eha.THROT, eha.INERT)


class Jump(NamedTuple):
    """A change of one parameter: its state times `factor` plus `shift`, at `onset` s."""

    state: int
    onset: float
    factor: float = 1.0
    shift: float = 0.0


def matched_unit(base: Unit) -> Unit:
    """The unit of the matched world: all of its leakage goes across the ports."""
    pump = base.pump.model_copy(update={"cross_port_leakage": base.pump.total_leakage, "case_leakage": 0.0})
    return base.model_copy(update={"pump": pump})


def draw(
    case: Case, duration: float, model: eha.Parameters, prior: Assumed, rng: np.random.Generator,
    jump: Jump | None = None,
) -> tuple[Trajectory, Array]:  # fmt: skip
    """Draw one run of `duration` s; loads take the parts of the model that are theirs, drawn from the prior.

    Gives `truth`: the run. `block`: (n, 9) what the case's sensors show, as `EhaTracker.push` takes it.
    """
    n = round(duration * 1e3)
    motion = cases.MOTIONS[case.duty]
    setpoint = DUTIES[motion["name"]](**motion).setpoint(n + 1, True, rng)
    smooth = sosfiltfilt(butter(2, SMOOTH_HZ, fs=1000.0, output="sos"), _limited(setpoint, FASTEST * 1e-3))
    position = np.asarray(smooth) * 1e3
    # Parameters begin at the filter's first estimate and a draw of its spread.
    start = prior.start + prior.spread * rng.standard_normal(eha.STATES)
    start[: eha.P2 + 1] = 0.0
    without = [i for i in _OF_LOAD if i not in _LOADS.get(case.load, ())]
    start[without] = 0.0
    start[eha.THROT] = min(abs(start[eha.THROT]), MOST_THROTTLE)
    start[eha.STIF] = abs(start[eha.STIF])
    walk = prior.walk * np.sqrt(1e-3)
    walk[without] = 0.0
    normals = rng.standard_normal((n + 1, eha.STATES))
    parameters = _walked(start, prior.start, walk, prior.pull * 1e-3, normals)
    if jump is not None:
        row = round(jump.onset * 1e3)
        changed = start[jump.state] if jump.factor == 1.0 else parameters[row, jump.state]
        parameters[row:, jump.state] += (jump.factor - 1.0) * changed + jump.shift
    for state, least in LEAST.items():
        parameters[:, state] = least + np.abs(parameters[:, state] - least)
    errors = rng.standard_normal(n // cases.FORCE_PERIOD + 2) * prior.sizes.force_mean
    force = _force(position, parameters, model, errors)
    volumes = rng.standard_normal((n + 1, 2)) * prior.sizes.small
    states = np.empty((n, eha.STATES))
    if case.minimum:
        # The chamber that is fed stays as near to the charge as the filter thinks, and moves as slowly.
        accumulator, slow = float(model.accumulator_pressure), 1.0 / cases.LOW_SIDE_TIME
        steps = cases.LOW_SIDE * rng.standard_normal(n + 1)
        steps[1:] *= np.sqrt(2.0 * slow)
        away = gaussian_filter1d(lfilter([1.0], [1.0, slow - 1.0], steps), LOW_SMOOTHING, mode="nearest")
        low = np.maximum(accumulator + away, LEAST_PRESSURE)
        _follow(position, parameters, force, volumes, accumulator, 0.0, low, model, states)
    else:
        accumulator, charged = LOWEST - CLEARANCE, 2.0 * LOWEST
        for _ in range(4):  # until the lowest pressure is where it shall be; compression is not quite linear
            _follow(position, parameters, force, volumes, accumulator, charged, np.empty(0), model, states)
            charged += LOWEST - float(states[:, [eha.P1, eha.P2]].min())
    x, sizes, noise = states, prior.sizes, rng.standard_normal((n, 6))
    angle = x[:, eha.TH] + noise[:, 1] * sizes.angle
    block = np.full((n, layout.COLUMNS), np.nan)
    block[:, layout.TIME] = np.arange(n) * 1e-3
    block[:, layout.POSITION] = (x[:, eha.X] + noise[:, 0] * sizes.position) * 1e-3
    block[:, layout.SPEED] = np.diff(angle, prepend=angle[0]) * 1e3
    difference = x[:, eha.P1] - x[:, eha.P2] + x[:, eha.ZERO]
    block[:, layout.DIFFERENCE] = (difference + noise[:, 4] * sizes.difference) * 1e6
    if not case.minimum:
        block[:, layout.ANGLE] = angle
        block[:, layout.PRESSURE_1] = (x[:, eha.P1] + noise[:, 2] * sizes.pressure) * 1e6
        block[:, layout.PRESSURE_2] = (x[:, eha.P2] + noise[:, 3] * sizes.pressure) * 1e6
        block[:, layout.ACCUMULATOR] = accumulator * 1e6
    return Trajectory(states, np.full(n, accumulator), np.ones(n)), block


@njit(error_model="numpy")
def _walked(start: Array, centre: Array, walk: Array, pull: Array, normals: Array) -> Array:
    """Walks of all parameters, drawn back to where the filter began; leakage walks in proportion once it has
    grown."""
    out = np.empty_like(normals)
    out[0] = start
    for k in range(1, normals.shape[0]):
        for i in range(start.size):
            at = out[k - 1, i]
            size = max(1.0, at) if i == eha.LEAK else 1.0
            out[k, i] = at - pull[i] * (at - centre[i]) + walk[i] * size * normals[k, i]
    return out


@njit(error_model="numpy")
def _limited(wanted: Array, most: float) -> Array:
    out = np.empty(wanted.size)
    at = wanted[0]
    for i in range(wanted.size):
        at += min(max(wanted[i] - at, -most), most)
        out[i] = at
    return out


def _force(position: Array, parameters: Array, model: eha.Parameters, errors: Array) -> Array:
    """Force that the pressures must carry at each sample (N), (n + 1,).

    The mean over each `FORCE_PERIOD` misses the filter's force balance by one of `errors`, exactly and
    without a jump: the errors' sum is interpolated by a cubic spline, whose slope is the error of the moment.
    """
    v, p = np.diff(position, prepend=position[0]), parameters
    kinds = p[:, eha.FRIC] * _curve(v, model) + p[:, eha.VISC] * v + p[:, eha.LOAD]
    kinds += p[:, eha.STIF] * position + (p[:, eha.THROT] * v + p[:, eha.SKEW]) * np.abs(v)
    acceleration = np.diff(v, prepend=v[0]) * 1e3
    smooth = gaussian_filter1d(kinds, SMOOTHING, mode="nearest")
    sums = CubicSpline(np.arange(errors.size + 1), np.concatenate([[0.0], np.cumsum(errors)]))
    error = sums((np.arange(v.size) + 0.5) / cases.FORCE_PERIOD, 1)
    return np.asarray(smooth + error + (model.moving_mass + p[:, eha.INERT]) * acceleration)


@njit(error_model="numpy")
def _curve(v: Array, q: eha.Parameters) -> Array:
    out = np.empty(v.size)
    for i in range(v.size):
        out[i] = eha.friction_curve(v[i], q)[0]
    return out


@njit(error_model="numpy")
def _follow(
    position: Array, parameters: Array, force: Array, volumes: Array, p_acc: float, charged: float,
    low: Array, q: eha.Parameters, states: Array,
) -> None:  # fmt: skip
    """Walk along the positions: the pump turns as pressures and forces demand.

    From the pressure `charged` no check valve opens; where `low` is given, (n + 1,), the low side is held at
    it by whatever flows into it.
    """
    F, G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
    x, new, fed = np.zeros(eha.STATES), np.empty(eha.STATES), low.size > 0
    x[eha.X] = position[0]
    if fed:
        x[eha.P1] = low[0] + max(force[0], 0.0) / q.area_1
        x[eha.P2] = low[0] - min(force[0], 0.0) / q.area_2
    else:
        x[eha.P1] = charged + 0.5 * force[0] / q.area_1
        x[eha.P2] = charged - 0.5 * force[0] / q.area_2
    for k in range(states.shape[0]):
        x[eha.LEAK :] = parameters[k, eha.LEAK :]
        states[k] = x
        eha.step(x, 1.0, 1.0, p_acc, np.nan, np.nan, q, new, F, G)
        dv = position[k + 1] - position[k] - new[eha.V]
        behind = q.area_1 * x[eha.P1] - q.area_2 * x[eha.P2] - force[k]
        wanted = force[k + 1] + behind * (1.0 - 1.0 / RESPONSE)
        extends = x[eha.P1] > x[eha.P2]
        high, lower, side = (eha.P1, eha.P2, 0) if extends else (eha.P2, eha.P1, 1)
        if fed:
            area = q.area_1 if extends else -q.area_2
            held = low[k + 1] * (q.area_2 if extends else -q.area_1)
            dw = ((wanted + held) / area - new[high] - G[high, 0] * dv) / G[high, 1]
        else:
            wanted -= q.area_1 * (new[eha.P1] + G[eha.P1, 0] * dv)
            wanted += q.area_2 * (new[eha.P2] + G[eha.P2, 0] * dv)
            dw = wanted / (q.area_1 * G[eha.P1, 1] - q.area_2 * G[eha.P2, 1])
        x[:] = new
        for i in range(eha.P2 + 1):
            x[i] += G[i, 0] * dv + G[i, 1] * dw
        if fed:
            x[high] += G[high, 2 + side] * volumes[k, side]
            x[lower] = low[k + 1]
        else:
            x[eha.P1] += G[eha.P1, 2] * volumes[k, 0]
            x[eha.P2] += G[eha.P2, 3] * volumes[k, 1]


@njit(error_model="numpy")
def eha_bound(truth: Trajectory, q: eha.Parameters, prior: Assumed, minimum: bool, rows: Rows) -> Array:
    """The posterior Cramér-Rao bound: how well any filter could know the states from one run's data.

    Variances (k, STATES), model units, at rows (k,), ascending; with `minimum` only the chambers' difference
    is measured of pressures. Noise and statements are the estimators': flow noise large where a chamber is
    fed, friction known by 20 ms mean force balances, of the standard deviation `force_mean`, while the piston
    has slid one way for 80 ms. Their further caution, as in unrest of the load, is not in it.

    For ``x_k = f(x_{k-1}) + w``, ``z_k = h(x_k) + v`` with Gaussian noise the information matrix obeys
    ``J_k = (Q + F J_{k-1}^-1 F')^-1 + H' R^-1 H`` with F and H taken at the true states (Tichavský, Muravchik
    and Nehorai 1998, doi 10.1109/78.668800, eq. 21 by the matrix inversion lemma, which also holds where Q is
    singular, as here). On a linear model it is the Kalman filter's covariance.
    """
    n, motion, states, sizes, wanted = eha.STATES, eha.P2 + 1, truth.states, prior.sizes, 0
    out, P, diag = np.empty((rows.size, n)), np.diag(prior.spread**2), prior.walk**2 * 1e-3
    F, G = np.empty((n, n)), np.empty((n, 4))
    new, k_gain, scratch, noise = np.empty(n), np.empty(n), np.empty(n), np.empty(4)
    moved, still = np.empty((MOVING, n)), np.zeros(n)
    noise[0], noise[1] = sizes.force**2, sizes.acceleration**2
    channels = 4
    H, r = np.zeros((channels, n)), np.empty(channels)
    H[0, eha.X] = H[1, eha.TH] = 1.0
    r[0], r[1] = sizes.position**2, sizes.angle**2
    if minimum:
        H[2, eha.P1], H[2, eha.P2] = 1.0, -1.0
        r[2], r[3] = sizes.difference**2, cases.LOW_SIDE**2 * cases.LOW_SIDE_TIME
    else:
        H[2, eha.P1] = H[3, eha.P2] = 1.0
        r[2] = r[3] = sizes.pressure**2
    force, sliding = np.zeros(n), 0
    for k in range(states.shape[0]):
        x = states[k]
        if k > 0:
            past = states[k - 1]
            p_acc = truth.accumulator[k - 1]
            eha.step(past, 1.0, truth.viscosity[k - 1], p_acc, x[eha.V], x[eha.W], q, new, F, G)
            sd1, sd2 = chamber_noise(past[eha.P1], past[eha.P2], p_acc, not minimum, sizes)
            noise[2], noise[3] = sd1 * sd1, sd2 * sd2
            propagate(P, F, G, noise, still, moved)
            for i in range(motion, n):
                P[i, :] *= 1.0 - 1e-3 * prior.pull[i]
                P[:, i] *= 1.0 - 1e-3 * prior.pull[i]
            for i in range(n):
                P[i, i] += diag[i]
        if minimum:
            low = 1.0 if x[eha.P1] <= x[eha.P2] else 0.0
            H[3, eha.P1], H[3, eha.P2] = low, 1.0 - low
        for c in range(channels):
            scalar_update(P, H[c], r[c], k_gain, scratch)

        # The mean force of a period, wherever the piston slid through all of it and had settled before.
        v = x[eha.V]
        if k > 0 and abs(v) >= q.sliding_velocity and v * states[k - 1, eha.V] > 0.0:
            sliding += 1
        else:
            sliding = 0
        place = k % cases.FORCE_PERIOD
        if place == 0:
            force[:] = 0.0
        force[eha.FRIC] += eha.friction_curve(v, q)[0] / cases.FORCE_PERIOD
        force[eha.VISC] += v / cases.FORCE_PERIOD
        force[eha.SKEW] += abs(v) / cases.FORCE_PERIOD
        force[eha.LOAD] = 1.0
        force[eha.STIF] += x[eha.X] / cases.FORCE_PERIOD
        force[eha.THROT] += v * abs(v) / cases.FORCE_PERIOD
        if place == cases.FORCE_PERIOD - 1 and sliding >= cases.SETTLING:
            force[eha.INERT] = (v - states[k - cases.FORCE_PERIOD + 1, eha.V]) / cases.FORCE_PERIOD * 1e3
            scalar_update(P, force, sizes.force_mean**2, k_gain, scratch)
        if wanted < rows.size and rows[wanted] == k:
            for i in range(n):
                out[wanted, i] = P[i, i]
            wanted += 1
    return out
