"""Sections 6.3 and 6.4: servomotor and whole actuator, by ETFE, output-error fit and single sines."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.identification.experiments.dynamics import half_power_frequency
from fdd.identification.experiments.response import decibel, degrees
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis import runs as rig
from reports.thesis.flow import from_profile
from reports.writing import Curve, Panel

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SERVOMOTOR = rig.TransferFunction((68.67, 1.21e5), (1.0, 760.8, 1.26e5), 0.001)
"""Eq. 6.11."""
BANDWIDTH = 33.3
"""Hz, section 6.3."""
SECONDS, _NOISE_SECONDS = 12.5, 8.0
"""Of the test signal; the thesis names this interval for its verifying chirp."""
LEVELS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""V of section 6.2's binary noise of 785.4 rad/s; the thesis's drive fails at more than 6 V."""
STALL_TORQUE = 8.0
"""N·m, Table 4.11; section 4.6 calls it the largest torque."""
LIMITS = (STALL_TORQUE, 16.1, 26.0)
"""N·m: the stall torque, the profile's limit, and one and a half times that."""


class Identified(NamedTuple):
    """A model and its fit (1 explains all), input and output (n,) that it is from, largest current (A)."""

    model: rig.TransferFunction
    fit: float
    given: Array
    caused: Array
    largest_current: float


def _best_fit(delays: Iterable[int], *signals: Array, **orders: Any) -> tuple[rig.TransferFunction, float]:
    """Output-error model with the delay (ms) under which it explains most, and its fit."""
    fits = (rig.fit_output_error(*signals, delay=d * rig.PERIOD, **orders) for d in delays)
    return max(fits, key=lambda found: found[1])


def _seen(command: Array, output: Array, first: int) -> tuple[Array, Array]:
    """Input and output as the thesis filters them, from the row `first` on."""
    return rig.held_input(command)[first:], rig.velocity(output)[first:]


def identify_motor(unit: Unit, seed: int, details: Details | None = None) -> Identified:
    """Second-order output-error model from demanded to true motor speed, about rest."""
    command = np.concatenate([np.zeros(_REST), rig.VOLT * rig.identification_volts(SECONDS, seed)])
    log = rig.run_speed(unit, command, details=details, seed=seed).samples
    signals = _seen(command, log["pump_angle"], _REST)
    found = _best_fit(range(4), *signals, zeros=1, poles=2)
    return Identified(*found, *signals, float(np.max(np.abs(log["motor_current"]))))


def level_bandwidths(unit: Unit, limit: float, seed: int) -> list[str]:
    """-3 dB points (Hz, below the ETFE's value at 1 Hz) of motor / whole actuator at each of `LEVELS`, as
    figures 6.7 and 6.8, with the drive's torque limited (N·m)."""
    limited, found = rig.with_torque(unit, limit), []
    for volt in LEVELS:
        noise = volt * rig.VOLT * rig.binary_noise(_NOISE_SECONDS, 125.0, seed)
        command = np.concatenate([np.zeros(_REST), noise])
        log = rig.run_speed(limited, command, seed=seed).samples
        points = []
        for channel in ("pump_angle", "position"):
            frequency, response = rig.windowed_response(*_seen(command, log[channel], _REST))
            size = np.abs(response)[frequency >= 1.0]
            points.append(half_power_frequency(frequency[frequency >= 1.0], size, float(size[0])))
        found.append(" / ".join(f"{hz:.0f}" for hz in points))
    return found


def bode(measured: tuple[Array, ComplexArray], model: rig.TransferFunction, thesis: rig.TransferFunction,
          name: str, gain: float, mark: float, highest: float,
          points: tuple[tuple[float, ...], ComplexArray] | None = None) -> list[Panel]:  # fmt: skip
    """Magnitude and phase over a gain: measured response, model, the thesis's, and points beside them."""
    frequency, response = measured
    fine, shown = np.geomspace(0.5, highest, 400), (frequency > 0.5) & (frequency < highest)
    curves: list[tuple[Array, ComplexArray, str, str]] = [
        (frequency[shown], response[shown] / gain, "0.65", "plant, ETFE"),
        (fine, model.at(fine) / gain, "C0-", "plant, output-error model"),
        (fine, thesis.at(fine) / gain, "k--", f"thesis, {name}"),
    ]
    if points is not None:
        curves.append((np.array(points[0]), points[1], "C3o", "plant, single sines of ±1.5 V"))
    common = {"xscale": "log", "xlabel": "frequency (Hz)"}
    at = {mark: f"thesis, {mark:.1f} Hz"}
    size: list[Curve] = [(x, decibel(y), style, label) for x, y, style, label in curves]
    phase: list[Curve] = [(x, degrees(y), style, label) for x, y, style, label in curves]
    return [
        Panel(size, {"ylabel": "magnitude (dB)", "ylim": (-25.0, 8.0), **common}, at_x=at),
        Panel(phase, {"ylabel": "phase (°)", "ylim": (-360.0, 20.0), **common}, at_x=at),
    ]


