"""EKF and SVSF on the reduced EHA model, as one compiled loop over blocks of samples.

A tracker holds its whole state in a few arrays, so results do not depend on how a log
was cut into blocks, and `state` / `restore` carry it across a restart.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators import eha_model as eha
from estimators.kernels import kalman_update, svsf_update

Array = NDArray[np.float64]
Method = Literal["ekf", "svsf"]

# Columns of a block given to `EhaTracker.push`, SI; NaN where a channel has no value.
TIME, POSITION, ANGLE, SPEED, PRESSURE_1, PRESSURE_2, DIFFERENCE, ACCUMULATOR, VISCOSITY = range(9)
COLUMNS = 9

# Rows of the measurement vector.
Z_X, Z_TH, Z_P1, Z_P2, Z_DP, Z_MEAN = range(6)
MEASUREMENTS = 6

# Columns of a record: time, states, variances of the parameters, then diagnostics.
R_TIME = 0
R_STATE = 1
R_VARIANCE = R_STATE + eha.STATES
R_NIS = R_VARIANCE + eha.STATES
R_CHANNELS = R_NIS + 1
R_LOGLIK = R_NIS + 2
R_OUTSIDE = R_NIS + 3
R_LAYER = R_NIS + 4
R_BETA1 = R_NIS + 5
R_BETA2 = R_NIS + 6
R_VISCOSITY = R_NIS + 7
R_UNREST = R_NIS + 8
RECORD = R_NIS + 9

# Slots of the loop's memory.
(
    M_ORIGIN, M_INDEX, M_ANGLE, M_SPEED, M_ACC, M_VISC, M_COUNT, M_STARTED, M_NIS, M_CHANNELS, M_LOGLIK,
    M_OUT, M_FORCE, M_VMEAN, M_XMEAN, M_VSTART, M_FSIGN, M_FCOUNT, M_CURVE, M_SQUARE, M_FSCALE, M_SLID,
) = range(22)  # fmt: skip
MEMORY = 22

LONGEST_GAP = 50  # periods that are bridged step by step; a longer gap restarts the motion states
FORCE_PERIOD = 20.0  # ms: one force balance each; shorter would count the friction curve's errors twice
FRICTION_LAG = 30.0  # ms
FRICTION_SETTLES = 80.0  # ms of sliding one way before the curve holds: break-away and bristles are over
PARTNER_MISFIT = 0.2
ROBUST = 5.0  # innovations beyond this many sigmas are weighed down (Huber)


@dataclass
class Noise:
    """Noise of model and measurements, SI; each default says why.

    Rates are standard deviations after one second of random walk.
    """

    position: float = 5e-7
    """m; a 1 µm encoder rounds with 0.3 µm, the rest is its mounting."""
    angle: float = 1e-4
    """rad; one count of 65536 per turn."""
    pressure: float = 9e3
    """Pa; white noise of the same spectral density as the chamber transducers' below 100 Hz."""
    pressure_difference: float = 7e3
    """Pa; Appendix A.2.2."""
    force: float = 100.0
    """N·√s: load inertia, bristles and gusts are not modelled; motion follows the encoder instead.

    With less of it the filter would read the bulk modulus off the resonance, and take an unknown
    inertia of the load for a change of the oil."""
    force_mean: float = 20.0
    """N: how well the friction curve fits the mean force over `FORCE_PERIOD` while sliding."""
    acceleration: float = 630.0
    """rad/s/√s: the drive may change the speed by 20 rad/s within one millisecond."""
    flow: float = 1e-7
    """m³/√s: unmodelled flow (gear ripple, line losses, leakage that is not laminar): half a percent
    of the pump's flow at a third of its speed, correlated over 0.1 s."""
    flow_refeeding: float = 5e-6
    """m³/√s: a chamber that the accumulator feeds has no volume balance."""
    leakage: float = 0.05
    """1/√s relative: lets a step of 50 % be followed within two seconds under load."""
    valve: float = 0.02
    """1/√s relative to the healthy leakage: a closed valve stays closed for long."""
    air: float = 5e-4
    """1/√s, of the oil's volume: a tenth of a percent of free air comes or goes within seconds."""
    gain: float = 1e-4
    """1/√s; the displacement changes with wear only, the rest is temperature."""
    friction: float = 0.07
    """1/√s relative to the healthy curve."""
    viscous_friction: float = 10.0
    load: float = 100.0
    """N/√s to begin with; how restless the load really is follows from the force balance itself."""
    stiffness: float = 1e3
    """N/m/√s."""
    throttle: float = 5e3
    """N/(m/s)²/√s."""
    initial_leakage: float = 0.3
    initial_valve: float = 0.03
    initial_air: float = 1e-3
    initial_gain: float = 3e-3
    initial_friction: float = 0.3
    initial_viscous_friction: float = 100.0
    initial_load: float = 1000.0
    initial_stiffness: float = 1e4
    initial_throttle: float = 1e6
    refeed_margin: float = 3e4
    """Pa above the accumulator below which a chamber may be fed: cracking pressure and sensor zeros."""
    relief_pressure: float = 3.1e6
    """Pa of difference from which the relief valve may open."""

    def array(self) -> Array:
        """The numbers in the order of the fields, SI."""
        return np.array([float(getattr(self, f.name)) for f in fields(self)])


