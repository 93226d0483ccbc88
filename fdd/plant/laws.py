"""Laws of single elements, compiled: valves, orifices, oil, viscosity."""

from __future__ import annotations

import math

from fdd.plant.compiled import njit
from fdd.plant.oil import ATMOSPHERE

_LEAST_ABSOLUTE = 1.0  # Pa; guards the power law within a step, the air's compliance keeps the state above
_KELVIN = 273.15
_WALTHER_SHIFT = 0.7  # cSt, of ASTM D341


@njit(error_model="numpy", inline="always")
def opening(excess: float, width: float) -> float:
    """Excess of pressure over a valve's setting, with a smooth start.

    The polynomial of fourth degree that leaves zero at -width and meets `excess` at +width with equal
    slope and curvature: a closed valve is exactly closed, unlike a softplus.
    """
    if excess >= width:
        return excess
    if excess <= -width:
        return 0.0
    u = excess / width
    return width * (0.1875 + u * (0.5 + u * (0.375 - 0.0625 * u * u)))


@njit(error_model="numpy", inline="always")
def orifice(drop: float, flow_at_1_mpa: float, transition: float) -> float:
    """Signed flow through an orifice, laminar below the transition: k·Δp/(Δp² + Δp_tr²)^¼.

    Ellman and Piché's two-regime idea (doi:10.1115/1.2802540) in one smooth formula.
    """
    return flow_at_1_mpa * 1e-3 * drop / math.sqrt(math.sqrt(drop * drop + transition * transition))


@njit(error_model="numpy", inline="always")
def lifted(
    own: float,
    other: float,
    inner: float,
    cracking: float,
    width: float,
    ratio: float,
    pilot: float,
    band: float,
) -> float:
    """Opening (0 to 1) at which a refeeding valve's poppet would rest, of a spring's or a pilot's lift.

    Without pilot this times the drop is today's linear law beyond cracking. A pilot of that area ratio lifts
    the poppet off its seat once the other chamber's pressure beats the own one's, fully over the band.
    """
    drop = inner - own
    share = 0.0
    if drop > 1.0:
        share = opening(drop - cracking, width) / drop
    if ratio > 0.0:
        beyond = opening(ratio * (other - inner) - (own - inner) - pilot, width) / band
        share = max(share, min(beyond, 1.0))
    return share


@njit(error_model="numpy", inline="always")
def poppet(drop: float, gain: float, knee: float) -> float:
    """Signed flow through an open poppet valve: linear with that gain, a square root beyond the knee."""
    return gain * drop / math.sqrt(1.0 + abs(drop) / knee)


@njit(error_model="numpy", inline="always")
def oil_at(
    pressure: float, air: float, ambient: float, stiff: float, inverse_n: float
) -> tuple[float, float]:
    """Compliance 1/β (1/Pa) and density over that at atmospheric pressure, ρ = exp ∫dp/β."""
    inverse = 1.0 / max(pressure + ambient, _LEAST_ABSOLUTE)
    gas = math.exp(inverse_n * math.log(ATMOSPHERE * inverse))
    return stiff + air * gas * inverse_n * inverse, math.exp(pressure * stiff + air * (1.0 - gas))


@njit(error_model="numpy", inline="always")
def free_in_the_end(pressure: float, dissolving: float) -> float:
    """Share of the air that stays free at a gauge pressure: Henry's line down to a tenth."""
    return 1.0 - 0.9 * min(max(pressure / dissolving, 0.0), 1.0)


@njit(error_model="numpy", inline="always")
def walther(temperature: float, intercept: float, slope: float) -> float:
    """Kinematic viscosity (cSt) at a temperature (°C), ASTM D341: log10 log10(ν + 0.7) = a + b·log10 T."""
    inner = intercept + slope * math.log10(temperature + _KELVIN)
    return math.pow(10.0, math.pow(10.0, inner)) - _WALTHER_SHIFT


@njit(error_model="numpy", inline="always")
def gas_pressure(absolute: float, volume: float, oil: float) -> float:
    """Absolute pressure (Pa) of an accumulator's gas once `oil` m³ have come in, isothermal (eq. 3.19)."""
    return absolute * volume / (volume - oil)
