"""The oil: viscosity over temperature, compressibility over pressure with free air and vapour in it.

Pressures are gauge unless a name says absolute. Compiled functions take numbers, the others scalars or
arrays of one shape.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fdd.errors import InputError
from fdd.plant import Array, Constants
from fdd.plant.compiled import njit
from fdd.unit import Oil

ATMOSPHERE = 101_325.0
"""Pressure (Pa, absolute) at which the fraction of free air is counted."""

AIR_WARMING = 1.0 / 313.15
"""1/K, growth of free air's volume with the oil's temperature: that of an ideal gas at 40 °C."""
SOFTENING = 2.8e-12
"""1/(Pa·K), growth of the oil's own compliance: 0.45 % a kelvin of 1/1.6 GPa, a mineral oil at 40 °C (Hodges,
Hydraulic Fluids, 1996, chapter 3: 1.6 GPa at 40 °C, 1.2 to 1.3 GPa at 100 °C)."""
BUNSEN = 0.09
"""Volume of air that mineral oil holds in solution at the pressure that it is saturated at (Hodges, 1996)."""
VAPOUR_PRESSURE = 300.0
"""Pa, absolute, at 40 °C; assumption: light ends and a trace of water, 10 to 1000 Pa in data sheets."""
VAPOUR_SLOPE = 0.015
"""1/K: the vapour pressure goes with (1 + 0.015·ΔT)³, some 4 % a kelvin."""
VAPOUR_SHARE = 0.01
"""Share of the volume that is vapour where the pressure is the vapour's; it grows with its inverse square."""
VAPOUR_FELT = 0.01
"""Vapour pressure over the oil's below which there is no vapour at all."""

WALTHER_SHIFT = 0.7
"""cSt, of ASTM D341."""
KELVIN = 273.15
_LEAST_ABSOLUTE = 1.0  # Pa; guards the power law within a step, gas and vapour keep the state above


def walther_line(oil: Oil) -> tuple[float, float, float]:
    """Intercept and slope of Walther's law through the oil's two data-sheet points, and the viscosity (cSt)
    at its reference temperature.

    ``log10 log10(ν + 0.7) = intercept + slope·log10 T``, ν in cSt and T in kelvin (ASTM D341).
    """
    cold = math.log10(math.log10(oil.viscosity_40 * 1e6 + WALTHER_SHIFT))
    hot = math.log10(math.log10(oil.viscosity_100 * 1e6 + WALTHER_SHIFT))
    low = math.log10(40.0 + KELVIN)
    slope = (hot - cold) / (math.log10(100.0 + KELVIN) - low)
    intercept = cold - slope * low
    inner = intercept + slope * math.log10(oil.reference_temperature + KELVIN)
    return intercept, slope, 10.0 ** (10.0**inner) - WALTHER_SHIFT


@njit(error_model="numpy", inline="always")
def walther(temperature: float, intercept: float, slope: float) -> float:
    """Kinematic viscosity (cSt) at a temperature (°C), ASTM D341: log10 log10(ν + 0.7) = a + b·log10 T."""
    inner = intercept + slope * math.log10(temperature + KELVIN)
    return math.pow(10.0, math.pow(10.0, inner)) - WALTHER_SHIFT


def viscosity(oil: Oil, temperature: ArrayLike) -> Array:
    """Kinematic viscosity (…), m²/s, by `walther_line` at a temperature (…), °C."""
    intercept, slope, _ = walther_line(oil)
    kelvin = np.asarray(temperature, dtype=np.float64) + KELVIN
    loglog = intercept + slope * np.log10(kelvin)
    return np.asarray((10.0 ** (10.0**loglog) - WALTHER_SHIFT) * 1e-6)


def viscosity_ratio(oil: Oil, temperature: ArrayLike) -> Array:
    """Viscosity over that at the oil's reference temperature, (…)."""
    return viscosity(oil, temperature) / viscosity(oil, oil.reference_temperature)


def air_compliance(pressure: ArrayLike, polytropic_index: float, ambient: float = ATMOSPHERE) -> Array:
    """Compliance that a unit fraction of free air adds (…), 1/Pa: c(p) of ``1/β = 1/β_stiff + α·c(p)``.

    ``c(p) = p_atm^(1/n) / (n·p_abs^((n+1)/n))``: the derivative of a polytropic gas's volume, counted at
    atmospheric pressure (thesis eqs 5.20 and 5.21); n is 1 isothermal to 1.4 adiabatic, `ambient` (Pa) the
    absolute pressure at gauge zero.
    """
    absolute = np.asarray(pressure, dtype=np.float64) + ambient
    n = polytropic_index
    return np.asarray(ATMOSPHERE ** (1.0 / n) / (n * absolute ** ((n + 1.0) / n)))