(
    N_X, N_TH, N_P, N_DP, N_FORCE, N_FMEAN, N_ACCEL, N_FLOW, N_REFEED, N_LEAK, N_VALVE, N_AIR, N_GAIN, N_FRIC,
    N_VISC, N_LOAD, N_STIF, N_THROT, I_LEAK, I_VALVE, I_AIR, I_GAIN, I_FRIC, I_VISC, I_LOAD, I_STIF, I_THROT,
    N_MARGIN, N_RELIEF,
) = range(29)  # fmt: skip


@njit(cache=True)
def measurement(x: Array, q: Array, z: Array, y: Array) -> None:
    """Innovation ``y = z − h(x)`` of all channels, model units."""
    y[Z_X] = z[Z_X] - x[eha.X]
    y[Z_TH] = z[Z_TH] - x[eha.TH]
    y[Z_P1] = z[Z_P1] - x[eha.P1]
    y[Z_P2] = z[Z_P2] - x[eha.P2]
    y[Z_DP] = z[Z_DP] - (x[eha.P1] - x[eha.P2])
    y[Z_MEAN] = z[Z_MEAN] - min(x[eha.P1], x[eha.P2])


@njit(cache=True)
def _process_noise(
    x: Array,
    h: float,
    p_acc: float,
    known_acc: bool,
    unrest: float,
    q: Array,
    c: Array,
    out: Array,
    diag: Array,
) -> None:
    """Variances of velocity, speed and chamber volumes, and of the parameters, over `h` ms.

    `unrest` is how much more than expected the load moves, see `_balance_forces`.
    """
    mu = 1e-3 / q[eha.Q_MASS]
    out[0] = (mu * c[N_FORCE]) ** 2 * 1e3 * h
    out[1] = (c[N_ACCEL] * 1e-3) ** 2 * 1e-3 * h
    margin = c[N_MARGIN] * 1e-6
    fed1 = x[eha.P1] < p_acc + margin if known_acc else x[eha.P1] <= x[eha.P2]
    fed2 = x[eha.P2] < p_acc + margin if known_acc else x[eha.P2] < x[eha.P1]
    relieved = abs(x[eha.P1] - x[eha.P2]) > c[N_RELIEF] * 1e-6
    small, large = (c[N_FLOW] * 1e9) ** 2 * 1e-3 * h, (c[N_REFEED] * 1e9) ** 2 * 1e-3 * h
    out[2] = large if relieved or fed1 else small
    out[3] = large if relieved or fed2 else small
    seconds = 1e-3 * h
    diag[:] = 0.0
    diag[eha.LEAK] = c[N_LEAK] ** 2 * seconds
    diag[eha.VALVE1] = diag[eha.VALVE2] = c[N_VALVE] ** 2 * seconds
    diag[eha.AIR] = (c[N_AIR] * 1e3) ** 2 * seconds
    diag[eha.GAIN] = c[N_GAIN] ** 2 * seconds
    diag[eha.FRIC] = c[N_FRIC] ** 2 * seconds
    diag[eha.VISC] = c[N_VISC] ** 2 * seconds
    diag[eha.LOAD] = c[N_LOAD] ** 2 * seconds * unrest
    diag[eha.STIF] = (c[N_STIF] * 1e-3) ** 2 * seconds
    diag[eha.THROT] = c[N_THROT] ** 2 * seconds


