"""Sections 6.3 and 6.4: the servomotor, and the whole actuator about rest and at speed, by ETFE and fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    Array,
    Beside,
    Figures,
    changed,
    hydraulic_gain,
    identification_volts,
    riding_partner,
    run_speed,
    with_friction,
)

SERVOMOTOR = TransferFunction((68.67, 1.21e5), (1.0, 760.8, 1.26e5), 0.001)
"""Eq. 6.11."""
SECONDS = 12.5
"""Of the test signal; the thesis names this interval for its verifying chirp."""
STALL_TORQUE = 8.0
"""N·m, Table 4.11; section 4.6 calls it the largest torque."""

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
class Identified:
    """A model of the motor and its fit (1 explains all), and the largest current (A)."""

    model: TransferFunction
    fit: float
    largest_current: float


def identify_motor(unit: Unit, seed: int, details: Details | None = None) -> Identified:
    """Second-order output-error model from demanded to true motor speed, about rest."""
    command = np.concatenate([np.zeros(_REST), VOLT * identification_volts(SECONDS, seed)])
    log = run_speed(unit, command, details=details, seed=seed).samples
    given = held_input(command, PERIOD)[_REST:]
    caused = velocity(log["pump_angle"], PERIOD)[_REST:]
    fits = [fit_output_error(given, caused, PERIOD, zeros=1, poles=2, delay=d * PERIOD) for d in range(4)]
    model, fit = max(fits, key=lambda found: found[1])
    return Identified(model, fit, float(np.max(np.abs(log["motor_current"]))))


def servomotor(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.3: identify axis A's servomotor as the thesis did, and with one thing changed at a time."""
    found = identify_motor(axis_a, seed)
    # A current limit that this signal does not reach; cogging grows with it.
    strong = changed(axis_a, "drive", current_limit=2.0 * axis_a.drive.current_limit)
    stalling = changed(axis_a, "drive", current_limit=STALL_TORQUE / axis_a.drive.torque_constant)
    quick = identify_motor(axis_a, seed, Details(current_lag=1e-4))

    def behind(model: TransferFunction, hertz: float) -> float:
        """How far its phase lies behind eq. 6.11's (°)."""
        return float(np.degrees(np.angle(SERVOMOTOR.at(hertz) / model.at(hertz))))

    return {
        "thesis": SERVOMOTOR,
        "found": found,
        "rates": np.sort(np.abs(found.model.poles)),
        "limit": axis_a.drive.current_limit,
        "free": identify_motor(strong, seed),
        "stalled": identify_motor(stalling, seed),
        "behind": behind(found.model, 100.0),
        "behind_bandwidth": behind(found.model, 33.3),
        "behind_quick": behind(quick.model, 100.0),
    }


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


LOW_SPEED = Region("low speed", 0.0, "eq. 6.12", LOW, 16.8, -44.5 + 98.3j, -55.8, SECONDS, 0.0)
HIGH_SPEED = Region("high speed", 8.375, "eq. 6.13", HIGH, 27.04, -50.9 + 142.3j, -83.8, 2.2, -0.130)
"""About 95 mm/s."""


@dataclass(frozen=True)
class Response:
    """What one axis answered in one region: model and fit, -3 dB points (Hz) by ETFE and by single sines."""

    model: TransferFunction
    fit: float
    empirical_bandwidth: float
    sines_bandwidth: float


