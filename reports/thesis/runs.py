"""How the experiments drive the prototype, and responses and models from what it logs.

The thesis commands the pump in volt: ±10 V are ±3000 rpm. Every run starts at rest and is logged whole, at
1 kHz, through the sensors of Appendix A. It divides Fourier transforms (its ETFE), smooths them and fits
continuous transfer functions with a delay by the output-error method (chapter 6); so does this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, chirp, cont2discrete, fftconvolve, lfilter, sosfiltfilt

from fdd.identification.experiments.dynamics import half_power_frequency
from fdd.plant.details import Details
from fdd.plant.duty import Replay
from fdd.plant.rig import Circuit
from fdd.plant.scenario import Control, Partner, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.unit import Unit

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Figures = dict[str, Any]
"""What an experiment measured, by the names that its block of the template has; ``picture`` is its panels."""
Beside = tuple[Unit, Partner]
"""The other axis on the same rod, and what it does."""

PERIOD = 1e-3
"""Sampling interval of the thesis (s), section 6.1."""
VOLT = 31.416
"""Commanded pump speed per volt (rad/s): 3000 rpm at 10 V."""
THOUSAND_RPM = 104.7
"""Pump speed of section 5.2 (rad/s)."""
FIRST_HZ = (20.0, 60.0, 150.0)
"""Hz, up to which a transfer function's first guesses look at the response."""


def run_speed(
    unit: Unit, command: Array, *, start: float = 0.0, partner: Beside | None = None, seed: int = 0,
    details: Details | None = None, control: Control | None = None, **scenario: Any,
) -> Simulation:  # fmt: skip
    """Drive the pump with a commanded speed, without feedback of position.

    `command`: (n,) rad/s, one value a millisecond. `start`: m from mid-stroke. `seed`: draws the trial:
    friction, noise. `scenario`: what else of it.
    """
    whole = Scenario(
        unit=unit.name, duration=command.size * PERIOD, control=control or Control(mode="speed"),
        duty=Replay(values=tuple(command.tolist()), offset=start), partner=partner[1] if partner else None,
        details=details or Details(), recording=Recording.perfect(), seed=seed, **scenario,
    )  # fmt: skip
    return simulate(unit, whole, partner=partner[0] if partner else None)


def run_position(unit: Unit, setpoint: Array, gain: float, **more: Any) -> Simulation:
    """Close the position loop of section 7.2, `gain` in (rad/s)/m, around the pump; set-point (n,) in m."""
    return run_speed(unit, setpoint, control=Control(mode="position", gain=gain), **more)


def throttled_partner(unit: Unit, partner: Unit, pressure: float) -> Beside:
    """The other axis, its pump shut off, pushing its oil through its throttle (figure 5.2), over which are
    `pressure` (Pa) while the driving pump turns at 100 rad/s without leakage.

    It closes from fully open within two seconds: against a closed one the piston's start would overshoot and
    open the relief valve, which shuts again only below the pressures of section 5.2.
    """
    flow = 100.0 * unit.pump.displacement * partner.cylinder.area_1 / unit.cylinder.area_1
    opening = flow / (Circuit().throttle_flow * math.sqrt(1e-6 * pressure))
    circuit = Circuit.model_validate({"blocked": True, "throttle": f"0:1/2:{opening:.6g}"})
    return partner, Partner(unit=partner.name, drive="still", circuit=circuit)


def riding_partner(partner: Unit, *, throttle: bool = True) -> Beside:
    """The other axis carried along, its pump held, its oil free to go round by its by-pass (and throttle)."""
    circuit = Circuit.model_validate({"bypass": 1, "throttle": int(throttle)})
    return partner, Partner(unit=partner.name, drive="still", circuit=circuit)


def both_pumps(unit: Unit, partner: Unit) -> Unit:
    """One cylinder driven by both axes' pumps in parallel, as for the friction tests of section 5.3: flows
    add, and so do the torques and inertias on what counts here as one shaft. The dual rig with open connect
    valves would carry the other cylinder, and its seals, along."""
    together = unit.model_copy(deep=True)
    for part, names in (
        ("pump", ("displacement", "cross_port_leakage", "case_leakage")),
        ("drive", ("inertia", "viscous_friction", "current_limit")),
    ):
        mine, other = getattr(together, part), getattr(partner, part)
        for name in names:
            setattr(mine, name, getattr(mine, name) + getattr(other, name))
    return together


def changed(unit: Unit, part: str, **values: float) -> Unit:
    """The same axis with other values in one part of its profile: ``changed(unit, "drive", delay=0.01)``."""
    out = unit.model_copy(deep=True)
    for name, value in values.items():
        setattr(getattr(out, part), name, value)
    return out