@njit(cache=True)
def _start_motion(x: Array, P: Array, z: Array, p_acc: float, c: Array) -> None:
    """Set the motion states from a measurement, with wide variances; keep the parameters."""
    for i in range(eha.P2 + 1):
        for j in range(eha.STATES):
            P[i, j] = 0.0
            P[j, i] = 0.0
    x[eha.X] = z[Z_X] if not np.isnan(z[Z_X]) else 0.0
    x[eha.TH] = z[Z_TH] if not np.isnan(z[Z_TH]) else 0.0
    x[eha.V] = 0.0
    x[eha.W] = 0.0
    drop = z[Z_DP] if not np.isnan(z[Z_DP]) else 0.0
    x[eha.P1] = z[Z_P1] if not np.isnan(z[Z_P1]) else p_acc + max(drop, 0.0)
    x[eha.P2] = z[Z_P2] if not np.isnan(z[Z_P2]) else p_acc + max(-drop, 0.0)
    P[eha.X, eha.X] = 1.0
    P[eha.V, eha.V] = 0.1**2
    P[eha.TH, eha.TH] = 1.0
    P[eha.W, eha.W] = 0.3**2
    P[eha.P1, eha.P1] = P[eha.P2, eha.P2] = 0.3**2


@njit(cache=True)
def _balance_forces(x: Array, P: Array, h: float, q: Array, c: Array, memory: Array) -> None:
    """Measure friction and load by the mean force over `FORCE_PERIOD`, where the piston slid one way.

    ``A₁p₁ − A₂p₂ − M dv/dt = φ curve(v) + B v + F + k x + c v|v|`` in the mean. The errors of a friction
    curve last for many samples, so they are averaged first and count once; step by step they
    would be taken for white noise and make friction look far better known than it is.
    """
    v = x[eha.V]
    if memory[M_FCOUNT] == 0.0:
        memory[M_FORCE] = memory[M_VMEAN] = memory[M_XMEAN] = memory[M_CURVE] = memory[M_SQUARE] = 0.0
        memory[M_VSTART] = v
        direction = 1.0 if v > 0.0 else -1.0
        if direction != memory[M_FSIGN]:
            memory[M_SLID] = 0.0
        memory[M_FSIGN] = direction
    if v * memory[M_FSIGN] < q[eha.Q_SLIDING]:
        memory[M_SLID] = -FORCE_PERIOD
    memory[M_FORCE] += (q[eha.Q_AREA1] * x[eha.P1] - q[eha.Q_AREA2] * x[eha.P2]) * h
    memory[M_VMEAN] += v * h
    memory[M_XMEAN] += x[eha.X] * h
    memory[M_SQUARE] += v * abs(v) * h
    memory[M_CURVE] += eha.friction_curve(v, q)[0] * h
    memory[M_FCOUNT] += h
    if memory[M_FCOUNT] < FORCE_PERIOD - 0.5 * h:
        return
    span = memory[M_FCOUNT]
    memory[M_FCOUNT] = 0.0
    memory[M_SLID] += span
    if memory[M_SLID] < FRICTION_SETTLES:
        return
    inertia = q[eha.Q_MASS] * (v - memory[M_VSTART]) / span * 1e3
    H = np.zeros((1, eha.STATES))
    H[0, eha.FRIC] = memory[M_CURVE] / span
    H[0, eha.VISC] = memory[M_VMEAN] / span
    H[0, eha.LOAD] = 1.0
    H[0, eha.STIF] = memory[M_XMEAN] / span
    H[0, eha.THROT] = memory[M_SQUARE] / span
    y = np.empty(1)
    y[0] = memory[M_FORCE] / span - inertia
    # Friction follows velocity with a lag of some tens of milliseconds (Armstrong-Hélouvry et al. 1994,
    # doi 10.1016/0005-1098(94)90209-7), so where the curve changed within the period it fits worse.
    start = eha.friction_curve(memory[M_VSTART], q)[0]
    lag = FRICTION_LAG / span * (eha.friction_curve(v, q)[0] - start)
    variance = np.empty(1)
    # A throttled partner answers through its own compressible oil: its force lags too.
    partner = PARTNER_MISFIT * x[eha.THROT] * memory[M_SQUARE] / span
    variance[0] = (c[N_FMEAN] ** 2 + lag * lag + partner * partner) * max(memory[M_FSCALE], 1.0) ** 2
    s = variance[0]
    for i in range(eha.FRIC, eha.STATES):
        y[0] -= H[0, i] * x[i]
        for j in range(eha.FRIC, eha.STATES):
            s += H[0, i] * P[i, j] * H[0, j]
    # (Squared below: what moves a restless load lasts for several periods, so they repeat each other.)
    # Loads differ: how fast the load moves, and what the force balance is worth, follow from its own
    # innovations over some seconds.
    ratio = y[0] * y[0] / s
    memory[M_FSCALE] = min(max(memory[M_FSCALE] * np.exp(0.02 * (min(ratio, 9.0) - 1.0)), 0.01), 1e4)
    if ratio > ROBUST * ROBUST:
        variance[0] += s * (ratio / ROBUST**2 - 1.0)
    mask = np.ones(1, dtype=np.bool_)
    kalman_update(x, P, y, H, variance, mask)


