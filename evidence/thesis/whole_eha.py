"""Section 6.4: the whole actuator, demanded motor speed to actuator velocity, about rest and at speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.frequency_response import (
    TransferFunction,
    fit_output_error,
    held_input,
    response_at,
    velocity,
    windowed_response,
)
from evidence.thesis.runs import PERIOD, VOLT, riding_partner, run_speed
from evidence.thesis.signals import identification_volts
from fdd.identification.experiments.etfe import half_power_frequency
from fdd.identification.experiments.hydraulic import from_profile
from fdd.identification.experiments.response import decibel, degrees
from fdd.plant.details import Details
from fdd.plant.scenario import Partner
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

LOW = TransferFunction((1.08e-2, 2.562, 242.6), (1.0, 144.8, 1.66e4, 6.50e5), 0.01)
HIGH = TransferFunction((9.43e-3, 4.37, 648.80), (1.0, 185.5, 3.14e4, 1.91e6), 0.01)
"""Eqs 6.12 and 6.13 with velocity as the output."""
AMPLITUDE = 1.5
HIGH_MEAN = 8.375
"""V, of the high-speed region: 95 mm/s."""
SINES = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 16.8, 22.0, 27.0, 33.0, 40.0, 50.0, 60.0, 70.0)
"""Hz of the single sines."""
_REST, _LEVEL = 100, 350
_DELAYS = (1, 2, 3, 5, 9, 10)
_LATE = 8e-3
"""s, delay of a drive whose model would have the thesis's 10 ms."""
STALL_TORQUE = 8.0
"""N·m, Table 4.11; section 4.6 calls it the largest torque."""
_AIRY = 1.2e8


@dataclass(frozen=True)
class Region:
    """A working region of section 6.4.

    Attributes
    ----------
    name, mean : and the mean command (V).
    equation, thesis : its model in the thesis, and where.
    bandwidth, pair, single : Hz and 1/s, as the thesis prints them.
    seconds : of the test signal; at speed the stroke ends it.
    start : m from mid-stroke.
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
HIGH_SPEED = Region("high speed", HIGH_MEAN, "eq. 6.13", HIGH, 27.04, -50.9 + 142.3j, -83.8, 2.2, -0.130)


@dataclass(frozen=True)
class Response:
    """What one axis answered in one region: model and fit, ETFE, single sines and their -3 dB point (Hz).

    ETFE, through the thesis's window of 128 points, and `sines` (len(SINES),) are over `gain`, Dp/A (m/rad).
    """

    gain: float
    model: TransferFunction
    fit: float
    frequency: Array
    empirical: NDArray[np.complex128]
    empirical_bandwidth: float
    sines: NDArray[np.complex128]
    sines_bandwidth: float


def _drive(
    unit: Unit,
    region: Region,
    volts: Array,
    seed: int,
    partner: tuple[Unit, Partner] | None = None,
    details: Details | None = None,
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
    unit: Unit,
    region: Region,
    frequency: float,
    seed: int,
    partner: tuple[Unit, Partner] | None = None,
    details: Details | None = None,
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
    gain = unit.pump.displacement / unit.cylinder.area_1
    return response_at(given[last], caused[last], PERIOD, frequency) / gain


def respond(
    unit: Unit,
    region: Region,
    seed: int,
    *,
    sines: tuple[float, ...] = SINES,
    partner: tuple[Unit, Partner] | None = None,
    details: Details | None = None,
) -> Response:
    """Third-order output-error model, ETFE and single sines of one axis in one region.

    With a `partner`, the other axis is on the same rod and does what that says.
    """
    gain = unit.pump.displacement / unit.cylinder.area_1
    given, caused = _drive(unit, region, identification_volts(region.seconds, seed), seed, partner, details)
    fits = [fit_output_error(given, caused, PERIOD, zeros=2, poles=3, delay=d * PERIOD) for d in _DELAYS]
    model, fit = max(fits, key=lambda found: found[1])
    frequency, empirical = windowed_response(given, caused, PERIOD)
    own = half_power_frequency(frequency, np.abs(empirical), abs(empirical[0]))
    single = np.array([single_sine(unit, region, f, seed, partner, details) for f in sines])
    bandwidth = half_power_frequency(np.array(sines), np.abs(single), 1.0)
    return Response(gain, model, fit, frequency, empirical / gain, own, single, bandwidth)


def with_friction(unit: Unit, share: float) -> Unit:
    """The same axis with a share of its dry friction."""
    changed = unit.model_copy(deep=True)
    for branch in (changed.friction.forward, changed.friction.reverse):
        branch.coulomb *= share
        branch.static *= share
    return changed


def with_coulomb_alone(unit: Unit) -> Unit:
    """The same axis with friction that does not rise towards rest: its static friction is Coulomb's."""
    changed = unit.model_copy(deep=True)
    for branch in (changed.friction.forward, changed.friction.reverse):
        branch.static = branch.coulomb
    return changed


