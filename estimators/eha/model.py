"""Reduced model of one electro-hydrostatic axis, for estimation.

Twenty states in units that keep them near one (mm, ms, MPa, N; volumes in mm³):

=====  ==========================================================  ==========
index  state                                                       unit
=====  ==========================================================  ==========
X      cylinder position                                           mm
V      velocity                                                    mm/ms
TH     pump angle                                                  rad
W      pump speed                                                  rad/ms
P1 P2  chamber pressures, gauge                                    MPa
LEAK   leakage across the ports over its healthy value             1
VALVE1 leakage of each chamber into the accumulator, over the
VALVE2 healthy leakage across the ports: a check valve's           1
AIR    free air, volume at atmosphere over volume of oil           ‰
SPLIT  by how much chamber 1 has more of it than the mean, and
       chamber 2 less; errors of the chambers' volumes too         ‰
GAIN   relative error of the pump's displacement                   1
FRIC   Coulomb and Stribeck friction over the healthy curve        1
VISC   viscous friction, mean of both directions                   N·ms/mm
SKEW   by how much it is more when extending, less when retracting N·ms/mm
LOAD   load force at position 0                                    N
STIF   load stiffness                                              N/mm
THROT  load quadratic in velocity, a throttled partner's           N/(mm/ms)²
INERT  mass of the load (it acts in the mean force balance only)   kg
ZERO   zero of the pressure difference against the chambers'       MPa
=====  ==========================================================  ==========

Which are free follows from the sensors: without both chamber pressures the two
bulk moduli are one (SPLIT stays 0), and without the difference beside them it has no ZERO. The friction scale
has no direction of its own: its asymmetry is a constant load force, LOAD.

The pump angle is a *measurement*. In one step ``C₁ Δp₁ = D Δθ − A₁ Δx − h·outflow`` holds to rounding
(velocity and speed are means over the step), and process noise on speed and velocity enters position, angle
and pressures together: the filter carries the volume balance ``D θ − A x = ∫ L p dt + C p + constant``
exactly, which is what makes leakage and bulk modulus observable at encoder accuracy.

Equations: thesis 3.14 to 3.18, 3.40 and 5.12; effective bulk modulus with air after
eqs 5.20 and 5.21, ``1/β(p) = 1/β_stiff + α c(p)``,
``c(p) = p_a^(1/n) / (n (p + p_a)^((n+1)/n))``. The plant simulator shares no code with this.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from estimators.compiled import njit, record_of
from estimators.linalg import Array

(
    X, V, TH, W, P1, P2, LEAK, VALVE1, VALVE2, AIR, SPLIT, GAIN, FRIC, VISC, SKEW, LOAD, STIF, THROT, INERT,
    ZERO,
) = range(20)  # fmt: skip
STATES = 20


class Parameters(Protocol):
    """A unit's numbers in the model's units, as :func:`parameters` packs them."""

    area_1: float  # mm²
    area_2: float
    volume_1: float  # mm³ at position 0
    volume_2: float
    moving_mass: float  # kg
    displacement: float  # mm³/rad
    cross_port_leakage: float  # mm³/(ms·MPa), healthy
    case_leakage: float
    stiff_compliance: float  # 1/MPa, of the oil without its free air
    polytropic_index: float
    coulomb_forward: float  # N, as `static_`
    static_forward: float
    stribeck_forward: float  # mm/ms
    exponent_forward: float
    coulomb_reverse: float
    static_reverse: float
    stribeck_reverse: float
    exponent_reverse: float
    sliding_velocity: float  # mm/ms
    accumulator_pressure: float  # MPa
    position_compliance: float  # 1


PARAMETERS = record_of(Parameters)

ATMOSPHERE = 0.101325  # MPa
STICTION_VELOCITY = 3e-3  # mm/ms: width of the sign change of friction
SLIDING_VELOCITY = 5e-3  # mm/ms below which the force balance carries no information
COMPLIANCE_FLOOR = 0.2  # of the stiff oil's: no amount of negative air may make the oil rigid


def parameters(
    *, area_1: float, area_2: float, volume_1: float, volume_2: float, moving_mass: float,
    displacement: float, cross_port_leakage: float, case_leakage: float, bulk_modulus: float,
    air_fraction: float, polytropic_index: float, reference_pressure: float,
    friction_forward: tuple[float, float, float, float], friction_reverse: tuple[float, float, float, float],
    accumulator_pressure: float, position_compliance: float = 1.0,
) -> Parameters:  # fmt: skip
    """Pack a unit's numbers, in SI, into the model's parameters.

    Parameters
    ----------
    area_1, area_2 : m². volume_1, volume_2 : m³ at position 0. moving_mass : kg.
    displacement : m³/rad. cross_port_leakage, case_leakage : m³/(s·Pa), healthy.
    bulk_modulus : Pa, effective, at `reference_pressure` (Pa gauge) with `air_fraction`.
    friction_forward, friction_reverse : Coulomb N, static N, Stribeck velocity m/s, exponent.
    accumulator_pressure : Pa, used where it is not measured.
    position_compliance : how much more compliance changes with position than the volumes do.
    """
    air_compliance = air_fraction * air_curve(reference_pressure * 1e-6, polytropic_index)
    stiff = 1.0 / (bulk_modulus * 1e-6) - air_compliance
    # Where the profile's air alone would explain more than the measured compliance, the oil keeps a third.
    stiff = max(stiff, 1.0 / (3.0 * bulk_modulus * 1e-6))
    q: Parameters = np.zeros(1, PARAMETERS)[0]
    q.area_1, q.area_2 = area_1 * 1e6, area_2 * 1e6
    q.volume_1, q.volume_2 = volume_1 * 1e9, volume_2 * 1e9
    q.moving_mass, q.displacement = moving_mass, displacement * 1e9
    q.cross_port_leakage, q.case_leakage = cross_port_leakage * 1e12, case_leakage * 1e12
    q.stiff_compliance, q.polytropic_index = stiff, polytropic_index
    q.coulomb_forward, q.static_forward, q.stribeck_forward, q.exponent_forward = friction_forward
    q.coulomb_reverse, q.static_reverse, q.stribeck_reverse, q.exponent_reverse = friction_reverse
    q.sliding_velocity, q.accumulator_pressure = SLIDING_VELOCITY, accumulator_pressure * 1e-6
    q.position_compliance = position_compliance
    return q


@njit(error_model="numpy")
def air_curve(p: float, n: float) -> float:
    """c(p), 1/MPa: compliance per free-air fraction at gauge pressure `p` (MPa)."""
    absolute = max(p + ATMOSPHERE, 0.1 * ATMOSPHERE)
    # The module's equation with one power: powers are most of what a step costs.
    return (ATMOSPHERE / absolute) ** (1.0 + 1.0 / n) / (n * ATMOSPHERE)


@njit(error_model="numpy", _nrt=False)
def compliance(p: float, air: float, q: Parameters) -> tuple[float, float, float]:
    """1/β at gauge pressure `p` (MPa), and its derivatives to `p` and to `air` (‰)."""
    n = q.polytropic_index
    c = air_curve(p, n)
    value = q.stiff_compliance + 1e-3 * air * c
    floor = COMPLIANCE_FLOOR * q.stiff_compliance
    if value < floor:
        return floor, 0.0, 0.0
    slope = -c * (n + 1.0) / n / (p + ATMOSPHERE) if p > -0.9 * ATMOSPHERE else 0.0
    return value, 1e-3 * air * slope, 1e-3 * c


@njit(error_model="numpy", _nrt=False)
def friction_curve(v: float, q: Parameters) -> tuple[float, float, float, float]:
    """Healthy Coulomb and Stribeck friction (N) at `v` (mm/ms), its slope, the part of the slope that the
    change of sign makes, and that part's own slope."""
    if v >= 0.0:
        coulomb, static = q.coulomb_forward, q.static_forward
        stribeck, exponent = q.stribeck_forward, q.exponent_forward
    else:
        coulomb, static = q.coulomb_reverse, q.static_reverse
        stribeck, exponent = q.stribeck_reverse, q.exponent_reverse
    speed = abs(v) + 1e-5
    ratio = (speed / stribeck) ** exponent
    excess = (static - coulomb) * math.exp(-ratio)
    level = coulomb + excess
    sign = math.tanh(v / STICTION_VELOCITY)
    stick = level * (1.0 - sign * sign) / STICTION_VELOCITY
    stribeck_slope = -excess * ratio * exponent / speed
    direction = 1.0 if v >= 0.0 else -1.0
    stick_slope = (direction * stribeck_slope * (1.0 - sign * sign) - 2.0 * sign * stick) / STICTION_VELOCITY
    return sign * level, stick + abs(sign) * stribeck_slope, stick, stick_slope


