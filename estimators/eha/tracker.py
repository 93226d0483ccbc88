"""EKF and SVSF on the reduced EHA model, as one compiled loop over blocks of samples.

A tracker holds its whole state in a few arrays, so results do not depend on how a log
was cut into blocks, and `state` / `restore` carry it across a restart.
"""

from __future__ import annotations

from copy import copy
from typing import Literal

import numpy as np

from estimators.compiled import njit
from estimators.eha import layout, update, walk
from estimators.eha import model as eha
from estimators.eha.layout import FLOW_PARAMETERS, MEMORY, RECORD, Memory, Noise, Records
from estimators.linalg import Array

Method = Literal["ekf", "svsf"]
# Rows of the measurement vector.
Z_X, Z_TH, Z_P1, Z_P2, Z_DP, Z_MEAN = range(6)
MEASUREMENTS = 6
MISFIT_PERIOD = 5e3  # ms over which innovations are compared with their variances
COMPRESSED = 100.0  # ms: a change of pressure by a start, stop or reversal
LONGEST_GAP = 50  # periods that are bridged step by step; a longer gap restarts the motion states


class EhaTracker:
    """Track leakage, bulk modulus and friction of an axis online.

    Parameters
    ----------
    model : of `estimators.eha.model.parameters`.
    noise : process and measurement noise; None takes the defaults.
    method : ``"ekf"``, or ``"svsf"``: the combined EKF-SVSF, which switches to the SVSF
        gain where the optimal boundary layer leaves its limit (Gadsden and Habibi 2013,
        doi 10.1115/1.4006628).
    period : s, nominal sample period.
    pressures : whether both chamber pressures are measured (else their difference).
    angle : whether the pump angle is measured (else the speed is summed up).
    difference : whether the pressure difference has a sensor of its own.
    viscous_friction, viscous_skew : N·s/m, healthy: mean of both directions, and what extending has more.
    air_fraction : volume fraction, healthy; with the former two where the filter starts.
    decimation : samples per record.
    gamma, layer : SVSF memory, and limit of the boundary layer in innovation sigmas: 1.5 times the
        99.9 % quantile of the optimal layer on healthy simulated duties and loads.
    """

    def __init__(
        self, model: eha.Parameters, noise: Noise | None = None, method: Method = "ekf", *,
        period: float = 1e-3, pressures: bool = True, angle: bool = True, difference: bool = True,
        viscous_friction: float = 0.0, viscous_skew: float = 0.0, air_fraction: float = 0.003,
        decimation: int = 10, gamma: float = 0.1, layer: float = 10.0,
    ) -> None:  # fmt: skip
        if method not in ("ekf", "svsf"):
            raise ValueError(f"method is 'ekf' or 'svsf', not {method!r}")
        self.model = copy(model)
        self.noise, self.method, self.decimation = noise or Noise(), method, decimation
        self.period, self.pressures, self.angle = period, pressures, angle
        self.gamma, self.layer = gamma, layer
        c = self._c = self.noise.numbers()
        self.x = np.zeros(eha.STATES)
        self.x[[eha.LEAK, eha.FRIC]] = 1.0
        self.x[eha.AIR] = air_fraction * 1e3
        self.x[eha.VISC], self.x[eha.SKEW] = viscous_friction, viscous_skew
        c.initial_air_split *= pressures
        c.initial_zero *= pressures and difference
        spread = np.zeros(eha.STATES)
        for state, name, unit in walk.WALKING:
            spread[state] = getattr(c, f"initial_{name}") * unit
        spread[[eha.VALVE1, eha.VALVE2]] = c.initial_valve
        spread[eha.LOAD] = c.initial_load
        self._rates = walk.walk_rates(c)
        self.P = np.diag(spread**2)
        self._memory = np.zeros(1, MEMORY)
        self._memory["accumulator_pressure"] = np.nan
        self._memory["viscosity"] = self._memory["unrest"] = 1.0
        self._e_post = np.zeros(MEASUREMENTS)

    def push(self, block: Array) -> Records:
        """Process the rows of a block (n, 9); (k,) one `layout.RECORD` per `decimation` samples.

        Columns: time s, position m, pump angle rad, pump speed rad/s, pressures 1 and 2, pressure difference,
        accumulator pressure (Pa), viscosity over the reference's.
        """
        records = np.empty(block.shape[0] // self.decimation + 1, RECORD)
        n = track(
            np.ascontiguousarray(block, dtype=np.float64), self.period, self.method == "svsf", self.pressures,
            self.angle, self.decimation, self.model, self._c, self._rates, self.x, self.P, self._memory[0],
            self._e_post, self.gamma, self.layer, records,
        )  # fmt: skip
        return records[:n]

    def state(self) -> dict[str, Array]:
        """Everything that changes, as arrays (copies)."""
        return {name: mine.copy() for name, mine in self._changing().items()}

    def _changing(self) -> dict[str, Array]:
        return {"x": self.x, "P": self.P, "memory": self._memory.view(np.float64), "e_post": self._e_post}

    def restore(self, state: dict[str, Array]) -> None:
        """Take a state back that `state` gave."""
        for name, mine in self._changing().items():
            mine[...] = state[name]


@njit()
def measurement(x: Array, z: Array, y: Array) -> None:
    """Innovation ``y = z − h(x)`` of all channels, model units."""
    y[Z_X], y[Z_TH] = z[Z_X] - x[eha.X], z[Z_TH] - x[eha.TH]
    y[Z_P1], y[Z_P2] = z[Z_P1] - x[eha.P1], z[Z_P2] - x[eha.P2]
    y[Z_DP] = z[Z_DP] - (x[eha.P1] - x[eha.P2])
    y[Z_MEAN] = z[Z_MEAN] - min(x[eha.P1], x[eha.P2])


@njit(error_model="numpy", _nrt=False)
def motion_noise(
    x: Array, h: float, p_acc: float, known_acc: bool, v: float, w: float, q: eha.Parameters, c: Noise,
    out: Array,
) -> None:  # fmt: skip
    """Variances of velocity, speed and both chamber volumes over `h` ms, at the mean velocity and speed."""
    mu = 1e-3 / q.moving_mass
    out[0] = (mu * c.force) ** 2 * 1e3 * h
    out[1] = (c.acceleration * 1e-3) ** 2 * 1e-3 * h
    margin = c.refeed_margin * 1e-6
    fed1 = x[eha.P1] < p_acc + margin if known_acc else x[eha.P1] <= x[eha.P2]
    fed2 = x[eha.P2] < p_acc + margin if known_acc else x[eha.P2] < x[eha.P1]
    relieved = abs(x[eha.P1] - x[eha.P2]) > c.relief_pressure * 1e-6
    small, large = (c.flow * 1e9) ** 2 * 1e-3 * h, (c.flow_refeeding * 1e9) ** 2 * 1e-3 * h
    compressing = c.compression * c.compression * COMPRESSED * h
    swept = q.displacement * w
    out[2] = (large if relieved or fed1 else small) + compressing * (swept - q.area_1 * v) ** 2
    out[3] = (large if relieved or fed2 else small) + compressing * (swept - q.area_2 * v) ** 2


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


@njit(nogil=True)
def track(
    block: Array, period: float, svsf: bool, has_pressures: bool, has_angle: bool,
    decimation: int, q: eha.Parameters, c: Noise, rates: Array, x: Array, P: Array, memory: Memory,
    e_post: Array, gamma: float, layer: float, records: Records,
) -> int:  # fmt: skip
    """Run the filter over the rows of `block`; returns the number of records written.

    A velocity from two samples of a noisy position goes into the flow's derivative to air and pump gain, and
    into the pressure's innovation: their product has a mean, and air drifts by it (errors in variables). The
    mean velocity over `Noise.smoothing` hardly shares the present sample's noise, as an instrumental variable
    does not (Söderström and Stoica 1983, isbn 978-0-387-12814-6). Where innovations are larger than their
    variances say, the variances of the flow parameters are given larger by as much.
    """
    h0 = period * 1e3
    smoothing = max(1e3 * c.smoothing, h0)
    F, G = np.zeros((eha.STATES, eha.STATES)), np.zeros((eha.STATES, 4))
    scratch, work = np.empty((update.MOVING, eha.STATES)), np.empty((2, eha.STATES))
    layer_work, noise = np.empty((2 * MEASUREMENTS, MEASUREMENTS)), np.empty(4)
    x_new, walks, before = np.empty(eha.STATES), np.empty(eha.STATES), np.empty((2, FLOW_PARAMETERS))
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
                memory.started, memory.velocity_mean = 1.0, 0.0
            elif steps > LONGEST_GAP:
                _start_motion(x, P, z, p_acc, c)
                memory.velocity_mean = 0.0
                walk.walk_parameters(x, P, steps * h0, memory.unrest, c, rates, walks)
                for i in range(eha.STATES):
                    P[i, i] += walks[i]
            else:
                span = steps * h0
                spread = (P[eha.V, eha.V] + (1e-3 / q.moving_mass * c.force) ** 2 * 1e3 * h0) * span * span
                trust = spread / (spread + P[eha.X, eha.X] + r0[Z_X])
                v_at = x[eha.V] + trust * ((z[Z_X] - x[eha.X]) / span - x[eha.V])
                memory.velocity_mean += min(span / smoothing, 1.0) * (v_at - memory.velocity_mean)
                v_at = memory.velocity_mean
                w_at = (z[Z_TH] - x[eha.TH]) / span
                for k in range(steps):
                    if k > 0:
                        friction = eha.friction_curve(x[eha.V], q)
                    motion_noise(x, h0, p_acc, known_acc, v_at, w_at, q, c, noise)
                    walk.walk_parameters(x, P, h0, memory.unrest, c, rates, walks)
                    eha.advance(x, h0, viscosity, p_acc, v_at, w_at, q, friction, update.COUPLED, x_new, F, G)
                    for i in range(update.MOVING):
                        x[i] = x_new[i]
                    update.propagate(P, F, G, noise, walks, scratch)
        measurement(x, z, y)
        used = 0
        plus[Z_MEAN] = eha.P1 if x[eha.P1] <= x[eha.P2] else eha.P2
        for i in range(MEASUREMENTS):
            mask[i] = not blind and not np.isnan(y[i])
            used += mask[i]
            r[i] = r0[i]
            if mask[i] and not svsf:
                variance = r[i] + update.channel_variance(P, plus[i], minus[i])
                excess = y[i] * y[i] / update.ROBUST**2 - variance
                if excess > 0.0:
                    r[i] += excess
        for i in range(FLOW_PARAMETERS):
            before[0, i] = x[eha.LEAK + i]
            before[1, i] = P[eha.LEAK + i, eha.LEAK + i]
        covariance = P[eha.AIR, eha.SPLIT]
        switched = False
        motion, variances = work[0, : update.MOVING], work[1, : update.MOVING]
        if svsf:
            # That the low side stays near the accumulator is no measurement: so vague a channel has an
            # optimal layer far wider than its innovations, and would be outside its limit all the time.
            believed, mask[Z_MEAN] = mask[Z_MEAN], False
            if update.layers_exceeded(P, y, plus, minus, r, mask, e_post, gamma, layer, psi_k, layer_work):
                switched, motion, variances = update.svsf_motion(
                    x, P, y, plus, minus, r, mask, e_post, gamma, layer, psi_k
                )
            mask[Z_MEAN] = believed
        nis = update.update(x, P, y, plus, minus, r, mask, work)
        if switched:
            update.take_motion(x, P, motion, variances)
        if svsf:
            measurement(x, z, y)
            for i in range(MEASUREMENTS):
                if mask[i]:
                    e_post[i] = y[i]
        if walk.pressures_rest(x, max(steps, 1) * h0, c, memory):
            walk.keep_compliance(x, P, before, covariance)
        if not blind:
            friction = eha.friction_curve(x[eha.V], q)
            walk.watch_jumps(x, P, before, max(steps, 1) * h0, c, memory)
            update.compare_sensors(x, P, gap, r0[Z_DP] + 2.0 * r0[Z_P1], memory)
            walk.balance_forces(x, P, max(steps, 1) * h0, friction[0], q, c, memory)
        walk.keep_in_bounds(x, P)
        if used > 0:
            memory.misfit += min(max(steps, 1) * h0 / MISFIT_PERIOD, 1.0) * (nis / used - memory.misfit)
        memory.nis += nis
        memory.outside += 1.0 if switched else 0.0
        memory.count += 1.0
        if memory.count >= decimation:
            rec = records[written]
            rec.time = time
            for i in range(eha.STATES):
                rec.state[i] = x[i]
                rec.variance[i] = P[i, i]
            for i in range(eha.LEAK, eha.FRIC):
                rec.variance[i] *= max(memory.misfit, 1.0)
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