def respond(
    unit: Unit, region: Region, seed: int, *, sines: tuple[float, ...] = SINES,
    partner: Beside | None = None, details: Details | None = None,
) -> Response:  # fmt: skip
    """Third-order output-error model, ETFE (through the thesis's window) and single sines in one region."""

    def driven(volts: Array) -> tuple[Array, Array]:
        """Command (rad/s) and velocity (m/s) while a signal plays, about what they are before it."""
        lead = np.full(_LEVEL if region.mean else 0, region.mean)
        command = VOLT * np.concatenate([np.zeros(_REST), lead, region.mean + volts])
        run = run_speed(unit, command, start=region.start, partner=partner, details=details, seed=seed)
        first, speed = _REST + lead.size, velocity(run.samples["position"], PERIOD)
        before = float(np.mean(speed[first - 60 : first - 10])) if region.mean else 0.0
        return held_input(command, PERIOD)[first:] - VOLT * region.mean, speed[first:] - before

    def single_sine(frequency: float) -> float:
        """Magnitude over Dp/A at one frequency, by the fundamental of the last whole periods."""
        seconds = 2.2 if region.mean else max(4.0 / frequency, 1.5)
        time = np.arange(round(seconds / PERIOD)) * PERIOD
        given, caused = driven(AMPLITUDE * np.sin(2.0 * np.pi * frequency * time))
        # The zero-phase filter has no future at the end of the log.
        usable = time.size - 20
        periods = max(int(0.6 * usable * PERIOD * frequency), 1)
        last = slice(usable - round(periods / (frequency * PERIOD)), usable)
        return abs(response_at(given[last], caused[last], PERIOD, frequency)) / hydraulic_gain(unit)

    given, caused = driven(identification_volts(region.seconds, seed))
    fits = [fit_output_error(given, caused, PERIOD, zeros=2, poles=3, delay=d * PERIOD) for d in _DELAYS]
    model, fit = max(fits, key=lambda found: found[1])
    frequency, empirical = windowed_response(given, caused, PERIOD)
    own = half_power_frequency(frequency, np.abs(empirical), abs(empirical[0]))
    single = np.array([single_sine(f) for f in sines])
    return Response(model, fit, own, half_power_frequency(np.array(sines), single, 1.0))


def split_poles(model: TransferFunction) -> tuple[complex, float]:
    """The complex pair's upper pole and the real one; of three real ones the two fastest are the pair."""
    poles = model.poles
    if np.any(np.abs(poles.imag) > 1e-6):
        return complex(poles[poles.imag > 1e-6][0]), float(poles[np.abs(poles.imag) <= 1e-6][0].real)
    real = np.sort(poles.real)
    return complex(real[0]), float(real[2])


def low_speed(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.4 about rest, where the friction of reversal decides."""
    pressure = VOLT * AMPLITUDE * axis_a.pump.displacement * axis_a.oil.bulk_modulus
    pressure /= 0.5 * axis_a.cylinder.volume_1 * 2.0 * np.pi * 16.8
    late = changed(axis_a, "drive", delay=_LATE)
    found = respond(axis_a, LOW_SPEED, seed)
    cases = {
        "plant": found,
        "plant, 10 % of its dry friction": respond(with_friction(axis_a, 0.1), LOW_SPEED, seed),
        "plant, its drive 8 ms late": respond(late, LOW_SPEED, seed),
        "plant, axis B riding along, by-pass and throttle open":
            respond(axis_a, LOW_SPEED, seed, partner=riding_partner(axis_b)),
    }  # fmt: skip
    return {
        "region": LOW_SPEED,
        "found": found,
        "cases": cases,
        "poles": split_poles,
        "force": pressure * axis_a.cylinder.area_1,
        "least": min(axis_a.friction.forward.coulomb, axis_a.friction.reverse.coulomb),
        "below": -20.0 * np.log10(abs(found.model.gain) / hydraulic_gain(axis_a)),
    }


def high_speed(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.4 about 95 mm/s, where the piston never reverses."""
    mass, late = axis_a.cylinder.moving_mass, changed(axis_a, "drive", delay=_LATE)
    heavy = changed(axis_a, "cylinder", moving_mass=mass + axis_b.cylinder.moving_mass)
    soft = changed(axis_a, "oil", bulk_modulus=4e7)
    riding, half_open = riding_partner(axis_b), riding_partner(axis_b, throttle=False)
    found = respond(axis_a, HIGH_SPEED, seed)
    cases = {
        "plant": found,
        "plant, bulk modulus 40 MPa": respond(soft, HIGH_SPEED, seed),
        "plant, twice the mass on its rod": respond(heavy, HIGH_SPEED, seed),
        "plant, its drive 8 ms late": respond(late, HIGH_SPEED, seed),
        "plant, axis B riding along, its by-pass and throttle open":
            respond(axis_a, HIGH_SPEED, seed, partner=riding),
        "plant, axis B riding along, its by-pass open": respond(axis_a, HIGH_SPEED, seed, partner=half_open),
    }  # fmt: skip
    return {
        "region": HIGH_SPEED,
        "found": found,
        "cases": cases,
        "poles": split_poles,
        "natural": abs(HIGH_SPEED.pair),
        "own": 2.0 * np.pi * from_profile(axis_a, 0.0).natural_hz,
        "mass": mass,
    }