@njit(error_model="numpy", _nrt=False)
def step(
    x: Array, h: float, viscosity: float, p_acc: float, v_at: float, w_at: float, q: Parameters,
    out: Array, F: Array, G: Array,
) -> None:  # fmt: skip
    """One step of the model with its Jacobian.

    Velocity and speed are driven by large unknown forces, so their predictions are poor while the encoders
    know them well afterwards. Flow multiplies air and pump gain: the Jacobian is therefore taken where the
    measurement will put velocity and speed (as an iterated EKF does, Bell and Cathey 1993, doi
    10.1109/9.250476), or these parameters would learn from prediction errors.

    From the state `x` (20,), over `h` ms, at the accumulator pressure `p_acc` (MPa) and the oil's `viscosity`
    over the reference's; linearised at velocity `v_at` and speed `w_at` over the step, NaN for the
    prediction's. Fills `out` (20,), the state after the step, `F` (20, 20), ∂out/∂x, and `G` (20, 4), what
    unit noise on velocity (mm/ms), pump speed (rad/ms) and each chamber's volume (mm³) does to the state.
    """
    F[:, :] = 0.0
    G[:, :] = 0.0
    for i in range(P2 + 1, STATES):
        out[i] = x[i]
        F[i, i] = 1.0
    advance(x, h, viscosity, p_acc, v_at, w_at, q, friction_curve(x[V], q), STATES, out, F, G)


