"""Frequency response of one's own log: Welch's, and a Box-Jenkins model's (thesis 6.1 to 6.4).

With what the thesis leaves to the eye: coherence, confidence, and a half of the log that no model has seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2

from fdd.identification import Array
from fdd.identification.experiments import NORMAL_95, Outcome, Told, axes, curve_line, dynamics
from fdd.identification.experiments.dynamics import Model, Series, Spectra, half_power_frequency
from fdd.identification.record import Record
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

RATE = 8.0
"""Samples per period of the profile's natural frequency: enough for twice that frequency, and no more."""
ORDERS = (1, 2, 3, 4)
LONGEST_DELAY = 0.02
"""s."""
COHERENT = 0.6
"""Squared coherence from which the response counts as told."""
SEEN = 0.3
"""Squared coherence from which points set the plots' ranges."""
LAGS = 20
STANDING = 0.05
"""Of the time at less than a twentieth of the usual speed: then friction on reversal is in the response."""
LEAST_FIT = 0.5
"""Of the held-out variance that the model must simulate."""
UNITS = {"rate": "m/rad", "position": "m/rad", "pressure_difference": "Pa*s/rad"}
NAMES = {"pump_speed": "pump speed", "command": "command", "rate": "velocity", "position": "position",
         "pressure_difference": "pressure difference"}  # fmt: skip


@dataclass(frozen=True)
class Coefficients:
    """Eq. 5.22 without its integrator: v/ω = numerator / (s² + damping·s + stiffness)."""

    numerator: float
    damping: float
    stiffness: float

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency."""
        return sqrt(self.stiffness) / (2.0 * pi)


def from_profile(unit: Unit, viscous: float) -> Coefficients:
    """Eq. 5.22 with the unit's numbers and friction `viscous` (N·s/m).

    Examples
    --------
    >>> round(from_profile(Unit.load("axis_a"), 0.0).natural_hz, 1)
    55.5
    """
    cylinder = unit.cylinder
    area, mass, leakage = cylinder.area_1, cylinder.moving_mass, unit.pump.total_leakage
    # Each side holds 2 V_o.
    stiffness = unit.oil.bulk_modulus / (0.25 * (cylinder.volume_1 + cylinder.volume_2))
    return Coefficients(
        numerator=area * stiffness * unit.pump.displacement / mass,
        damping=viscous / mass + leakage * stiffness,
        stiffness=(area**2 + leakage * viscous) * stiffness / mass,
    )


def decibel(response: NDArray[np.complex128] | Array) -> Array:
    """Magnitude in dB, at least -180."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(response), 1e-9)))


def degrees(response: NDArray[np.complex128]) -> Array:
    """Phase in degrees, without jumps."""
    return np.asarray(np.degrees(np.unwrap(np.angle(response))))


def frequency_response(
    records: list[Record], unit: Unit, *, given: str = "pump_speed", caused: str = "rate",
    order: int | None = None, window_s: float = 1.0,
) -> Outcome:  # fmt: skip
    """Identify the response of `caused` to `given`.

    Parameters
    ----------
    unit : profile, whose natural frequency sets the grid and is compared with.
    given : pump_speed or command. caused : rate, position or pressure_difference.
    order : poles of the model; by default 1 to 4, by BIC. window_s : s, of Welch's windows.

    Raises InputError: as `dynamics.stretches`.
    """
    natural = from_profile(unit, 0.0).natural_hz
    series, period = dynamics.stretches(records, given, caused, RATE * natural)
    out = Outcome("frequency-response", f"Frequency response, {NAMES[given]} to {NAMES[caused]}")
    spectra = dynamics.welch(series, period, window_s)
    fitting, held_out = dynamics.halves(series)
    delay = dynamics.find_delay(fitting, round(LONGEST_DELAY / period))
    orders = ORDERS if order is None else (order,)
    model = min((dynamics.fit_model(fitting, period, n, delay) for n in orders), key=lambda m: m.bic)
    fit, p_white, worst = _tested(model, held_out)
    # The highest frequency with coherence about it.
    smooth = np.convolve(spectra.coherence, np.full(3, 1.0 / 3.0), mode="same")
    coherent = spectra.frequency[smooth > COHERENT]
    if fit < LEAST_FIT or not coherent.size:
        out.not_told.append(
            f"The response: the best model simulates {100 * max(fit, 0.0):.0f} % of the held-out half, "
            "and a linear model says little of this log. Record a chirp or binary noise about a constant "
            "speed."
        )
    else:
        hydraulic = given == "pump_speed" and caused != "pressure_difference"
        _tell(out, model, held_out, natural if hydraulic else None, UNITS[caused])
        if coherent[-1] < 0.9 * spectra.frequency[-1]:
            out.not_told.append(
                f"The response above {coherent[-1]:.3g} Hz: the squared coherence of input and output is "
                f"below {COHERENT}."
            )
        if p_white < 0.01:
            out.notes.append(
                f"The model's errors are not white (autocorrelation up to {worst:.2f}): something is left "
                "that a linear model of this order does not say. The intervals allow for it."
            )
        speed = np.abs(np.concatenate([r.speeds(0.02)[0] for r in records]))
        standing = float(np.mean(speed < 0.05 * np.quantile(speed, 0.9)))
        if standing > STANDING:
            out.notes.append(
                f"The piston hardly moves in {100 * standing:.0f} % of the time: then its friction is in the "
                "response. A test signal about a constant speed leaves it out."
            )
        seconds = sum(s.given.size for s in series) * period
        out.notes.append(
            f"{seconds:.0f} s with the strongest input, every {1e3 * period:.3g} ms; every other eighth of a "
            "stretch is fitted, the rest held out. Order by BIC."
        )
    if caused == "position":
        out.notes.append("Model and gain are of the velocity; position is its integral, a pole at zero more.")
    out.heads = ("curve", "order", "delay", "fit", "errors", "BIC", "gain", "-3 dB", "poles")
    out.rows = [("Welch", *("–" * 5), *_bandwidth(out, spectra, UNITS[caused]), "–")]
    out.rows.append((
        "Box-Jenkins", str(model.order), f"{1e3 * delay * period:.3g} ms", f"{100 * fit:.1f} %",
        "white" if p_white >= 0.01 else f"ρ to {worst:.2f}", f"{model.bic:.0f}",
        *_facts(model, UNITS[caused], spectra.frequency[-1]),
    ))  # fmt: skip
    _draw(out, spectra, model, natural, NAMES[caused], integrate=caused == "position")
    return out


