"""The compiled loop of the EHA tracker: predict and update, sample by sample."""

from __future__ import annotations

import numpy as np

from estimators.compiled import njit
from estimators.eha import corrections, layout
from estimators.eha import model as eha
from estimators.eha.layout import FLOW_PARAMETERS, Memory, Records
from estimators.eha.noise import Noise
from estimators.eha.update import COUPLED, MOVING, Indices, channel_variance, layers_exceeded, propagate
from estimators.eha.update import update as update_states
from estimators.eha.walk import walk_parameters, watch_jumps
from estimators.kernels import svsf_gain
from estimators.linalg import Array, Mask, joseph_update, project

# Rows of the measurement vector.
Z_X, Z_TH, Z_P1, Z_P2, Z_DP, Z_MEAN = range(6)
MEASUREMENTS = 6
LONGEST_GAP = 50  # periods that are bridged step by step; a longer gap restarts the motion states


@njit()
def measurement(x: Array, q: eha.Parameters, z: Array, y: Array) -> None:
    """Innovation ``y = z − h(x)`` of all channels, model units."""
    y[Z_X] = z[Z_X] - x[eha.X]
    y[Z_TH] = z[Z_TH] - x[eha.TH]
    y[Z_P1] = z[Z_P1] - x[eha.P1]
    y[Z_P2] = z[Z_P2] - x[eha.P2]
    y[Z_DP] = z[Z_DP] - (x[eha.P1] - x[eha.P2])
    y[Z_MEAN] = z[Z_MEAN] - min(x[eha.P1], x[eha.P2])


@njit(error_model="numpy", _nrt=False)
def motion_noise(
    x: Array, h: float, p_acc: float, known_acc: bool, q: eha.Parameters, c: Noise, out: Array
) -> None:
    """Variances of velocity, speed and both chamber volumes over `h` ms."""
    mu = 1e-3 / q.moving_mass
    out[0] = (mu * c.force) ** 2 * 1e3 * h
    out[1] = (c.acceleration * 1e-3) ** 2 * 1e-3 * h
    margin = c.refeed_margin * 1e-6
    fed1 = x[eha.P1] < p_acc + margin if known_acc else x[eha.P1] <= x[eha.P2]
    fed2 = x[eha.P2] < p_acc + margin if known_acc else x[eha.P2] < x[eha.P1]
    relieved = abs(x[eha.P1] - x[eha.P2]) > c.relief_pressure * 1e-6
    small, large = (c.flow * 1e9) ** 2 * 1e-3 * h, (c.flow_refeeding * 1e9) ** 2 * 1e-3 * h
    out[2] = large if relieved or fed1 else small
    out[3] = large if relieved or fed2 else small


@njit()
def _start_motion(x: Array, P: Array, z: Array, p_acc: float, c: Noise) -> None:
    """Set the motion states from a measurement, with wide variances; keep the parameters."""
    for i in range(eha.P2 + 1):
        for j in range(eha.STATES):
            P[i, j] = P[j, i] = 0.0
    x[eha.X] = z[Z_X] if not np.isnan(z[Z_X]) else 0.0
    x[eha.TH] = z[Z_TH] if not np.isnan(z[Z_TH]) else 0.0
    x[eha.V] = x[eha.W] = 0.0
    drop = z[Z_DP] if not np.isnan(z[Z_DP]) else 0.0
    x[eha.P1] = z[Z_P1] if not np.isnan(z[Z_P1]) else p_acc + max(drop, 0.0)
    x[eha.P2] = z[Z_P2] if not np.isnan(z[Z_P2]) else p_acc + max(-drop, 0.0)
    P[eha.X, eha.X] = P[eha.TH, eha.TH] = 1.0
    P[eha.V, eha.V] = 0.1**2
    P[eha.W, eha.W] = 0.3**2
    P[eha.P1, eha.P1] = P[eha.P2, eha.P2] = 0.3**2