def with_friction(unit: Unit, share: float = 1.0, *, rises: bool = True) -> Unit:
    """The same axis with a share of its dry friction, which `rises` towards rest or is Coulomb's alone."""
    out = unit.model_copy(deep=True)
    for branch in (out.friction.forward, out.friction.reverse):
        branch.coulomb *= share
        branch.static = share * branch.static if rises else branch.coulomb
    return out


def with_leakage(unit: Unit, pump: Unit, share: float = 1.0) -> Unit:
    """The same axis with a share of the leakage of a pump, its own or another one."""
    cross, case = pump.pump.cross_port_leakage, pump.pump.case_leakage
    return changed(unit, "pump", cross_port_leakage=share * cross, case_leakage=share * case)


def with_torque(unit: Unit, torque: float) -> Unit:
    """The same axis with another largest torque of its drive (N·m)."""
    return changed(unit, "drive", current_limit=torque / unit.drive.torque_constant)


def hydraulic_gain(unit: Unit) -> float:
    """Dp/A (m/rad)."""
    return unit.pump.displacement / unit.cylinder.area_1


def holding_leakage(unit: Unit) -> float:
    """ξ + C_ep (m³/(s·Pa)): what the pump makes up under pressure while the low side is refed (mode 2)."""
    return unit.pump.cross_port_leakage + unit.pump.case_leakage


def binary_noise(seconds: float, switching_hz: float, seed: int) -> Array:
    """Pseudo-random ±1 that may change `switching_hz` times a second, (n,)."""
    which = np.floor(np.arange(round(seconds / PERIOD)) * PERIOD * switching_hz + 1e-9).astype(np.int64)
    bits = np.random.default_rng(seed).integers(0, 2, int(which[-1]) + 1) * 2.0 - 1.0
    return np.asarray(bits[which])


def identification_volts(seconds: float, seed: int, high_hz: float = 150.0) -> Array:
    """Section 6.2's signal: a chirp of ±1.5 V from 0.1 to 150 Hz with binary noise of ±0.25 V at 450 Hz."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return 1.5 * chirp(time, 0.1, seconds, high_hz, phi=-90) + 0.25 * binary_noise(seconds, 450.0, seed)


@dataclass(frozen=True)
class TransferFunction:
    """``exp(-delay·s)·numerator(s)/denominator(s)``, highest power first, s in 1/s."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float

    @property
    def poles(self) -> ComplexArray:
        """1/s, slowest first."""
        roots = np.roots(self.denominator).astype(np.complex128)
        return roots[np.lexsort((roots.imag, np.abs(roots)))]

    @property
    def gain(self) -> float:
        """At rest."""
        return self.numerator[-1] / self.denominator[-1]

    def at(self, frequency: float | Array) -> ComplexArray:
        """Response at `frequency` (…) in Hz, (…)."""
        s = 2j * np.pi * np.asarray(frequency, dtype=np.float64)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay * s), dtype=np.complex128)

    def bandwidth_hz(self) -> float:
        """Lowest frequency (Hz) at which the response has fallen 3 dB below that at rest."""
        frequency = np.linspace(0.0, 500.0, 20_001)
        return half_power_frequency(frequency, np.abs(self.at(frequency)), abs(self.gain))

    def simulate(self, given: Array) -> Array:
        """Response, (n,), to an input that runs straight from sample to sample, from rest."""
        top, bottom, _ = cont2discrete((self.numerator, self.denominator), PERIOD, method="foh")
        late = round(self.delay / PERIOD)
        held = np.concatenate([np.zeros(late), given[: given.size - late]])
        return np.asarray(lfilter(np.ravel(top), bottom, held))


def empirical_response(given: Array, caused: Array, width_hz: float = 2.0) -> tuple[Array, ComplexArray]:
    """The thesis's estimate (ETFE): output's transform over input's, smoothed by a Hamming window.

    Cross and own spectrum of input and output (n,) are averaged over the window before the division (Ljung,
    System Identification, 2nd ed., eq. 6.46). Gives frequency (Hz) and response, (n // 2 + 1,) each.
    """
    u, y = np.fft.rfft(given - given.mean()), np.fft.rfft(caused - caused.mean())
    window = np.hamming(max(round(width_hz * given.size * PERIOD), 1) | 1)
    powers = np.array([u, y]) * np.conj(u)
    own, cross = np.asarray(fftconvolve(powers, window[None, :], mode="same", axes=1), dtype=np.complex128)
    frequency = np.asarray(np.fft.rfftfreq(given.size, PERIOD), dtype=np.float64)
    return frequency, np.asarray(cross / np.maximum(own.real, 1e-12 * own.real.max()))


def velocity(position: Array, cutoff_hz: float = 150.0) -> Array:
    """Velocity (n,) of a position (m or rad) by central differences (eq. 6.3) and a zero-phase Butterworth
    filter of order 10; the thesis takes 150 Hz (section 6.3)."""
    sections = butter(10, cutoff_hz, fs=1.0 / PERIOD, output="sos")
    return np.asarray(sosfiltfilt(sections, np.gradient(position, PERIOD)))


