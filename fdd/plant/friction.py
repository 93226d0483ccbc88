"""Friction of the cylinder: LuGre with a curve for each direction (eqs 5.8 to 5.12, Table 5.2), compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant.compiled import njit
from fdd.plant.conditions import (
    COULOMB_FORWARD,
    COULOMB_REVERSE,
    FRICTION_FORWARD,
    FRICTION_REVERSE,
    MIDDLE,
    STRIBECK_FORWARD,
    STRIBECK_REVERSE,
    STRIBECK_SPEED,
    VISCOUS,
)
from fdd.plant.parameters import DAHL, ELASTOPLASTIC, SMOOTH, Constants
from fdd.plant.state import MEMORY, P1, P2, Z

Array = NDArray[np.float64]

_WORN_LENGTH = 0.25
"""Of the half stroke: how far from mid-stroke a seal's running-in track is felt (1/e of its change)."""
_STILL = 1e-4
"""m/s below which |v| is rounded off: a hundredth of the slowest steady motion in the thesis. The corner
would cost the integrator its order at each reversal."""


@njit(error_model="numpy", inline="always")
def friction_rates(y: Array, x: float, v: float, now: Array, par: Constants, dy: Array) -> float:
    """Friction force (N, against extension); fills the rates of bristle and memory.

    Two things beyond eqs 5.8 to 5.12, which leave open what happens before the seal slides. The bristle
    holds without sliding until the break-away share of its steady deflection, after Dupont, Hayward,
    Armstrong and Altpeter (doi:10.1109/TAC.2002.1000274); share 0 is LuGre's own eq. 5.9. And the
    lubricant's film, and with it the falling curve, follows the sliding with a lag, while the seal resists
    what is quicker. Without the first the seal would break away ever more easily the faster it is started
    (in the thesis it does not, figure 5.8), without the second the falling curve would drive the hydraulic
    resonance to its limit at any speed.

    Thick oil raises the film's part of the level and thins the falling curve: both go with viscosity times
    speed, see `fdd.plant.integrator.thin`.

    Other seals, other laws (`fdd.plant.details.Details.friction_law`): plain LuGre, Dahl's bristle, a smooth
    Stribeck curve; and pressure that presses the lips on.
    """
    z, memory = y[Z], y[MEMORY]
    law = par.friction_law
    seen = memory if law == ELASTOPLASTIC else v
    film = math.sqrt(seen * seen + _STILL * _STILL) - _STILL
    size = v * v / math.sqrt(v * v + _STILL * _STILL)
    if v >= 0.0:
        coulomb, static = par.coulomb_forward, par.static_forward
        stribeck, exponent, viscous = par.stribeck_forward, par.exponent_forward, par.viscous_forward
        scale, level, beyond = now[FRICTION_FORWARD], now[COULOMB_FORWARD], now[STRIBECK_FORWARD]
    else:
        coulomb, static = par.coulomb_reverse, par.static_reverse
        stribeck, exponent, viscous = par.stribeck_reverse, par.exponent_reverse, par.viscous_reverse
        scale, level, beyond = now[FRICTION_REVERSE], now[COULOMB_REVERSE], now[STRIBECK_REVERSE]
    if now[MIDDLE] != 0.0:
        away = x / (_WORN_LENGTH * par.half_stroke)
        scale *= 1.0 + now[MIDDLE] * math.exp(-away * away)
    level *= coulomb
    if par.seal_area != 0.0:
        level += 0.5 * par.seal_area * (max(y[P1], 0.0) + max(y[P2], 0.0))
    falling = 0.0
    if law != DAHL:
        falling = beyond * math.exp(-((film / (stribeck * now[STRIBECK_SPEED])) ** exponent))
    steady = scale * (level + (static - coulomb) * falling)
    if law == SMOOTH:
        dy[Z] = 0.0
        dy[MEMORY] = 0.0
        return steady * math.tanh(v / par.smooth_width) + now[VISCOUS] * viscous * v
    share = par.bristle_stiffness * z / max(steady, 1e-3)
    slip = size * share
    if par.breakaway > 0.0 and law == ELASTOPLASTIC:
        past = (abs(share) - par.breakaway) / (1.0 - par.breakaway)
        if past <= 0.0 or share * v < 0.0:
            slip = 0.0
        elif past < 1.0:
            slip *= past * past * (3.0 - 2.0 * past)
    dz = v - slip
    dy[Z] = dz
    dy[MEMORY] = (slip - memory) * par.friction_rate
    fade = par.bristle_fade * par.bristle_fade
    resisting = par.seal_damping * (v - memory)
    if law != ELASTOPLASTIC:
        dy[MEMORY] = 0.0
        resisting = 0.0
    return (
        par.bristle_stiffness * z
        + par.bristle_damping * fade / (fade + v * v) * dz
        + resisting
        + now[VISCOUS] * viscous * v
    )