def stiff_bulk_modulus(oil: Oil) -> float:
    """Bulk modulus of oil and walls alone (Pa): ``1/β_stiff = 1/β_ref - α·c(p_ref)`` with the healthy air α.

    Refuses, with an `InputError`, that much air alone being softer than the bulk modulus given.
    """
    air = oil.air_fraction * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    stiff = 1.0 / oil.bulk_modulus - air
    if stiff <= 0.0:
        raise InputError(
            f"air_fraction {oil.air_fraction:g} alone gives {1e-6 / air:.0f} MPa at reference_pressure, "
            f"softer than bulk_modulus {oil.bulk_modulus / 1e6:.0f} MPa",
            where="unit oil",
            mend="lower air_fraction or bulk_modulus",
        )
    return 1.0 / stiff


def bulk_modulus(
    oil: Oil, pressure: ArrayLike, air_fraction: ArrayLike | None = None, ambient: float = ATMOSPHERE
) -> Array:
    """Effective bulk modulus (…), Pa, at a gauge pressure: ``1/β = 1/β_stiff + α·c(p)``.

    The `air_fraction` (…) is the volume of free air at atmospheric pressure over that of oil; None takes the
    unit's healthy one.
    """
    air = np.asarray(oil.air_fraction if air_fraction is None else air_fraction, dtype=np.float64)
    compliance = air_compliance(pressure, oil.polytropic_index, ambient)
    return np.asarray(1.0 / (1.0 / stiff_bulk_modulus(oil) + air * compliance))


@njit(error_model="numpy", inline="always")
def oil_at(
    pressure: float, free: float, warm: float, vapour: float, par: Constants
) -> tuple[float, float, float, float]:
    """Oil with free air and vapour in it, from its density ρ(p, T) over that of pure oil at gauge zero.

    ``ln ρ = s(T)·p - α·ΔT - free·g - w``: the stiff compliance s grows with heat, g is a polytropic gas's
    volume over that at atmospheric pressure (eqs 5.20 and 5.21) and at the oil's own temperature, w the
    vapour's volume, a power law that keeps the pressure near the vapour's and no mass of its own.

    Of a `pressure` (Pa, gauge), the volume of `free` air at atmospheric pressure over that of oil, K `warm`
    above the oil's reference temperature, and vapour pressure over sound oil's. Gives compliance ∂lnρ/∂p
    (1/Pa), ln ρ, g, and expansion -∂lnρ/∂T (1/K).
    """
    inverse = 1.0 / max(pressure + par.ambient, _LEAST_ABSOLUTE)
    cold = math.exp(par.polytropic_inverse * math.log(ATMOSPHERE * inverse))
    gas = (1.0 + AIR_WARMING * warm) * cold
    stiff = par.stiff_compliance + par.softening * warm
    soft = stiff + free * gas * par.polytropic_inverse * inverse
    density = stiff * pressure - par.expansion * warm - free * gas
    swell = par.expansion - par.softening * pressure + free * cold * AIR_WARMING
    q = max(1.0 + VAPOUR_SLOPE * warm, 0.1)
    ratio = par.vapour_pressure * vapour * q * q * q * inverse
    if ratio > VAPOUR_FELT:
        beyond = ratio - VAPOUR_FELT
        density -= VAPOUR_SHARE * beyond * beyond
        soft += 2.0 * VAPOUR_SHARE * beyond * ratio * inverse
        swell += 6.0 * VAPOUR_SHARE * beyond * ratio * VAPOUR_SLOPE / q
    return soft, density, gas, swell


@njit(error_model="numpy", inline="always")
def settled_air(pressure: float, air: float, par: Constants) -> float:
    """Free air that a gauge pressure leaves in the end: Henry's line down to a tenth, and what comes out of
    solution below the surroundings' pressure."""
    if pressure < 0.0:
        return air - par.releasing * pressure
    return air * (1.0 - 0.9 * min(pressure * par.dissolving, 1.0))
