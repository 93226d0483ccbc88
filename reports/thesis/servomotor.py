"""Section 6.3: the servomotor's transfer function by ETFE and output-error fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.identification.experiments.response import decibel, degrees
from fdd.identification.experiments.spectra import half_power_frequency
from fdd.plant.details import Details
from fdd.unit import Unit
from reports.thesis.frequency_response import (
    TransferFunction,
    empirical_response,
    fit_output_error,
    held_input,
    velocity,
    windowed_response,
)
from reports.thesis.runs import (
    PERIOD,
    VOLT,
    Figures,
    binary_noise,
    changed,
    identification_volts,
    run_speed,
    with_torque,
)
from reports.writing import Panel

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SERVOMOTOR = TransferFunction((68.67, 1.21e5), (1.0, 760.8, 1.26e5), 0.001)
"""Eq. 6.11."""
BANDWIDTH = 33.3
"""Hz, section 6.3."""
SECONDS, _NOISE_SECONDS = 12.5, 8.0
"""Of the test signal; the thesis names this interval for its verifying chirp."""
_REST = 100
LEVELS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""V of section 6.2's binary noise of 785.4 rad/s; the thesis's drive fails at more than 6 V."""
STALL_TORQUE = 8.0
"""N·m, Table 4.11; section 4.6 calls it the largest torque."""
LIMITS = (STALL_TORQUE, 16.1, 26.0)
"""N·m: the stall torque, the profile's limit, and one and a half times that."""


@dataclass(frozen=True)
class Identified:
    """A model and its fit (1 explains all), input and output (n,) that it is from, largest current (A)."""

    model: TransferFunction
    fit: float
    given: Array
    caused: Array
    largest_current: float


def identify_motor(unit: Unit, seed: int, details: Details | None = None) -> Identified:
    """Second-order output-error model from demanded to true motor speed, about rest."""
    command = np.concatenate([np.zeros(_REST), VOLT * identification_volts(SECONDS, seed)])
    log = run_speed(unit, command, details=details, seed=seed).samples
    given = held_input(command, PERIOD)[_REST:]
    caused = velocity(log["pump_angle"], PERIOD)[_REST:]
    fits = [
        fit_output_error(given, caused, PERIOD, zeros=1, poles=2, delay=d * PERIOD, highest_hz=150.0)
        for d in range(4)
    ]
    model, fit = max(fits, key=lambda found: found[1])
    return Identified(model, fit, given, caused, float(np.max(np.abs(log["motor_current"]))))


def level_bandwidths(unit: Unit, limit: float, seed: int) -> list[str]:
    """-3 dB points (Hz) of motor / whole actuator at each of `LEVELS`, as figures 6.7 and 6.8.

    By an ETFE through a window of 128 points, below its value at 1 Hz, with the drive's torque limited (N·m).
    """
    limited, found = with_torque(unit, limit), []
    for volt in LEVELS:
        command = np.concatenate([np.zeros(_REST), volt * VOLT * binary_noise(_NOISE_SECONDS, 125.0, seed)])
        log = run_speed(limited, command, seed=seed).samples
        given = held_input(command, PERIOD)[_REST:]
        points = []
        for channel in ("pump_angle", "position"):
            frequency, response = windowed_response(given, velocity(log[channel], PERIOD)[_REST:], PERIOD)
            size = np.abs(response)[frequency >= 1.0]
            points.append(half_power_frequency(frequency[frequency >= 1.0], size, float(size[0])))
        found.append(" / ".join(f"{hz:.0f}" for hz in points))
    return found


def bode(measured: tuple[Array, ComplexArray], model: TransferFunction, thesis: TransferFunction,
          name: str, gain: float, mark: float, highest: float,
          points: tuple[tuple[float, ...], ComplexArray] | None = None) -> list[Panel]:  # fmt: skip
    """Magnitude and phase over a gain: measured response, model, the thesis's, and points beside them."""
    frequency, response = measured
    fine, shown = np.geomspace(0.5, highest, 400), (frequency > 0.5) & (frequency < highest)
    panels = []
    parts: tuple[tuple[Callable[[ComplexArray], Array], str, tuple[float, float]], ...] = (
        (decibel, "magnitude (dB)", (-25.0, 8.0)), (degrees, "phase (°)", (-360.0, 20.0)),
    )  # fmt: skip
    for part, label, limits in parts:
        curves = [
            (frequency[shown], part(response[shown] / gain), "0.65", "plant, ETFE"),
            (fine, part(model.at(fine) / gain), "C0-", "plant, output-error model"),
            (fine, part(thesis.at(fine) / gain), "k--", f"thesis, {name}"),
        ]
        if points is not None:
            curves.append((np.array(points[0]), part(points[1]), "C3o", "plant, single sines of ±1.5 V"))
        settings = {"ylabel": label, "ylim": limits, "xscale": "log", "xlabel": "frequency (Hz)"}
        panels.append(Panel(curves, settings, at_x={mark: f"thesis, {mark:.1f} Hz"}))
    return panels


def _degrees_behind(model: TransferFunction, frequency: float) -> float:
    """How far its phase lies behind eq. 6.11's at a frequency in Hz (°)."""
    high = np.array([frequency])
    return float(np.degrees(np.angle(SERVOMOTOR.at(high) / model.at(high)))[0])


def servomotor(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Section 6.3: identify axis A's servomotor as the thesis did, and with one thing changed at a time."""
    found = identify_motor(axis_a, seed)
    measured = empirical_response(found.given, found.caused, PERIOD)
    # A current limit that this signal does not reach; cogging grows with it.
    strong = changed(axis_a, "drive", current_limit=2.0 * axis_a.drive.current_limit)
    quick = identify_motor(axis_a, seed, Details(current_lag=1e-4))
    return {
        "thesis": SERVOMOTOR,
        "found": found,
        "rates": np.sort(np.abs(found.model.poles)),
        "limit": axis_a.drive.current_limit,
        "free": identify_motor(strong, seed),
        "stalled": identify_motor(with_torque(axis_a, STALL_TORQUE), seed),
        "levels": [(limit, level_bandwidths(axis_a, limit, seed)) for limit in LIMITS],
        "volts": LEVELS,
        "behind": _degrees_behind(found.model, 100.0),
        "behind_bandwidth": _degrees_behind(found.model, 33.3),
        "behind_quick": _degrees_behind(quick.model, 100.0),
        "picture": bode(measured, found.model, SERVOMOTOR, "eq. 6.11", 1.0, BANDWIDTH, 150.0),
    }