@njit()
def _svsf_motion(
    x: Array, P: Array, y: Array, plus: Indices, minus: Indices, r: Array, mask: Mask, e_post: Array,
    gamma: float, layer: float, psi_k: Array,
) -> tuple[bool, Array, Array]:  # fmt: skip
    """What the SVSF makes of the motion states: whether it switched, them, and their variances.

    Seldom called: only where a boundary layer left its limit. Each channel's layer is the optimal one up to
    its own limit: with the limit for all, one pressure beyond its own would take a position
    well within its ten standard deviations for a matter of no hurry, and the motion would run away.
    """
    n, used = COUPLED, 0
    for measured in mask:  # NumPy's own count would load half of the compiler
        used += measured
    H, R, K = np.zeros((used, n)), np.zeros((used, used)), np.empty((n, used))
    e, before, psi = np.empty(used), np.empty(used), np.empty(used)
    a = 0
    for i in range(y.shape[0]):
        if not mask[i]:
            continue
        H[a, plus[i]] = 1.0
        if minus[i] >= 0:
            H[a, minus[i]] = -1.0
        R[a, a], e[a], before[a] = r[i], y[i], e_post[i]
        psi[a] = layer * np.sqrt(r[i] + channel_variance(P, plus[i], minus[i]))
        if 0.0 < psi_k[i] < psi[a]:
            psi[a] = psi_k[i]
        a += 1
    state, covariance = x[:n].copy(), P[:n, :n].copy()
    PHt, HPHt = np.empty((n, used)), np.empty((used, used))
    project(covariance, H, PHt, HPHt)
    switched = svsf_gain(
        PHt, HPHt, R, e, before, gamma, psi, True, K, np.empty(used), np.empty(used, np.bool_)
    )
    if switched:
        joseph_update(covariance, K, H, R)
        for i in range(n):
            for a in range(used):
                state[i] += K[i, a] * e[a]
    return switched, state[:MOVING], np.diag(covariance)[:MOVING].copy()


@njit(error_model="numpy", _nrt=False)
def _take_motion(x: Array, P: Array, motion: Array, variances: Array) -> None:
    """Motion from the SVSF, parameters from the Kalman filter, in place.

    The SVSF's guarantee is for what is measured; carried over to the parameters, its gain throws
    them as far as the innovation is large. No gain has a smaller covariance than Kalman's: the
    surplus of the motion states' variances is added to Kalman's, which leaves it positive.
    """
    for i in range(MOVING):
        if np.isfinite(motion[i]):
            x[i] = motion[i]
        surplus = variances[i] - P[i, i]
        if surplus > 0.0 and np.isfinite(surplus):
            P[i, i] += surplus