def with_delay(unit: Unit, delay: float) -> Unit:
    """The same axis with another delay of its drive (s)."""
    changed = unit.model_copy(deep=True)
    changed.drive.delay = delay
    return changed


def with_torque(unit: Unit, torque: float) -> Unit:
    """The same axis with another largest torque of its drive (N·m)."""
    changed = unit.model_copy(deep=True)
    changed.drive.current_limit = torque / unit.drive.torque_constant
    return changed


def with_bulk_modulus(unit: Unit, modulus: float) -> Unit:
    """The same axis with another effective bulk modulus (Pa)."""
    changed = unit.model_copy(deep=True)
    changed.oil.bulk_modulus = modulus
    return changed


def split_poles(model: TransferFunction) -> tuple[complex, float]:
    """The complex pair's upper pole and the real one; of three real ones the two fastest are the pair.

    Examples
    --------
    >>> pair, single = split_poles(LOW)
    >>> round(pair.real, 1), round(pair.imag, 1), round(single)
    (-44.5, 98.3, -56)
    """
    poles = model.poles
    if np.any(np.abs(poles.imag) > 1e-6):
        return complex(poles[poles.imag > 1e-6][0]), float(poles[np.abs(poles.imag) <= 1e-6][0].real)
    real = np.sort(poles.real)
    return complex(real[0]), float(real[2])


def region_rows(region: Region, found: Response, late: Response, why: str, note: str = "") -> list[Row]:
    """Delay, bandwidth and poles of one region beside the thesis's; `late` has its drive's delay at 8 ms."""
    pair, single = split_poles(found.model)
    where, wanted = f"6.4, {region.equation}", region.pair
    own = found.model.bandwidth_hz()
    delay = (
        "The plant's delay is the drive's 1 ms and what a third-order model cannot follow; nothing in "
        "the thesis's equations of the actuator delays by 9 ms more. With the drive's delay at "
        f"{1e3 * _LATE:.0f} ms the same fit finds {1e3 * late.model.delay:.0f} ms. The thesis fitted no "
        "delay: both its models carry the 10 ms of Table 6.1."
    )
    return [
        Row(f"{region.name}: bandwidth, model", where, region.bandwidth, own, "Hz", why=why),
        Row(
            f"{region.name}: bandwidth, ETFE", where, region.bandwidth, found.empirical_bandwidth, "Hz",
            why=why,
        ),
        Row(f"{region.name}: pole pair, real part", where, wanted.real, pair.real, "1/s", why=why, note=note),
        Row(f"{region.name}: pole pair, imaginary part", where, wanted.imag, pair.imag, "1/s", why=why),
        Row(f"{region.name}: third pole", where, region.single, single, "1/s", why=why),
        Row(f"{region.name}: delay", where, 10.0, 1e3 * found.model.delay, "ms", tolerance=1.0, why=delay),
    ]  # fmt: skip


def response_cells(label: str, found: Response) -> tuple[str, ...]:
    """One line of the table of models, of the plant."""
    own = f"{found.empirical_bandwidth:.1f} Hz"
    return model_cells(label, found.model, found.fit, found.sines_bandwidth, own)