def held_input(command: Array) -> Array:
    """What `velocity` makes of a command (n,) that is held over each period: the input beside that output.

    Differenced and filtered as the output is, the command's integral differs from it by the system alone. The
    bare command would lay the filter, the differences' fall-off and half a sample of delay to the system.
    """
    return velocity(np.concatenate([[0.0], np.cumsum(command[:-1]) * PERIOD]))


def windowed_response(given: Array, caused: Array) -> tuple[Array, ComplexArray]:
    """Transfer function estimate through a "128 point size Hamming window" (section 6.2): as in the toolbox
    that the thesis used, over so many lags of the correlations to either side, which smooths over some 8 Hz.
    Gives frequency, from 0 to 100 Hz, and response, (401,) each."""
    u, y, points = given - given.mean(), caused - caused.mean(), 128
    lags = np.arange(-points, points + 1)
    middle = slice(u.size - 1 - points, u.size + points)
    window = 0.54 + 0.46 * np.cos(np.pi * lags / points)
    own, cross = (window * fftconvolve(signal, u[::-1])[middle] for signal in (u, y))
    frequency = np.linspace(0.0, 100.0, 401)
    turn = np.exp(-2j * np.pi * np.outer(frequency, lags) * PERIOD)
    return frequency, np.asarray((turn @ cross) / (turn @ own), dtype=np.complex128)


def response_at(given: Array, caused: Array, frequency: float) -> complex:
    """Response at one frequency (Hz): ratio of the fundamentals, fitted together with a mean and a trend."""
    time = np.arange(given.size) * PERIOD
    phase = 2.0 * np.pi * frequency * time
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(time), time])
    u, y = (np.linalg.lstsq(basis, signal, rcond=None)[0] for signal in (given, caused))
    return complex((y[0] - 1j * y[1]) / (u[0] - 1j * u[1]))


def fit_output_error(
    given: Array, caused: Array, *, zeros: int, poles: int, delay: float
) -> tuple[TransferFunction, float]:  # fmt: skip
    """Continuous transfer function whose own response to the input comes nearest to the output, and its fit:
    1 for all of the output explained, 0 for no better than the mean.

    `given`, `caused`: (n,) input (see `held_input`) and output, from rest. `delay`: s, a whole number of
    periods. The best of the optima that are found from a first guess by each of `FIRST_HZ`.
    """

    def model(theta: Array) -> TransferFunction:
        # Powers of s/100, which are of one size, back to s in 1/s; poles on the wrong side are turned over.
        scale = 100.0 ** np.arange(poles, -1, -1.0)
        roots = np.roots(np.concatenate([[1.0], theta[:poles]]))
        stable = np.real(np.poly(-np.abs(roots.real) + 1j * roots.imag))
        denominator = stable / scale * scale[0]
        numerator = theta[poles:] / scale[poles - zeros :] * scale[0]
        return TransferFunction(tuple(numerator.tolist()), tuple(denominator.tolist()), delay)

    spread = np.linalg.norm(caused - caused.mean())

    def error(theta: Array) -> Array:
        return np.asarray((model(theta).simulate(given) - caused) / spread)

    starts = (_rational_guess(given, caused, zeros, poles, delay, highest) for highest in FIRST_HZ)
    solved = min((least_squares(error, x, method="lm", x_scale=np.maximum(np.abs(x), 1e-3), max_nfev=300)
                  for x in starts), key=lambda found: found.cost)  # fmt: skip
    return model(solved.x), 1.0 - float(np.linalg.norm(solved.fun))


def _rational_guess(
    given: Array, caused: Array, zeros: int, poles: int, delay: float, highest_hz: float
) -> Array:
    """Denominator below its leading 1, then numerator, in powers of s/100, nearest to the empirical response
    by Sanathanan and Koerner's iteration (doi.org/10.1109/TAC.1963.1105517)."""
    frequency, response = empirical_response(given, caused)
    used = (frequency > 0.2) & (frequency < highest_hz)
    weight = np.abs(np.fft.rfft(given - given.mean()))[used]
    s = 2j * np.pi * frequency[used] / 100.0
    g = response[used] * np.exp(100.0 * s * delay)
    low = s[:, None] ** np.arange(poles - 1, -1, -1.0)
    top = s[:, None] ** np.arange(zeros, -1, -1.0)
    divisor, theta = np.ones_like(s), np.zeros(poles + zeros + 1)
    for _ in range(20):
        w = (weight / np.abs(divisor))[:, None]
        m = np.hstack([g[:, None] * low, -top]) * w
        y = -(g * s**poles)[:, None] * w
        theta = np.linalg.lstsq(np.vstack([m.real, m.imag]), np.vstack([y.real, y.imag]), rcond=None)[0][:, 0]
        divisor = s**poles + low @ theta[:poles]
    return np.asarray(theta)
