"""Section 6.4: the whole actuator, demanded motor speed to actuator velocity, about rest and at speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.identification.experiments.response import from_profile
from fdd.identification.experiments.spectra import half_power_frequency
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis.frequency_response import (
    TransferFunction,
    fit_output_error,
    held_input,
    response_at,
    velocity,
    windowed_response,
)
from reports.thesis.runs import (
    PERIOD,
    VOLT,
    Beside,
    Figures,
    changed,
    hydraulic_gain,
    identification_volts,
    riding_partner,
    run_speed,
    with_coulomb_alone,
    with_friction,
    with_torque,
)
from reports.thesis.servomotor import STALL_TORQUE, bode

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LOW = TransferFunction((1.08e-2, 2.562, 242.6), (1.0, 144.8, 1.66e4, 6.50e5), 0.01)
HIGH = TransferFunction((9.43e-3, 4.37, 648.80), (1.0, 185.5, 3.14e4, 1.91e6), 0.01)
"""Eqs 6.12 and 6.13 with velocity as the output."""
AMPLITUDE = 1.5
SINES = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 16.8, 22.0, 27.0, 33.0, 40.0, 50.0, 60.0, 70.0)
"""Hz of the single sines."""
_REST, _LEVEL = 100, 350
_DELAYS = (1, 2, 3, 5, 9, 10)
_LATE = 8e-3
"""s, delay of a drive whose model would have the thesis's 10 ms."""


@dataclass(frozen=True)
class Region:
    """A working region of section 6.4.

    `name`, `mean`: and the mean command (V). `equation`, `thesis`: its model in the thesis, and where.
    `bandwidth`, `pair`, `single`: Hz and 1/s, as the thesis prints them. `seconds`: of the test signal; at
    speed the stroke ends it. `start`: m from mid-stroke.
    """

    name: str
    mean: float
    equation: str
    thesis: TransferFunction
    bandwidth: float
    pair: complex
    single: float
    seconds: float
    start: float


LOW_SPEED = Region("low speed", 0.0, "eq. 6.12", LOW, 16.8, -44.5 + 98.3j, -55.8, 12.5, 0.0)
HIGH_SPEED = Region("high speed", 8.375, "eq. 6.13", HIGH, 27.04, -50.9 + 142.3j, -83.8, 2.2, -0.130)
"""About 95 mm/s."""


@dataclass(frozen=True)
class Response:
    """What one axis answered in one region: model and fit, ETFE, single sines and their -3 dB point (Hz).

    ETFE, through the thesis's window of 128 points, is in m/rad; `sines` (len(SINES),) are over Dp/A.
    """

    model: TransferFunction
    fit: float
    frequency: Array
    empirical: ComplexArray
    empirical_bandwidth: float
    sines: ComplexArray
    sines_bandwidth: float


def _drive(
    unit: Unit, region: Region, volts: Array, seed: int, partner: Beside | None, details: Details | None
) -> tuple[Array, Array]:
    """Command (rad/s) and velocity (m/s) while the signal plays, about what they are before it."""
    lead = np.full(_LEVEL if region.mean else 0, region.mean)
    command = VOLT * np.concatenate([np.zeros(_REST), lead, region.mean + volts])
    log = run_speed(unit, command, start=region.start, partner=partner, details=details, seed=seed).samples
    first = _REST + lead.size
    speed = velocity(log["position"], PERIOD)
    before = float(np.mean(speed[first - 60 : first - 10])) if region.mean else 0.0
    return held_input(command, PERIOD)[first:] - VOLT * region.mean, speed[first:] - before


def single_sine(
    unit: Unit, region: Region, frequency: float, seed: int, partner: Beside | None, details: Details | None
) -> complex:
    """Response over Dp/A to ±1.5 V at one frequency, by the fundamental of the last whole periods."""
    seconds = 2.2 if region.mean else max(4.0 / frequency, 1.5)
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    volts = AMPLITUDE * np.sin(2.0 * np.pi * frequency * time)
    given, caused = _drive(unit, region, volts, seed, partner, details)
    # The zero-phase filter has no future at the end of the log.
    usable = time.size - 20
    periods = max(int(0.6 * usable * PERIOD * frequency), 1)
    last = slice(usable - round(periods / (frequency * PERIOD)), usable)
    return response_at(given[last], caused[last], PERIOD, frequency) / hydraulic_gain(unit)