@njit(cache=True)
def _bound(x: Array) -> None:
    """Keep parameters where the model means something."""
    x[eha.LEAK] = min(max(x[eha.LEAK], 0.02), 300.0)
    x[eha.VALVE1] = min(max(x[eha.VALVE1], -0.9), 300.0)
    x[eha.VALVE2] = min(max(x[eha.VALVE2], -0.9), 300.0)
    x[eha.AIR] = min(max(x[eha.AIR], -2.0), 100.0)
    x[eha.GAIN] = min(max(x[eha.GAIN], -0.1), 0.1)
    x[eha.FRIC] = min(max(x[eha.FRIC], 0.02), 10.0)
    x[eha.VISC] = min(max(x[eha.VISC], -2e3), 5e4)
    x[eha.THROT] = min(max(x[eha.THROT], -2e4), 1e7)


@njit(cache=True)
def _track(
    block: Array, period: float, svsf: bool, has_pressures: bool, decimation: int, q: Array, c: Array,
    x: Array, P: Array, memory: Array, e_post: Array, gamma: float, layer: float, records: Array,
) -> int:  # fmt: skip
    """Run the filter over the rows of `block`; returns the number of records written."""
    h0 = period * 1e3
    F = np.empty((eha.STATES, eha.STATES))
    G = np.empty((eha.STATES, 4))
    scratch = np.empty((eha.P2 + 1, eha.STATES))
    x_new = np.empty(eha.STATES)
    noise = np.empty(4)
    diag = np.empty(eha.STATES)
    z = np.empty(MEASUREMENTS)
    y = np.empty(MEASUREMENTS)
    mask = np.empty(MEASUREMENTS, dtype=np.bool_)
    outside = np.empty(MEASUREMENTS, dtype=np.bool_)
    psi = np.empty(MEASUREMENTS)
    psi_k = np.empty(MEASUREMENTS)
    r0 = np.empty(MEASUREMENTS)
    r = np.empty(MEASUREMENTS)
    r0[Z_X] = (c[N_X] * 1e3) ** 2
    r0[Z_TH] = c[N_TH] ** 2
    r0[Z_P1] = r0[Z_P2] = (c[N_P] * 1e-6) ** 2
    r0[Z_DP] = (c[N_DP] * 1e-6) ** 2
    # The low side stays near the accumulator: 0.2 MPa, correlated over 10 s.
    r0[Z_MEAN] = 0.2**2 * 1e4 / h0
    H = np.zeros((MEASUREMENTS, eha.STATES))
    H[Z_X, eha.X] = H[Z_TH, eha.TH] = H[Z_P1, eha.P1] = H[Z_P2, eha.P2] = 1.0
    H[Z_DP, eha.P1], H[Z_DP, eha.P2] = 1.0, -1.0
    written = 0
    for row in range(block.shape[0]):
        time = block[row, TIME]
        # Stamps may come late, never early: the sample belongs to the last grid point before its stamp.
        steps = 0
        if memory[M_STARTED] > 0.0:
            memory[M_ORIGIN] += 2e-5 * period
            index = np.floor((time - memory[M_ORIGIN]) / period + 0.25)
            steps = int(max(index - memory[M_INDEX], 1.0))
            memory[M_INDEX] += steps
            early = memory[M_ORIGIN] + memory[M_INDEX] * period - time
            if early > 0.0:
                memory[M_ORIGIN] -= early
        else:
            memory[M_ORIGIN] = time
            memory[M_INDEX] = 0.0
        # The pump angle: as measured, else the sum of the speed samples (each the mean over its period).
        speed = block[row, SPEED]
        if not np.isnan(block[row, ANGLE]):
            z[Z_TH] = block[row, ANGLE]
        else:
            if np.isnan(speed):
                speed = memory[M_SPEED]
            if steps > 0:
                memory[M_ANGLE] += period * (speed + (steps - 1) * 0.5 * (speed + memory[M_SPEED]))
            memory[M_SPEED] = speed
            z[Z_TH] = memory[M_ANGLE]
        known_acc = not np.isnan(block[row, ACCUMULATOR])
        if known_acc:
            memory[M_ACC] = block[row, ACCUMULATOR] * 1e-6
        known_acc = memory[M_ACC] == memory[M_ACC]
        p_acc = memory[M_ACC] if known_acc else q[eha.Q_ACCUMULATOR]
        if not np.isnan(block[row, VISCOSITY]):
            memory[M_VISC] = block[row, VISCOSITY]
        viscosity = memory[M_VISC]
        z[Z_X] = block[row, POSITION] * 1e3
        z[Z_P1] = block[row, PRESSURE_1] * 1e-6
        z[Z_P2] = block[row, PRESSURE_2] * 1e-6
        z[Z_DP] = block[row, DIFFERENCE] * 1e-6
        z[Z_MEAN] = p_acc
        if has_pressures:  # their difference is not new, and the redundancy is a sensor check of its own
            z[Z_DP] = np.nan
            z[Z_MEAN] = np.nan

        if memory[M_STARTED] == 0.0:
            _start_motion(x, P, z, p_acc, c)
            memory[M_STARTED] = 1.0
        elif steps > LONGEST_GAP:
            _process_noise(x, steps * h0, p_acc, known_acc, memory[M_FSCALE], q, c, noise, diag)
            _start_motion(x, P, z, p_acc, c)
            for i in range(eha.STATES):
                P[i, i] += diag[i]
        else:
            span = steps * h0
            v_at = w_at = np.nan
            if not np.isnan(z[Z_X]):
                spread = (P[eha.V, eha.V] + (1e-3 / q[eha.Q_MASS] * c[N_FORCE]) ** 2 * 1e3 * h0) * span * span
                trust = spread / (spread + P[eha.X, eha.X] + r0[Z_X])
                v_at = x[eha.V] + trust * ((z[Z_X] - x[eha.X]) / span - x[eha.V])
            if not np.isnan(z[Z_TH]):
                w_at = (z[Z_TH] - x[eha.TH]) / span
            for _ in range(steps):
                _process_noise(x, h0, p_acc, known_acc, memory[M_FSCALE], q, c, noise, diag)
                eha.step(x, h0, viscosity, p_acc, v_at, w_at, q, x_new, F, G)
                x[:] = x_new
                # Friction and load learn from the mean force alone (see _balance_forces).
                for i in range(eha.P2 + 1):
                    for j in range(eha.FRIC, eha.STATES):
                        F[i, j] = 0.0
                eha.propagate(P, F, G, noise, diag, scratch)
        measurement(x, q, z, y)
        channels = 0
        if x[eha.P1] <= x[eha.P2]:
            H[Z_MEAN, eha.P1], H[Z_MEAN, eha.P2] = 1.0, 0.0
        else:
            H[Z_MEAN, eha.P1], H[Z_MEAN, eha.P2] = 0.0, 1.0
        for i in range(MEASUREMENTS):
            mask[i] = not np.isnan(y[i])
            r[i] = r0[i]
            if mask[i]:
                channels += 1 if i != Z_MEAN else 0
                variance = r[i]
                for a in range(eha.STATES):
                    if H[i, a] != 0.0:
                        for b in range(eha.STATES):
                            variance += H[i, a] * P[a, b] * H[i, b]
                sigmas = abs(y[i]) / np.sqrt(variance)
                if not svsf and sigmas > ROBUST:
                    r[i] += variance * ((sigmas / ROBUST) ** 2 - 1.0)
                psi[i] = layer * np.sqrt(variance)
        switched = False
        if svsf:
            nis, loglik, switched = svsf_update(x, P, y, H, r, mask, e_post, gamma, psi, True, psi_k, outside)
            for i in range(MEASUREMENTS):
                if mask[i]:
                    e_post[i] = y[i]
            measurement(x, q, z, y)
            for i in range(MEASUREMENTS):
                if mask[i]:
                    e_post[i] = y[i]
        else:
            nis, loglik = kalman_update(x, P, y, H, r, mask)
        _balance_forces(x, P, max(steps, 1) * h0, q, c, memory)
        _bound(x)
        memory[M_NIS] += nis
        memory[M_CHANNELS] += channels
        memory[M_LOGLIK] += loglik
        memory[M_OUT] += 1.0 if switched else 0.0
        memory[M_COUNT] += 1.0
        if memory[M_COUNT] >= decimation:
            rec = records[written]
            rec[R_TIME] = time
            for i in range(eha.STATES):
                rec[R_STATE + i] = x[i]
                rec[R_VARIANCE + i] = P[i, i]
            # Against a restless load the friction curve's misfit repeats itself: count it once.
            rec[R_VARIANCE + eha.FRIC] *= max(memory[M_FSCALE], 1.0) ** 2
            rec[R_VARIANCE + eha.VISC] *= max(memory[M_FSCALE], 1.0) ** 2
            rec[R_NIS] = memory[M_NIS] / memory[M_COUNT]
            rec[R_CHANNELS] = memory[M_CHANNELS] / memory[M_COUNT]
            rec[R_LOGLIK] = memory[M_LOGLIK] / memory[M_COUNT]
            rec[R_OUTSIDE] = memory[M_OUT] / memory[M_COUNT]
            rec[R_LAYER] = psi_k[Z_P1] if svsf else np.nan
            rec[R_BETA1] = 1e6 / eha.compliance(x[eha.P1], x[eha.AIR], q)[0]
            rec[R_BETA2] = 1e6 / eha.compliance(x[eha.P2], x[eha.AIR], q)[0]
            rec[R_VISCOSITY] = viscosity
            rec[R_UNREST] = memory[M_FSCALE]
            memory[M_NIS] = memory[M_CHANNELS] = memory[M_LOGLIK] = memory[M_OUT] = memory[M_COUNT] = 0.0
            written += 1
    return written