@njit(error_model="numpy", _nrt=False)
def advance(
    x: Array, h: float, viscosity: float, p_acc: float, v_at: float, w_at: float, q: Parameters,
    friction: tuple[float, float, float, float], columns: int, out: Array, F: Array, G: Array,
) -> None:  # fmt: skip
    """The part of :func:`step` that moves, up to P2; the loop over samples calls it with what it knows.

    With `friction_curve` at the velocity of `x`. Only rows up to P2 are written, of F in the first `columns`
    alone, and of G only what is ever more than zero.
    """
    area1, area2, mu = q.area_1, q.area_2, 1e-3 / q.moving_mass
    v, p1, p2 = x[V], x[P1], x[P2]
    pump = q.displacement * (1.0 + x[GAIN])
    # Until the end the rows of F hold derivatives of the parts that these rows are made of.
    dv, da1, da2 = F[V], F[P1], F[P2]
    dv[:] = da1[:] = da2[:] = 0.0

    # Chamber stiffness i = β/V and its logarithmic derivatives (to position, pressure, air).
    b1, b1_p, b1_air = compliance(p1, x[AIR] + x[SPLIT], q)
    b2, b2_p, b2_air = compliance(p2, x[AIR] - x[SPLIT], q)
    swept1, swept2 = q.position_compliance * area1, q.position_compliance * area2
    volume1 = max(q.volume_1 + swept1 * x[X], 0.05 * q.volume_1)
    volume2 = max(q.volume_2 - swept2 * x[X], 0.05 * q.volume_2)
    i1, i2 = 1.0 / (volume1 * b1), 1.0 / (volume2 * b2)
    d1_x, d1_p, d1_air = -i1 * swept1 / volume1, -i1 * b1_p / b1, -i1 * b1_air / b1  # ∂i1
    d2_x, d2_p, d2_air = i2 * swept2 / volume2, -i2 * b2_p / b2, -i2 * b2_air / b2

    # Leakage out of each chamber: across, to the case, and through its check valve. Thinner oil leaks more.
    drop, over1, over2 = p1 - p2, p1 - p_acc, p2 - p_acc
    rate = x[LEAK] / viscosity
    total = (q.cross_port_leakage + 0.5 * q.case_leakage) / viscosity
    base1 = q.cross_port_leakage * drop + q.case_leakage * over1
    base2 = -q.cross_port_leakage * drop + q.case_leakage * over2
    valve1, valve2 = total * x[VALVE1], total * x[VALVE2]
    # The pump moves its displacement at the ports' mean density, so the denser chamber gets less volume
    # than the other loses. What that is at 100 rad/s and 2 MPa is 3 % of a healthy unit's leakage. The
    # volume of a share of air over its volume at atmosphere is n (p + p_a) c(p).
    n = q.polytropic_index
    shrunk1 = n * max(p1 + ATMOSPHERE, 0.1 * ATMOSPHERE) * b1_air
    shrunk2 = n * max(p2 + ATMOSPHERE, 0.1 * ATMOSPHERE) * b2_air
    thinned = shrunk2 - shrunk1
    denser = 0.5 * (q.stiff_compliance * drop + x[AIR] * thinned)
    into, out_of = pump * (1.0 - denser), pump * (1.0 + denser)
    turning = x[W] if math.isnan(w_at) else w_at
    a1 = into * x[W] - rate * base1 - valve1 * over1  # net inflow of chamber 1 but for the piston's
    a2 = out_of * x[W] + rate * base2 + valve2 * over2
    da1[W], da2[W] = into, out_of
    da1[GAIN] = q.displacement * (1.0 - denser) * turning
    da2[GAIN] = q.displacement * (1.0 + denser) * turning
    da1[AIR] = -0.5 * thinned * pump * turning
    da2[AIR] = -da1[AIR]
    da1[LEAK], da2[LEAK] = -base1 / viscosity, base2 / viscosity
    da1[VALVE1], da2[VALVE2] = -total * over1, total * over2
    da1[P1], da1[P2] = -rate * (q.cross_port_leakage + q.case_leakage) - valve1, rate * q.cross_port_leakage
    da2[P1], da2[P2] = -rate * q.cross_port_leakage, rate * (q.cross_port_leakage + q.case_leakage) + valve2
    mean1, mean2 = q.stiff_compliance + x[AIR] * b1_air, q.stiff_compliance + x[AIR] * b2_air
    half1, half2 = 0.5 * mean1 * pump * turning, 0.5 * mean2 * pump * turning
    da1[P1], da1[P2] = da1[P1] - half1, da1[P2] + half2
    da2[P1], da2[P2] = da2[P1] + half1, da2[P2] - half2

    # Velocity: symplectic Euler for the hydraulic spring (stable far beyond its resonance at 1 ms),
    # implicit in viscous and stick friction: v⁺ = N/den.
    curve, slope, stick, stick_v = friction
    implicit = x[FRIC] * stick
    force = area1 * p1 - area2 * p2 - x[FRIC] * curve - x[LOAD] - x[STIF] * x[X]
    throttle = x[THROT] * abs(v)
    direction = 1.0 if v >= 0.0 else -1.0
    viscous = x[VISC] + direction * x[SKEW]
    den = max(1.0 + mu * h * (viscous + throttle + implicit), 0.5)
    v_new = (v * (1.0 + mu * h * implicit) + mu * h * force) / den
    dv[X] = -mu * h * x[STIF]
    dv[V] = 1.0 + mu * h * (implicit - x[FRIC] * slope + x[FRIC] * stick_v * (v - v_new))
    dv[P1], dv[P2] = mu * h * area1, -mu * h * area2
    dv[FRIC] = mu * h * (stick * (v - v_new) - curve)
    dv[V] -= mu * h * x[THROT] * v_new * direction
    dv[VISC] = -mu * h * v_new
    dv[SKEW] = direction * dv[VISC]
    dv[THROT] = -mu * h * abs(v) * v_new
    dv[LOAD], dv[STIF] = -mu * h, -mu * h * x[X]

    out[X], out[V] = x[X] + h * v_new, v_new
    out[TH], out[W] = x[TH] + h * x[W], x[W]
    inflow1, inflow2 = a1 - area1 * v_new, area2 * v_new - a2
    out[P1], out[P2] = p1 + h * i1 * inflow1, p2 + h * i2 * inflow2
    extra_w = turning - x[W]
    extra_v = 0.0 if math.isnan(v_at) else v_at - v_new
    at1 = inflow1 + into * extra_w - area1 * extra_v
    at2 = inflow2 - out_of * extra_w + area2 * extra_v
    share1, share2, per_den = h * i1, h * i2, 1.0 / den
    for j in range(columns):
        dvj = dv[j] * per_den
        F[V, j] = dvj
        F[X, j] = h * dvj
        F[P1, j] = share1 * (da1[j] - area1 * dvj)
        F[P2, j] = share2 * (area2 * dvj - da2[j])
    F[X, X] += 1.0
    F[P1, P1] += 1.0
    F[P2, P2] += 1.0
    F[TH, TH] = F[W, W] = 1.0
    F[P1, X] += h * d1_x * at1
    F[P1, P1] += h * d1_p * at1
    F[P1, AIR] += h * d1_air * at1
    F[P1, SPLIT] += h * d1_air * at1
    F[P2, X] += h * d2_x * at2
    F[P2, P2] += h * d2_p * at2
    F[P2, AIR] += h * d2_air * at2
    F[P2, SPLIT] -= h * d2_air * at2
    F[TH, W] = h

    G[X, 0], G[V, 0] = h, 1.0
    G[P1, 0], G[P2, 0] = -h * area1 * i1, h * area2 * i2
    G[TH, 1], G[W, 1] = h, 1.0
    G[P1, 1], G[P2, 1] = h * into * i1, -h * out_of * i2
    G[P1, 2] = i1
    G[P2, 3] = i2