@njit(nogil=True)
def track(
    block: Array, period: float, svsf: bool, has_pressures: bool, has_angle: bool,
    decimation: int, q: eha.Parameters, c: Noise, rates: Array, x: Array, P: Array, memory: Memory,
    e_post: Array, gamma: float, layer: float, records: Records,
) -> int:  # fmt: skip
    """Run the filter over the rows of `block`; returns the number of records written."""
    h0 = period * 1e3
    F, G = np.zeros((eha.STATES, eha.STATES)), np.zeros((eha.STATES, 4))
    scratch, work = np.empty((MOVING, eha.STATES)), np.empty((2, eha.STATES))
    layer_work = np.empty((2 * MEASUREMENTS, MEASUREMENTS))
    x_new, walks, noise = np.empty(eha.STATES), np.empty(eha.STATES), np.empty(4)
    before, kept = np.empty((2, FLOW_PARAMETERS)), np.empty((2, 3))
    z, y, psi_k = np.empty(MEASUREMENTS), np.empty(MEASUREMENTS), np.empty(MEASUREMENTS)
    r0, r, mask = np.empty(MEASUREMENTS), np.empty(MEASUREMENTS), np.empty(MEASUREMENTS, dtype=np.bool_)
    r0[Z_X] = (c.position * 1e3) ** 2
    r0[Z_TH] = c.angle**2
    r0[Z_P1] = r0[Z_P2] = (c.pressure * 1e-6) ** 2
    r0[Z_DP] = (c.pressure_difference * 1e-6) ** 2
    # The low side stays near the accumulator: 0.2 MPa, correlated over 10 s.
    r0[Z_MEAN] = 0.2**2 * 1e4 / h0
    plus, minus = np.empty(MEASUREMENTS, dtype=np.int64), np.full(MEASUREMENTS, -1)
    plus[Z_X], plus[Z_TH], plus[Z_P1], plus[Z_P2] = eha.X, eha.TH, eha.P1, eha.P2
    plus[Z_DP], minus[Z_DP] = eha.P1, eha.P2
    friction = eha.friction_curve(x[eha.V], q)  # always that of the present estimate
    written = 0
    for row in range(block.shape[0]):
        time = block[row, layout.TIME]
        # Stamps may come late, never early: the sample belongs to the last grid point before its stamp.
        steps = 0
        if memory.started > 0.0:
            memory.origin += 2e-5 * period
            index = np.floor((time - memory.origin) / period + 0.25)
            steps = int(max(index - memory.index, 1.0))
            memory.index += steps
            early = memory.origin + memory.index * period - time
            if early > 0.0:
                memory.origin -= early
        else:
            memory.origin, memory.index = time, 0.0
        # The pump angle as measured, or the sum of the speed samples (each the mean over its period).
        speed = block[row, layout.SPEED]
        if has_angle:
            z[Z_TH] = block[row, layout.ANGLE]
        else:
            if np.isnan(speed):
                speed = memory.speed
            if steps > 0:
                memory.angle += period * (speed + (steps - 1) * 0.5 * (speed + memory.speed))
            memory.speed = speed
            z[Z_TH] = memory.angle
        if not np.isnan(block[row, layout.ACCUMULATOR]):
            memory.accumulator_pressure = block[row, layout.ACCUMULATOR] * 1e-6
        known_acc = not np.isnan(memory.accumulator_pressure)
        p_acc = memory.accumulator_pressure if known_acc else q.accumulator_pressure
        if not np.isnan(block[row, layout.VISCOSITY]):
            memory.viscosity = block[row, layout.VISCOSITY]
        viscosity = memory.viscosity
        z[Z_X] = block[row, layout.POSITION] * 1e3
        z[Z_P1] = block[row, layout.PRESSURE_1] * 1e-6
        z[Z_P2] = block[row, layout.PRESSURE_2] * 1e-6
        z[Z_DP] = block[row, layout.DIFFERENCE] * 1e-6
        z[Z_MEAN] = p_acc
        gap = z[Z_DP] - (z[Z_P1] - z[Z_P2])  # NaN without redundancy
        if has_pressures:  # their difference is not new, and the redundancy is a sensor check of its own
            z[Z_DP] = z[Z_MEAN] = np.nan

        # Without position or angle there is no volume balance: such a row counts as missing.
        blind = np.isnan(z[Z_X]) or np.isnan(z[Z_TH])
        if blind:
            memory.blind += steps
            if memory.started == 0.0:
                continue
        else:
            steps += int(memory.blind)
            memory.blind = 0.0
            if memory.started == 0.0:
                _start_motion(x, P, z, p_acc, c)
                memory.started = 1.0
            elif steps > LONGEST_GAP:
                _start_motion(x, P, z, p_acc, c)
                walk_parameters(x, P, steps * h0, memory.unrest, c, rates, walks)
                for i in range(eha.STATES):
                    P[i, i] += walks[i]
            else:
                span = steps * h0
                spread = (P[eha.V, eha.V] + (1e-3 / q.moving_mass * c.force) ** 2 * 1e3 * h0) * span * span
                trust = spread / (spread + P[eha.X, eha.X] + r0[Z_X])
                v_at = x[eha.V] + trust * ((z[Z_X] - x[eha.X]) / span - x[eha.V])
                w_at = (z[Z_TH] - x[eha.TH]) / span
                for k in range(steps):
                    if k > 0:
                        friction = eha.friction_curve(x[eha.V], q)
                    motion_noise(x, h0, p_acc, known_acc, q, c, noise)
                    walk_parameters(x, P, h0, memory.unrest, c, rates, walks)
                    eha.advance(x, h0, viscosity, p_acc, v_at, w_at, q, friction, COUPLED, x_new, F, G)
                    for i in range(MOVING):
                        x[i] = x_new[i]
                    propagate(P, F, G, noise, walks, scratch)
        measurement(x, q, z, y)
        plus[Z_MEAN] = eha.P1 if x[eha.P1] <= x[eha.P2] else eha.P2
        for i in range(MEASUREMENTS):
            mask[i] = not blind and not np.isnan(y[i])
            r[i] = r0[i]
            if mask[i] and not svsf:
                variance = r[i] + channel_variance(P, plus[i], minus[i])
                excess = y[i] * y[i] / corrections.ROBUST**2 - variance
                if excess > 0.0:
                    r[i] += excess
        for i in range(FLOW_PARAMETERS):
            before[0, i] = x[eha.LEAK + i]
            before[1, i] = P[eha.LEAK + i, eha.LEAK + i]
        kept[0, 0], kept[0, 1] = x[eha.AIR], x[eha.SPLIT]
        kept[1, 0], kept[1, 1] = P[eha.AIR, eha.AIR], P[eha.SPLIT, eha.SPLIT]
        kept[1, 2] = P[eha.AIR, eha.SPLIT]
        switched = False
        motion, variances = work[0, :MOVING], work[1, :MOVING]
        if svsf:
            # That the low side stays near the accumulator is no measurement: so vague a channel has an
            # optimal layer far wider than its innovations, and would be outside its limit all the time.
            believed, mask[Z_MEAN] = mask[Z_MEAN], False
            if layers_exceeded(P, y, plus, minus, r, mask, e_post, gamma, layer, psi_k, layer_work):
                switched, motion, variances = _svsf_motion(
                    x, P, y, plus, minus, r, mask, e_post, gamma, layer, psi_k
                )
            mask[Z_MEAN] = believed
        nis = update_states(x, P, y, plus, minus, r, mask, work)
        if switched:
            _take_motion(x, P, motion, variances)
        if svsf:
            measurement(x, q, z, y)
            for i in range(MEASUREMENTS):
                if mask[i]:
                    e_post[i] = y[i]
        if corrections.pressures_rest(x, max(steps, 1) * h0, c, memory):
            corrections.keep_compliance(x, P, kept)
        if not blind:
            friction = eha.friction_curve(x[eha.V], q)
            watch_jumps(x, P, before, max(steps, 1) * h0, c, memory)
            corrections.compare_sensors(x, P, gap, r0[Z_DP] + 2.0 * r0[Z_P1], memory)
            corrections.balance_forces(x, P, max(steps, 1) * h0, friction[0], q, c, memory)
        corrections.keep_in_bounds(x, P)
        memory.nis += nis
        memory.outside += 1.0 if switched else 0.0
        memory.count += 1.0
        if memory.count >= decimation:
            rec = records[written]
            rec.time = time
            for i in range(eha.STATES):
                rec.state[i] = x[i]
                rec.variance[i] = P[i, i]
            # Against a restless load the friction curve's misfit repeats itself: count it once.
            for i in (eha.FRIC, eha.VISC, eha.SKEW):
                rec.variance[i] *= max(memory.unrest, 1.0) ** 2
            rec.nis = memory.nis / memory.count
            rec.outside = memory.outside / memory.count
            rec.bulk_modulus[0] = 1e6 / eha.compliance(x[eha.P1], x[eha.AIR] + x[eha.SPLIT], q)[0]
            rec.bulk_modulus[1] = 1e6 / eha.compliance(x[eha.P2], x[eha.AIR] - x[eha.SPLIT], q)[0]
            rec.viscosity = viscosity
            rec.unrest = memory.unrest
            memory.nis = memory.outside = memory.count = 0.0
            written += 1
    return written