class EhaTracker:
    """Track leakage, bulk modulus and friction of an axis online.

    Parameters
    ----------
    model : parameter array of `estimators.eha_model.parameters`.
    noise : process and measurement noise; None takes the defaults.
    method : ``"ekf"``, or ``"svsf"``: the combined EKF-SVSF, which switches to the SVSF
        gain where the optimal boundary layer leaves its limit (Gadsden and Habibi 2013,
        doi 10.1115/1.4006628).
    period : s, nominal sample period.
    pressures : whether both chamber pressures are measured (else their difference).
    viscous_friction, air_fraction : N·s/m and volume fraction, healthy: where the filter starts.
    decimation : samples per record.
    gamma, layer : SVSF memory, and limit of the boundary layer in innovation sigmas: 1.5 times the
        99.9 % quantile of the optimal layer on healthy simulated duties and loads.

    Examples
    --------
    >>> tracker = EhaTracker(model, method="svsf")            # doctest: +SKIP
    >>> records = tracker.push(block)                         # doctest: +SKIP
    """

    def __init__(
        self,
        model: Array,
        noise: Noise | None = None,
        method: Method = "ekf",
        *,
        period: float = 1e-3,
        pressures: bool = True,
        viscous_friction: float = 0.0,
        air_fraction: float = 0.003,
        decimation: int = 10,
        gamma: float = 0.1,
        layer: float = 10.0,
    ) -> None:
        if method not in ("ekf", "svsf"):
            raise ValueError(f"method is 'ekf' or 'svsf', not {method!r}")
        self.model = np.ascontiguousarray(model, dtype=np.float64)
        self.noise = noise or Noise()
        self.method = method
        self.period = period
        self.pressures = pressures
        self.decimation = decimation
        self.gamma = gamma
        self.layer = layer
        self._c = self.noise.array()
        c = self._c
        self.x = np.zeros(eha.STATES)
        self.x[[eha.LEAK, eha.FRIC]] = 1.0
        self.x[eha.AIR] = air_fraction * 1e3
        self.x[eha.VISC] = viscous_friction
        spread = np.zeros(eha.STATES)
        spread[eha.LEAK] = c[I_LEAK]
        spread[[eha.VALVE1, eha.VALVE2]] = c[I_VALVE]
        spread[eha.AIR], spread[eha.GAIN] = c[I_AIR] * 1e3, c[I_GAIN]
        spread[eha.FRIC], spread[eha.VISC] = c[I_FRIC], c[I_VISC]
        spread[eha.LOAD], spread[eha.STIF], spread[eha.THROT] = c[I_LOAD], c[I_STIF] * 1e-3, c[I_THROT]
        self.P = np.diag(spread**2)
        self._memory = np.zeros(MEMORY)
        self._memory[M_ACC] = np.nan
        self._memory[M_VISC] = 1.0
        self._memory[M_FSCALE] = 1.0
        self._e_post = np.zeros(MEASUREMENTS)

    def __repr__(self) -> str:
        return f"EhaTracker(method={self.method!r}, period={self.period}, pressures={self.pressures})"

    def push(self, block: Array) -> Array:
        """Process the rows of a block.

        Parameters
        ----------
        block : (n, 9) time s, position m, pump angle rad, pump speed rad/s, pressures 1 and 2,
            pressure difference, accumulator pressure (Pa), viscosity over the reference's.

        Returns
        -------
        (k, RECORD) one record per `decimation` samples; columns `R_…` of this module.
        """
        records = np.empty((block.shape[0] // self.decimation + 1, RECORD))
        n = _track(
            np.ascontiguousarray(block, dtype=np.float64), self.period, self.method == "svsf", self.pressures,
            self.decimation, self.model, self._c, self.x, self.P, self._memory, self._e_post,
            self.gamma, self.layer, records,
        )  # fmt: skip
        return records[:n]

    def state(self) -> dict[str, Array]:
        """Everything that changes, as arrays (copies)."""
        return {
            "x": self.x.copy(),
            "P": self.P.copy(),
            "memory": self._memory.copy(),
            "e_post": self._e_post.copy(),
        }

    def restore(self, state: dict[str, Array]) -> None:
        """Take a state back that `state` gave."""
        for mine, name in ((self.x, "x"), (self.P, "P"), (self._memory, "memory"), (self._e_post, "e_post")):
            saved = np.asarray(state[name], dtype=np.float64)
            if saved.shape != mine.shape:
                raise ValueError(f"{name}: shape {saved.shape} where {mine.shape} is wanted")
            mine[...] = saved