def _tested(model: Model, held_out: list[Series]) -> tuple[float, float, float]:
    """Share of the held-out variance that the model simulates; p value of white errors, and their largest
    autocorrelation, by pairs of rows that both count, each about N(0, 1/pairs)."""
    left = [(s.caused - model.simulate(s.given))[s.used] for s in held_out]
    apart = np.full(LAGS, np.nan)
    errors = [part for s in held_out for part in (np.where(s.used, model.errors(s), np.nan), apart)]
    there = np.isfinite(y := np.concatenate(errors))
    filled, lags = np.where(there, y, 0.0), range(1, LAGS + 1)
    products = np.array([filled[:-k] @ filled[k:] for k in lags])
    pairs = np.array([np.sum(there[:-k] & there[k:]) for k in lags], dtype=np.float64)
    power = float(filled @ filled) / max(int(there.sum()), 1)
    rho = products / np.maximum(pairs, 1) / max(power, 1e-300)
    whole = np.concatenate([s.caused[s.used] for s in held_out])
    fit = 1.0 - float(np.var(np.concatenate(left)) / np.var(whole))
    return fit, float(chi2.sf(np.sum(rho**2 * pairs), LAGS)), float(np.max(np.abs(rho)))


def _tell(out: Outcome, model: Model, held_out: list[Series], natural: float | None, unit: str) -> None:
    """Gain and poles; `natural` is the profile's hydraulic frequency, where it is comparable."""
    facts, stds, n = model.facts(), model.facts_std(), model.order
    out.tell("gain at rest", facts[0], stds[0], unit)
    hz, zeta = facts[1 : n + 1], facts[n + 1 :]
    hz_std, zeta_std = stds[1 : n + 1], stds[n + 1 :]
    pairs = [k for k in range(n - 1) if zeta[k] < 1.0 and np.isclose(hz[k], hz[k + 1])]
    seen = [k for k in pairs if _explained_about(model, held_out, hz[k]) > 0.5]
    for k in range(n):
        if k in seen:
            off = "" if natural is None else (
                f"profile: hydraulic {natural:.3g} Hz, this is {100.0 * (hz[k] / natural - 1.0):+.1f} % off"
            )  # fmt: skip
            out.tell("natural frequency of a pole pair", hz[k], hz_std[k], "Hz", off)
            out.tell("its damping ratio", zeta[k], zeta_std[k], "1")
        elif k not in pairs and k - 1 not in pairs and hz[k] > 2.0 * NORMAL_95 * hz_std[k]:
            out.tell("corner of a real pole", hz[k], hz_std[k], "Hz")
    out.not_told += [
        f"The pole pair at {hz[k]:.3g} Hz: the model simulates less than half of what the held-out output "
        "holds about that frequency." for k in pairs if k not in seen
    ]  # fmt: skip
    if natural is not None and not seen:
        out.not_told.append(f"The hydraulic natural frequency, {natural:.3g} Hz by the profile.")


def _explained_about(model: Model, series: list[Series], hz: float) -> float:
    """Share of the output's variance within half an octave either side of `hz` that the model simulates."""
    top = 0.5 / model.period
    edges = [min(hz / np.sqrt(2.0), 0.6 * top), min(hz * np.sqrt(2.0), 0.95 * top)]
    band = butter(2, edges, "bandpass", fs=1.0 / model.period, output="sos")
    whole = left = 0.0
    for s in series:
        whole += float(np.sum(sosfiltfilt(band, s.caused)[s.used] ** 2))
        left += float(np.sum(sosfiltfilt(band, s.caused - model.simulate(s.given))[s.used] ** 2))
    return 1.0 - left / whole