def respond(
    unit: Unit, region: Region, seed: int, *, sines: tuple[float, ...] = SINES,
    partner: Beside | None = None, details: Details | None = None,
) -> Response:  # fmt: skip
    """Third-order output-error model, ETFE and single sines of one axis in one region."""
    given, caused = _drive(unit, region, identification_volts(region.seconds, seed), seed, partner, details)
    fits = [fit_output_error(given, caused, PERIOD, zeros=2, poles=3, delay=d * PERIOD) for d in _DELAYS]
    model, fit = max(fits, key=lambda found: found[1])
    frequency, empirical = windowed_response(given, caused, PERIOD)
    own = half_power_frequency(frequency, np.abs(empirical), abs(empirical[0]))
    single = np.array([single_sine(unit, region, f, seed, partner, details) for f in sines])
    bandwidth = half_power_frequency(np.array(sines), np.abs(single), 1.0)
    return Response(model, fit, frequency, empirical, own, single, bandwidth)


def split_poles(model: TransferFunction) -> tuple[complex, float]:
    """The complex pair's upper pole and the real one; of three real ones the two fastest are the pair."""
    poles = model.poles
    if np.any(np.abs(poles.imag) > 1e-6):
        return complex(poles[poles.imag > 1e-6][0]), float(poles[np.abs(poles.imag) <= 1e-6][0].real)
    real = np.sort(poles.real)
    return complex(real[0]), float(real[2])


def _figures(region: Region, unit: Unit, found: Response, cases: dict[str, Response]) -> Figures:
    """What the template shows of a region: its model, the models with one thing changed, and the picture."""
    gain = hydraulic_gain(unit)
    picture = bode((found.frequency, found.empirical), found.model, region.thesis, region.equation, gain,
                   region.bandwidth, 80.0, (SINES, found.sines))  # fmt: skip
    return {"region": region, "found": found, "cases": cases, "poles": split_poles, "gain": gain,
            "picture": picture}  # fmt: skip


def low_speed(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.4 about rest, where the friction of reversal decides."""

    def case(unit: Unit = axis_a, partner: Beside | None = None, details: Details | None = None) -> Response:
        return respond(unit, LOW_SPEED, seed, partner=partner, details=details)

    pressure = VOLT * AMPLITUDE * axis_a.pump.displacement * axis_a.oil.bulk_modulus
    pressure /= 0.5 * axis_a.cylinder.volume_1 * 2.0 * np.pi * 16.8
    found = case()
    cases = {
        "plant": found,
        "plant, 30 % of its dry friction": case(with_friction(axis_a, 0.3)),
        "plant, 10 % of its dry friction": case(with_friction(axis_a, 0.1)),
        "plant, friction that does not rise towards rest": case(with_coulomb_alone(axis_a)),
        "plant, bristles three times as stiff":
            case(details=Details(bristle_stiffness=3.0 * Details().bristle_stiffness)),
        "plant, its drive limited to 8 N·m": case(with_torque(axis_a, STALL_TORQUE)),
        "plant, its drive 8 ms late": case(changed(axis_a, "drive", delay=_LATE)),
        "plant, axis B riding along, by-pass and throttle open": case(partner=riding_partner(axis_b)),
    }  # fmt: skip
    return {
        **_figures(LOW_SPEED, axis_a, found, cases),
        "force": pressure * axis_a.cylinder.area_1,
        "least": min(axis_a.friction.forward.coulomb, axis_a.friction.reverse.coulomb),
        "below": -20.0 * np.log10(abs(found.model.gain) / hydraulic_gain(axis_a)),
    }


def high_speed(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.4 about 95 mm/s, where the piston never reverses."""

    def case(unit: Unit = axis_a, partner: Beside | None = None, details: Details | None = None) -> Response:
        return respond(unit, HIGH_SPEED, seed, partner=partner, details=details)

    found, mass = case(), axis_a.cylinder.moving_mass
    heavy = changed(axis_a, "cylinder", moving_mass=mass + axis_b.cylinder.moving_mass)
    airy_a, airy_b = (changed(unit, "oil", bulk_modulus=1.2e8) for unit in (axis_a, axis_b))
    riding = "plant, axis B riding along"
    cases = {
        "plant": found,
        "plant, bulk modulus 40 MPa": case(changed(axis_a, "oil", bulk_modulus=4e7)),
        "plant, twice the mass on its rod": case(heavy),
        "plant, its drive limited to 8 N·m": case(with_torque(axis_a, STALL_TORQUE)),
        "plant, its drive 8 ms late": case(changed(axis_a, "drive", delay=_LATE)),
        "plant, seals' resistance to quick changes 500 N·s/m": case(details=Details(seal_damping=500.0)),
        f"{riding}, its by-pass and throttle open": case(partner=riding_partner(axis_b)),
        f"{riding}, its by-pass open": case(partner=riding_partner(axis_b, throttle=False)),
        f"{riding}, by-pass and throttle open, both axes 120 MPa": case(airy_a, riding_partner(airy_b)),
    }
    return {
        **_figures(HIGH_SPEED, axis_a, found, cases),
        "natural": abs(HIGH_SPEED.pair),
        "own": 2.0 * np.pi * from_profile(axis_a, 0.0).natural_hz,
        "mass": mass,
    }