def model_cells(
    label: str, model: TransferFunction, fit: float | None, sines: float, empirical: str = ""
) -> tuple[str, ...]:
    """One line of the table of models."""
    pair, single = split_poles(model)
    both = f"{pair.real:.1f} ± {abs(pair.imag):.1f}i" if pair.imag else f"{pair.real:.1f}"
    return (
        label,
        both,
        f"{single:.1f}",
        f"{1e3 * model.delay:.0f} ms",
        f"{model.bandwidth_hz():.1f} Hz",
        empirical,
        "" if np.isnan(sines) else f"{sines:.1f} Hz",
        "" if fit is None else f"{100 * fit:.0f} %",
    )


HEADS = (
    "case",
    "pole pair (1/s)",
    "third pole (1/s)",
    "delay",
    "-3 dB, model",
    "-3 dB, ETFE",
    "-3 dB, single sines",
    "explained",
)
"""Heads over `model_cells`."""


def response_picture(region: Region, found: Response, caption: str) -> Picture:
    """Magnitude and phase beside the thesis's model."""

    def draw(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        fine = np.geomspace(0.5, 80.0, 400)
        shown = (found.frequency > 0.5) & (found.frequency < 80.0)
        for axes, part in ((upper, decibel), (lower, degrees)):
            axes.semilogx(
                found.frequency[shown], part(found.empirical[shown]), color="0.65", label="plant, ETFE"
            )
            axes.semilogx(fine, part(found.model.at(fine) / found.gain), label="plant, output-error model")
            axes.semilogx(
                SINES, part(found.sines), "C3o", markersize=4, label="plant, single sines of ±1.5 V"
            )
            axes.semilogx(
                fine, part(region.thesis.at(fine) / found.gain), "k--", label=f"thesis, {region.equation}"
            )
            axes.axvline(region.bandwidth, color="k", linewidth=0.8, linestyle=":")
        upper.annotate(
            f"{region.bandwidth:.1f} Hz", (region.bandwidth, 0.0), (region.bandwidth * 1.04, 4.0), fontsize=9
        )
        upper.axhline(-3.01, color="k", linewidth=0.8, linestyle=":")
        upper.set(ylabel="magnitude over Dp/A (dB)", ylim=(-25.0, 8.0))
        lower.set(ylabel="phase (°)", xlabel="frequency (Hz)", ylim=(-360.0, 20.0))
        upper.legend(fontsize=8, loc="lower left")

    name = "whole_eha_" + region.name.replace(" ", "_")
    return Picture(name, caption, draw, height=5.8)


def measure_low(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Low speed: about rest, where the friction of reversal decides."""
    found = respond(axis_a, LOW_SPEED, seed)
    shares = (0.3, 0.1)
    freed = {share: respond(with_friction(axis_a, share), LOW_SPEED, seed) for share in shares}
    pressure = VOLT * AMPLITUDE * axis_a.pump.displacement * axis_a.oil.bulk_modulus
    pressure /= 0.5 * axis_a.cylinder.volume_1 * 2.0 * np.pi * 16.8
    force = pressure * axis_a.cylinder.area_1
    light = freed[0.1]
    late = respond(with_delay(axis_a, _LATE), LOW_SPEED, seed)
    coulomb = respond(with_coulomb_alone(axis_a), LOW_SPEED, seed)
    carrying = respond(axis_a, LOW_SPEED, seed, partner=riding_partner(axis_b))
    least = min(axis_a.friction.forward.coulomb, axis_a.friction.reverse.coulomb)
    why = (
        f"±1.5 V at 16.8 Hz moves so little oil that it builds ±{force:.0f} N against a stuck piston, whose "
        f"friction on reversal (Table 5.1) is about 450 N, and {least:.0f} N of it Coulomb's at any speed "
        "(Table 5.2): the thesis's bandwidth, bulk modulus and friction exclude each other. With a tenth of "
        f"the friction the -3 dB point moves to {light.model.bandwidth_hz():.1f} Hz by the model and "
        f"{light.sines_bandwidth:.1f} Hz by sines."
    )
    cases = {
        "plant": found,
        **{f"plant, {100 * share:.0f} % of its dry friction": r for share, r in freed.items()},
        "plant, friction that does not rise towards rest": coulomb,
        "plant, bristles three times as stiff": respond(
            axis_a, LOW_SPEED, seed, details=Details(bristle_stiffness=3.0 * Details().bristle_stiffness)
        ),
        f"plant, its drive limited to {STALL_TORQUE:g} N·m": respond(
            with_torque(axis_a, STALL_TORQUE), LOW_SPEED, seed
        ),
        f"plant, its drive {1e3 * _LATE:.0f} ms late": late,
        "plant, axis B riding along, by-pass and throttle open": carrying,
    }
    cells = [model_cells("thesis, eq. 6.12", LOW, None, float("nan"))]
    cells += [response_cells(name, r) for name, r in cases.items()]
    return Finding(
        "Whole actuator, low speed",
        "Section 6.4 plays the signal of the servomotor's test about zero, without load, and fits a "
        "third-order output-error model with a delay to the actuator's velocity. Here the same, 12.5 s, "
        "axis A, and the ETFE through a Hamming window of 128 points as in section 6.2; beside it, single "
        "sines of ±1.5 V at sixteen frequencies, whose fundamental needs no model.",
        region_rows(LOW_SPEED, found, late, why),
        tables=[Table("The model with one thing changed at a time", HEADS, cells)],
        remarks=[
            "About rest the plant has no transfer function: what it answers depends on how large the "
            f"signal is against the friction. A linear model explains {100 * found.fit:.0f} % of the "
            "velocity, and its poles are those of the best straight line through a stuck and a sliding "
            "piston; its -3 dB point is against its own gain at rest, which lies "
            f"{-20.0 * np.log10(abs(found.model.gain) / found.gain):.0f} dB below Dp/A: most of what it "
            "describes is a stuck piston on its bending seals, as the sines from 2 Hz on show. The "
            "thesis reports the same state: no motion beyond 45 Hz in its figure 6.21, because the actuator "
            "cannot overcome its static friction there.",
            "Axis B's cylinder on the same rod makes this worse, not better: its seals' friction comes on "
            f"top, and sines of ±1.5 V fall to -3 dB at {carrying.sines_bandwidth:.1f} Hz.",
            "Eqs 6.14 and 6.15 in the thesis's review swap the names of the two models.",
        ],
        pictures=[
            response_picture(LOW_SPEED, found, "Low speed: velocity over demanded speed, as figure 6.20.")
        ],
    )


def measure_high(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """High speed: about 95 mm/s, where the piston never reverses."""
    found = respond(axis_a, HIGH_SPEED, seed)
    pair = HIGH_SPEED.pair
    natural = abs(pair)
    own = 2.0 * np.pi * from_profile(axis_a, 0.0).natural_hz
    softer = 4.0e7
    soft = respond(with_bulk_modulus(axis_a, softer), HIGH_SPEED, seed)
    soft_pair, _ = split_poles(soft.model)
    riding = {
        name: respond(a, HIGH_SPEED, seed, partner=riding_partner(b, throttle=throttle))
        for name, a, b, throttle in (
            ("its by-pass and throttle open", axis_a, axis_b, True),
            ("its by-pass open", axis_a, axis_b, False),
            (
                f"by-pass and throttle open, both axes {_AIRY / 1e6:.0f} MPa",
                with_bulk_modulus(axis_a, _AIRY), with_bulk_modulus(axis_b, _AIRY), True,
            ),
        )
    }  # fmt: skip
    heavy_unit = axis_a.model_copy(deep=True)
    heavy_unit.cylinder.moving_mass += axis_b.cylinder.moving_mass
    heavy = respond(heavy_unit, HIGH_SPEED, seed)
    late = respond(with_delay(axis_a, _LATE), HIGH_SPEED, seed)
    carried = riding["its by-pass and throttle open"]
    carried_pair, _ = split_poles(carried.model)
    why = (
        f"The thesis contradicts itself: its eq. 5.23 has its resonance at {own / (2 * np.pi):.1f} Hz "
        f"whatever the damping, eq. 6.13 at {natural / (2 * np.pi):.1f} Hz, as if β were "
        f"{2.1e8 * (natural / own) ** 2 / 1e6:.0f} MPa. With {softer / 1e6:.0f} MPa the plant's model "
        f"falls to {soft.model.bandwidth_hz():.1f} Hz. With axis B's cylinder riding along on the rod, its "
        f"by-pass and throttle open, it is {carried.model.bandwidth_hz():.1f} Hz. See below."
    )
    note = (
        "Not a test: the seals' resistance to quick changes of velocity, "
        f"{Details().seal_damping:.0f} N·s/m, was chosen so that the pair decays as the thesis's does, "
        f"which says nothing of β: 2·M·50.9 1/s = {2.0 * axis_a.cylinder.moving_mass * 50.9:.0f} N·s/m."
    )
    cases = {
        "plant": found,
        f"plant, bulk modulus {softer / 1e6:.0f} MPa": soft,
        "plant, twice the mass on its rod": heavy,
        f"plant, its drive limited to {STALL_TORQUE:g} N·m": respond(
            with_torque(axis_a, STALL_TORQUE), HIGH_SPEED, seed
        ),
        f"plant, its drive {1e3 * _LATE:.0f} ms late": late,
        "plant, seals' resistance to quick changes 500 N·s/m": respond(
            axis_a, HIGH_SPEED, seed, details=Details(seal_damping=500.0)
        ),
        **{f"plant, axis B riding along, {name}": r for name, r in riding.items()},
    }
    cells = [model_cells("thesis, eq. 6.13", HIGH, None, float("nan"))]
    cells += [response_cells(name, r) for name, r in cases.items()]
    return Finding(
        "Whole actuator, high speed",
        "As at low speed, about a mean of 8.375 V (95 mm/s), which the stroke allows for 2.75 s; here "
        "2.2 s after the piston has come to speed.",
        region_rows(HIGH_SPEED, found, late, why, note),
        tables=[Table("The model with one thing changed at a time", HEADS, cells)],
        remarks=[
            "Without reversals the plant is as good as linear: the model explains "
            f"{100 * found.fit:.0f} % of the velocity, and sines, ETFE and model agree. As in the thesis the "
            "bandwidth rises from the low to the high speed, and for the thesis's reason, friction.",
            "Chapter 6 does not say what axis B does meanwhile; in section 5.2 both cylinders are coupled. "
            "If B's cylinder rides along, its pump held and its oil going round through by-pass and "
            "throttle, both fully open, the plant's -3 dB point is at "
            f"{carried.model.bandwidth_hz():.1f} Hz by the model and {carried.sines_bandwidth:.1f} Hz by "
            "sines, where the thesis has 27.0 Hz. It is the valves' drop that damps: the second mass alone "
            f"gives {heavy.model.bandwidth_hz():.1f} Hz. This is a candidate, no proof: the pole pair stays "
            f"at {abs(carried_pair) / (2 * np.pi):.1f} Hz where eq. 6.13 has {natural / (2 * np.pi):.1f}, "
            "and the openings decide (by-pass alone: "
            f"{riding['its by-pass open'].model.bandwidth_hz():.1f} Hz), which the thesis does not give; the "
            "throttle's size is an assumption. The rows above therefore keep axis A alone.",
            f"No single bulk modulus gives all of eq. 6.13: with {softer / 1e6:.0f} MPa the bandwidth is "
            f"near the thesis's, but the pole pair is at {abs(soft_pair) / (2 * np.pi):.1f} Hz where eq. "
            f"6.13 has {natural / (2 * np.pi):.1f} Hz. Section 5.4 did not measure the bulk modulus but "
            "took it from an earlier rig.",
        ],
        pictures=[
            response_picture(HIGH_SPEED, found, "High speed: velocity over demanded speed, as figure 6.28.")
        ],
    )
