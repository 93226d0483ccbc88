"""Laws of single elements, compiled: valves, orifices, oil, accumulator, viscosity."""

from __future__ import annotations

import math

from fdd.plant import Constants
from fdd.plant import oil as o
from fdd.plant.compiled import njit

_LEAST_ABSOLUTE = 1.0  # Pa; guards the power law within a step, gas and vapour keep the state above


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
def lift_rate(
    own: float, other: float, inner: float, lift: float, crack: float, stick: float, par: Constants
) -> float:
    """Rate (1/s) of a refeeding valve's poppet, towards the lift at which its spring or pilot lets it rest.

    Friction holds a raised poppet until the pressure falls by the hysteresis. A pilot of area ratio r lifts
    it off its seat once the other chamber's pressure beats its own, fully over a band. A poppet that sticks
    does not shut before its own chamber presses on it with `stick`.
    """
    drop = inner - own
    rest, held = 0.0, 0.0
    if drop > 1.0:
        beyond = drop - par.refeed_cracking - crack
        rest = opening(beyond, par.check_width) / drop
        if lift > rest:
            held = opening(beyond + par.check_hysteresis, par.check_width) / drop
    if par.pilot_ratio > 0.0:
        beyond = opening(par.pilot_ratio * (other - inner) + drop - par.pilot_cracking, par.check_width)
        rest = max(rest, min(beyond / par.pilot_band, 1.0))
    if lift > rest:
        if stick > 0.0 and -drop < stick:
            return 0.0
        return min(max(rest, held) - lift, 0.0) * par.check_rate
    return (rest - lift) * par.check_rate


@njit(error_model="numpy", inline="always")
def poppet(drop: float, gain: float, knee: float) -> float:
    """Signed flow through an open poppet valve: linear with that gain, a square root beyond the knee."""
    return gain * drop / math.sqrt(1.0 + abs(drop) / knee)


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
    cold = math.exp(par.polytropic_inverse * math.log(o.ATMOSPHERE * inverse))
    gas = (1.0 + o.AIR_WARMING * warm) * cold
    stiff = par.stiff_compliance + par.softening * warm
    soft = stiff + free * gas * par.polytropic_inverse * inverse
    density = stiff * pressure - par.expansion * warm - free * gas
    swell = par.expansion - par.softening * pressure + free * cold * o.AIR_WARMING
    q = max(1.0 + o.VAPOUR_SLOPE * warm, 0.1)
    ratio = par.vapour_pressure * vapour * q * q * q * inverse
    if ratio > o.VAPOUR_FELT:
        beyond = ratio - o.VAPOUR_FELT
        density -= o.VAPOUR_SHARE * beyond * beyond
        soft += 2.0 * o.VAPOUR_SHARE * beyond * ratio * inverse
        swell += 6.0 * o.VAPOUR_SHARE * beyond * ratio * o.VAPOUR_SLOPE / q
    return soft, density, gas, swell


@njit(error_model="numpy", inline="always")
def settled_air(pressure: float, air: float, par: Constants) -> float:
    """Free air that a gauge pressure leaves in the end: Henry's line down to a tenth, and what comes out of
    solution below the surroundings' pressure."""
    if pressure < 0.0:
        return air - par.releasing * pressure
    return air * (1.0 - 0.9 * min(pressure * par.dissolving, 1.0))


@njit(error_model="numpy", inline="always")
def walther(temperature: float, intercept: float, slope: float) -> float:
    """Kinematic viscosity (cSt) at a temperature (°C), ASTM D341: log10 log10(ν + 0.7) = a + b·log10 T."""
    inner = intercept + slope * math.log10(temperature + o.KELVIN)
    return math.pow(10.0, math.pow(10.0, inner)) - o.WALTHER_SHIFT


@njit(error_model="numpy", inline="always")
def store_pressure(oil: float, heat: float, par: Constants) -> float:
    """Gauge pressure (Pa) of the accumulator and the inner circuit around it.

    Gas on its separator (eq. 3.19) while that floats. At its stop on the oil's side the accumulator is empty:
    the pressure falls with what little gas the inner circuit's own oil holds. At the other one the inner
    circuit's oil alone gives.

    Of the `oil` held (m³; negative is what the inner circuit lacks) and the gas's absolute temperature over
    that at rest.
    """
    if oil < 0.0:
        left = par.gallery_gas / (par.gallery_gas - oil)
        return par.gas_pressure * par.gas_volume / par.shell_volume * heat * left - par.ambient
    held = min(oil, par.full)
    gas = par.gas_pressure * par.gas_volume * heat / (par.shell_volume - held)
    return gas - par.ambient + (oil - held) * par.full_stiffness