def _degrees_behind(model: rig.TransferFunction, frequency: float) -> float:
    """How far its phase lies behind eq. 6.11's at a frequency in Hz (°)."""
    return float(np.degrees(np.angle(SERVOMOTOR.at(frequency) / model.at(frequency))))


def servomotor(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 6.3: identify axis A's servomotor as the thesis did, and with one thing changed at a time."""
    found = identify_motor(axis_a, seed)
    measured = rig.empirical_response(found.given, found.caused)
    # A current limit that this signal does not reach; cogging grows with it.
    strong = rig.changed(axis_a, "drive", current_limit=2.0 * axis_a.drive.current_limit)
    quick = identify_motor(axis_a, seed, Details(current_lag=1e-4))
    return {
        "thesis": SERVOMOTOR,
        "found": found,
        "rates": np.sort(np.abs(found.model.poles)),
        "free": identify_motor(strong, seed),
        "stalled": identify_motor(rig.with_torque(axis_a, STALL_TORQUE), seed),
        "levels": [(limit, level_bandwidths(axis_a, limit, seed)) for limit in LIMITS],
        "volts": LEVELS,
        "behind": _degrees_behind(found.model, 100.0),
        "behind_bandwidth": _degrees_behind(found.model, 33.3),
        "behind_quick": _degrees_behind(quick.model, 100.0),
        "picture": bode(measured, found.model, SERVOMOTOR, "eq. 6.11", 1.0, BANDWIDTH, 150.0),
    }


LOW = rig.TransferFunction((1.08e-2, 2.562, 242.6), (1.0, 144.8, 1.66e4, 6.50e5), 0.01)
HIGH = rig.TransferFunction((9.43e-3, 4.37, 648.80), (1.0, 185.5, 3.14e4, 1.91e6), 0.01)
"""Eqs 6.12 and 6.13 with velocity as the output."""
AMPLITUDE = 1.5
SINES = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 16.8, 22.0, 27.0, 33.0, 40.0, 50.0, 60.0, 70.0)
"""Hz of the single sines."""
_REST, _LEVEL = 100, 350
_DELAYS = (1, 2, 3, 5, 9, 10)
_LATE = 8e-3
"""s, delay of a drive whose model would have the thesis's 10 ms."""


class Region(NamedTuple):
    """A working region of section 6.4: mean command (V), the thesis's model with its bandwidth (Hz) and poles
    (1/s) as printed, s of the test signal, which at speed the stroke ends, and start, m from mid-stroke."""

    name: str
    mean: float
    equation: str
    thesis: rig.TransferFunction
    bandwidth: float
    pair: complex
    single: float
    seconds: float
    start: float


LOW_SPEED = Region("low speed", 0.0, "eq. 6.12", LOW, 16.8, -44.5 + 98.3j, -55.8, 12.5, 0.0)
HIGH_SPEED = Region("high speed", 8.375, "eq. 6.13", HIGH, 27.04, -50.9 + 142.3j, -83.8, 2.2, -0.130)
"""About 95 mm/s."""


class Response(NamedTuple):
    """What one axis answered in one region: model and fit, ETFE (m/rad) through the thesis's window of 128
    points, single sines over Dp/A, (len(SINES),), and -3 dB points (Hz)."""

    model: rig.TransferFunction
    fit: float
    frequency: Array
    empirical: ComplexArray
    empirical_bandwidth: float
    sines: ComplexArray
    sines_bandwidth: float


def _drive(unit: Unit, region: Region, volts: Array, seed: int, **how: Any) -> tuple[Array, Array]:
    """Command (rad/s) and velocity (m/s) while the signal plays, about what they are before it."""
    lead = np.full(_LEVEL if region.mean else 0, region.mean)
    command = rig.VOLT * np.concatenate([np.zeros(_REST), lead, region.mean + volts])
    log = rig.run_speed(unit, command, start=region.start, seed=seed, **how).samples
    given, speed = _seen(command, log["position"], 0)
    first = _REST + lead.size
    before = float(np.mean(speed[first - 60 : first - 10])) if region.mean else 0.0
    return given[first:] - rig.VOLT * region.mean, speed[first:] - before


def single_sine(unit: Unit, region: Region, frequency: float, seed: int, **how: Any) -> complex:
    """Response over Dp/A to ±1.5 V at one frequency, by the fundamental of the last whole periods."""
    seconds = 2.2 if region.mean else max(4.0 / frequency, 1.5)
    time = np.arange(round(seconds / rig.PERIOD)) * rig.PERIOD
    volts = AMPLITUDE * np.sin(2.0 * np.pi * frequency * time)
    given, caused = _drive(unit, region, volts, seed, **how)
    # The zero-phase filter has no future at the end of the log.
    usable = time.size - 20
    periods = max(int(0.6 * usable * rig.PERIOD * frequency), 1)
    last = slice(usable - round(periods / (frequency * rig.PERIOD)), usable)
    return rig.response_at(given[last], caused[last], frequency) / rig.hydraulic_gain(unit)