def _bandwidth(out: Outcome, found: Spectra, unit: str) -> tuple[str, str]:
    """Level of the lowest octave and -3 dB frequency below it, as text; the latter among the figures too."""
    seen = found.coherence > COHERENT
    if np.count_nonzero(seen) < 3:
        return "–", "–"
    f, size, radius = found.frequency[seen], np.abs(found.response[seen]), found.radius[seen]
    level = float(np.median(size[f <= 2.0 * f[0]]))
    value = half_power_frequency(f, size, level)
    # About this crossing: where the band surely is above before, and surely below after.
    above = f[(f <= value) & (size - radius > level / np.sqrt(2.0))]
    high = half_power_frequency(f, np.where(f < value, level, size + radius), level)
    shown = Told.within("", level, 0.0, unit).shown()
    if np.isnan(high) or above.size == 0:
        out.not_told.append(
            f"-3 dB bandwidth by Welch: up to {f[-1]:.3g} Hz, the last with coherence, the response does "
            "not surely fall 3 dB below its lowest octave's."
        )
        return f"{shown[0]} {shown[2]}", "–" if np.isnan(value) else f"{value:.3g} Hz?"
    note = f"below the level at {f[0]:.2g} Hz"
    out.told.append(Told("-3 dB bandwidth by Welch", value, float(above[-1]), high, "Hz", note))
    return f"{shown[0]} {shown[2]}", f"{value:.3g} Hz"


def _facts(model: Model, unit: str, highest: float) -> tuple[str, str, str]:
    """Gain, -3 dB frequency and poles as text."""
    fine = np.linspace(0.0, highest, 4000)
    facts = model.facts()
    corner = half_power_frequency(fine, np.abs(model.at(fine)), abs(facts[0]))
    gain = Told.within("", facts[0], 0.0, unit).shown()
    # Natural frequencies and damping, pairs once.
    hz, damping = np.split(facts[1:], 2)
    said = (
        "none" if np.isnan(f) else f"{f:.3g} Hz" + (f" (ζ {zeta:.2g})" if zeta < 1.0 else "")
        for f, zeta in dict.fromkeys(zip(hz.round(2), damping.round(3), strict=True))
    )
    return f"{gain[0]} {gain[2]}", "–" if np.isnan(corner) else f"{corner:.3g} Hz", ", ".join(said)


def _draw(
    out: Outcome, measured: Spectra, model: Model, natural: float, name: str, *, integrate: bool
) -> None:
    f = measured.frequency
    fine = np.geomspace(f[0], f[-1], 300)
    drawn = (
        ("measured", "Welch", tr.BLUE, f, measured.response),
        ("BJ", "Box-Jenkins", tr.VERMILLION, fine, model.at(fine)),
    )
    magnitude: list[tr.Trace] = []
    angle: list[tr.Trace] = []
    for key, label, colour, at, response in drawn:
        response = response / (2j * np.pi * at) if integrate else response
        size, phase = np.abs(response), degrees(response)
        band: dict[str, Array] = {}
        if key == "measured":
            radius = measured.radius / np.abs(2j * np.pi * at) if integrate else measured.radius
            low, high = np.maximum(size - radius, 0.1 * size), size + radius
            spread = np.degrees(np.arcsin(np.minimum(radius / np.maximum(size, 1e-300), 1.0)))
            magnitude.append(tr.band(at, decibel(low), decibel(high), "", colour))
            angle.append(tr.band(at, phase - spread, phase + spread, "", colour))
            band = {"magnitude_low": np.maximum(size - radius, 0.0), "magnitude_high": high,
                    "coherence": measured.coherence}  # fmt: skip
        else:  # whole turns bring a model's phase next to the measured one
            there = np.interp(at[0], f, out.curves["measured"]["phase_deg"])
            phase += 360.0 * float(np.round((there - phase[0]) / 360.0))
        out.curves[key] = {"frequency_hz": at, "magnitude": size, "phase_deg": phase, **band}
        magnitude.append(curve_line(at, decibel(response), label, colour))
        angle.append(curve_line(at, phase, label, colour))
    layout = axes("frequency (Hz)", type="log") | {"shapes": [tr.upright(natural, dash="dot")]}
    seen = measured.coherence > SEEN
    seen = seen if np.any(seen) else np.ones(f.size, dtype=bool)

    def reach(values: Array, margin: float) -> dict[str, Any]:
        ends = float(values[seen].min() - margin), float(values[seen].max() + margin)
        return layout | {"yaxis": {"range": list(ends)}}

    note = f"shaded: 95 % of Welch; dotted upright: the profile's natural frequency, {natural:.3g} Hz"
    level = reach(decibel(out.curves["measured"]["magnitude"]), 10.0)
    coherence = [curve_line(f, measured.coherence, "Welch", tr.BLUE)]
    out.figures = [
        Figure("magnitude", f"Magnitude of {name}", magnitude, level, "dB", note, 340, True),
        Figure("phase", "Phase", angle, reach(out.curves["measured"]["phase_deg"], 45.0), "°", "", 300, True),
        Figure("coherence", "Squared coherence", coherence, layout | {"yaxis": {"range": [0, 1.02]}}, "",
               "1: all of the output follows from the input", 240, True),
    ]  # fmt: skip