def respond(
    unit: Unit, region: Region, seed: int, *, sines: tuple[float, ...] = SINES, **how: Any
) -> Response:
    """Third-order output-error model, ETFE and single sines of one axis in one region; `how` it is run."""
    given, caused = _drive(unit, region, rig.identification_volts(region.seconds, seed), seed, **how)
    model, fit = _best_fit(_DELAYS, given, caused, zeros=2, poles=3)
    frequency, empirical = rig.windowed_response(given, caused)
    own = half_power_frequency(frequency, np.abs(empirical), abs(empirical[0]))
    single = np.array([single_sine(unit, region, f, seed, **how) for f in sines])
    bandwidth = half_power_frequency(np.array(sines), np.abs(single), 1.0)
    return Response(model, fit, frequency, empirical, own, single, bandwidth)


def split_poles(model: rig.TransferFunction) -> tuple[complex, float]:
    """The complex pair's upper pole and the real one; of three real ones the two fastest are the pair."""
    poles = model.poles
    if np.any(np.abs(poles.imag) > 1e-6):
        return complex(poles[poles.imag > 1e-6][0]), float(poles[np.abs(poles.imag) <= 1e-6][0].real)
    real = np.sort(poles.real)
    return complex(real[0]), float(real[2])


def _figures(region: Region, unit: Unit, found: Response, cases: dict[str, Response]) -> rig.Figures:
    """What the template shows of a region: its model, the models with one thing changed, and the picture."""
    picture = bode((found.frequency, found.empirical), found.model, region.thesis, region.equation,
                   rig.hydraulic_gain(unit), region.bandwidth, 80.0, (SINES, found.sines))  # fmt: skip
    return {"region": region, "found": found, "cases": cases, "poles": split_poles, "picture": picture}


def low_speed(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 6.4 about rest, where the friction of reversal decides."""
    case = partial(respond, region=LOW_SPEED, seed=seed)
    found = case(axis_a)
    cases = {
        "plant": found,
        "plant, 30 % of its dry friction": case(rig.with_friction(axis_a, 0.3)),
        "plant, 10 % of its dry friction": case(rig.with_friction(axis_a, 0.1)),
        "plant, friction that does not rise towards rest": case(rig.with_friction(axis_a, rises=False)),
        "plant, bristles three times as stiff":
            case(axis_a, details=Details(bristle_stiffness=3.0 * Details().bristle_stiffness)),
        "plant, its drive limited to 8 N·m": case(rig.with_torque(axis_a, STALL_TORQUE)),
        "plant, its drive 8 ms late": case(rig.changed(axis_a, "drive", delay=_LATE)),
        "plant, axis B riding along, by-pass and throttle open":
            case(axis_a, partner=rig.riding_partner(axis_b)),
    }  # fmt: skip
    below = -20.0 * np.log10(abs(found.model.gain) / rig.hydraulic_gain(axis_a))
    return {**_figures(LOW_SPEED, axis_a, found, cases), "below": below}


def high_speed(axis_a: Unit, axis_b: Unit, seed: int) -> rig.Figures:
    """Section 6.4 about 95 mm/s, where the piston never reverses."""
    case = partial(respond, region=HIGH_SPEED, seed=seed)
    found, mass = case(axis_a), axis_a.cylinder.moving_mass + axis_b.cylinder.moving_mass
    heavy = rig.changed(axis_a, "cylinder", moving_mass=mass)
    airy_a, airy_b = (rig.changed(unit, "oil", bulk_modulus=1.2e8) for unit in (axis_a, axis_b))
    riding = "plant, axis B riding along"
    cases = {
        "plant": found,
        "plant, bulk modulus 40 MPa": case(rig.changed(axis_a, "oil", bulk_modulus=4e7)),
        "plant, twice the mass on its rod": case(heavy),
        "plant, its drive limited to 8 N·m": case(rig.with_torque(axis_a, STALL_TORQUE)),
        "plant, its drive 8 ms late": case(rig.changed(axis_a, "drive", delay=_LATE)),
        "plant, seals' resistance to quick changes 500 N·s/m": case(
            axis_a, details=Details(seal_damping=500.0)
        ),
        f"{riding}, its by-pass and throttle open": case(axis_a, partner=rig.riding_partner(axis_b)),
        f"{riding}, its by-pass open": case(axis_a, partner=rig.riding_partner(axis_b, throttle=False)),
        f"{riding}, by-pass and throttle open, both axes 120 MPa": case(
            airy_a, partner=rig.riding_partner(airy_b)
        ),
    }
    own = 2.0 * np.pi * from_profile(axis_a, 0.0).natural_hz
    return {**_figures(HIGH_SPEED, axis_a, found, cases), "natural": abs(HIGH_SPEED.pair), "own": own}
