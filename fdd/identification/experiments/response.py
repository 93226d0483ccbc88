"""Frequency response of one's own log: Welch, ETFE, and ARX, ARMAX, output-error and Box-Jenkins models.

Thesis 6.1 to 6.4, with what it leaves to the eye: coherence, confidence, and a half of the log that no
model has seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2

from fdd.identification.experiments import etfe as empirical
from fdd.identification.experiments.etfe import half_power_frequency
from fdd.identification.experiments.hydraulic import from_profile
from fdd.identification.experiments.outcome import NORMAL_95, Outcome, Told, axes, curve_line
from fdd.identification.experiments.polynomial import STRUCTURES, Model, Series, best_model, find_delay
from fdd.identification.experiments.spectra import Spectra, halves, stretches, welch
from fdd.identification.record import Record
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

Array = NDArray[np.float64]

RATE = 8.0
"""Samples per period of the profile's natural frequency: enough for twice that frequency, and no more."""
ORDERS = (1, 2, 3, 4)
LONGEST_DELAY = 0.02
"""s."""
COHERENT = 0.6
"""Squared coherence from which the response counts as told."""
SEEN = 0.3
"""Squared coherence from which points set the plots' ranges."""
ALIKE = 0.01
"""Of the output's variance: of models whose fits are closer the one of fewest poles is taken, then by BIC."""
LAGS = 20
STANDING = 0.05
"""Of the time at less than a twentieth of the usual speed: then friction on reversal is in the response."""
LEAST_FIT = 0.5
"""Of the held-out variance that a model must simulate."""
UNITS = {"rate": "m/rad", "position": "m/rad", "pressure_difference": "Pa*s/rad"}
NAMES = {"pump_speed": "pump speed", "command": "command", "rate": "velocity", "position": "position",
         "pressure_difference": "pressure difference"}  # fmt: skip


@dataclass(frozen=True)
class Tested:
    """A model, the share of the held-out variance that it simulates, and the whiteness of its errors."""

    model: Model
    fit: float
    p_white: float
    worst: float


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
    records : logs. unit : profile, whose natural frequency sets the grid and is compared with.
    given : pump_speed or command. caused : rate, position or pressure_difference.
    order : poles of all models; by default 1 to 4, by BIC.
    window_s : s, of Welch's windows; the ETFE is smoothed over 2/window_s, which resolves as much.

    Raises
    ------
    InputError : as `stretches`.
    """
    natural = from_profile(unit, 0.0).natural_hz
    series, period = stretches(records, given, caused, RATE * natural)
    out = Outcome("frequency-response", f"Frequency response, {NAMES[given]} to {NAMES[caused]}")
    spectra = welch(series, period, window_s)
    whole = stretches(records, given, caused, RATE * natural, empirical.LONGEST)[0]
    by_transform = empirical.etfe([whole, series], period, 2.0 / window_s)
    out.notes.append(by_transform.why)
    measured = {"Welch": spectra, "ETFE": by_transform.spectra}
    fitting, held_out = halves(series)
    delay = find_delay(fitting, round(LONGEST_DELAY / period))
    orders = ORDERS if order is None else (order,)
    tested = [_test(best_model(fitting, period, s, orders, delay), held_out) for s in STRUCTURES]
    close = [t for t in tested if t.fit > max(t.fit for t in tested) - ALIKE]
    best = min(close, key=lambda t: (t.model.order, t.model.bic))
    if best.fit < LEAST_FIT or np.isnan(_told_up_to(spectra)):
        out.not_told.append(
            f"The response: the best model simulates {100 * max(best.fit, 0.0):.0f} % of the held-out half, "
            "and a linear model says little of this log. Record a chirp or binary noise about a constant "
            "speed."
        )
    else:
        hydraulic = given == "pump_speed" and caused != "pressure_difference"
        _tell(out, best, held_out, natural if hydraulic else None, UNITS[caused])
        _judge(out, series, best, spectra, records)
    if caused == "position":
        out.notes.append(
            "Models and gain are of the velocity; position is its integral, a pole at zero more."
        )
    out.heads = ("curve", "order", "delay", "fit", "errors", "BIC", "gain", "-3 dB", "poles")
    preferred = "ETFE" if by_transform.trusted else "Welch"
    for name, found in measured.items():
        cells = _bandwidth(out, name, found, UNITS[caused])
        out.rows.append((name + (" (trusted)" if name == preferred else ""), *("–" * 5), *cells, "–"))
    out.rows += [_row(t, best, UNITS[caused], spectra.frequency) for t in tested]
    _draw(out, measured, tested, best, natural, NAMES[caused], integrate=caused == "position")
    out.curves["etfe"] |= {"input": by_transform.given, "trusted": by_transform.trusted}
    out.curves["measured"]["trusted"] = not by_transform.trusted
    return out


def _test(model: Model, held_out: list[Series]) -> Tested:
    left = [(s.caused - model.simulate(s.given))[s.used] for s in held_out]
    errors = [np.where(s.used, model.errors(s), np.nan) for s in held_out]
    rho, pairs = masked_autocorrelation(errors, LAGS)
    whole = np.concatenate([s.caused[s.used] for s in held_out])
    fit = 1.0 - float(np.var(np.concatenate(left)) / np.var(whole))
    return Tested(model, fit, float(chi2.sf(np.sum(rho**2 * pairs), LAGS)), float(np.max(np.abs(rho))))


def _told_up_to(spectra: Spectra) -> float:
    """Highest frequency (Hz) with coherence about it; NaN for none."""
    smooth = np.convolve(spectra.coherence, np.full(3, 1.0 / 3.0), mode="same")
    good = np.flatnonzero(smooth > COHERENT)
    return float(spectra.frequency[good[-1]]) if good.size else float("nan")


def _tell(out: Outcome, best: Tested, held_out: list[Series], natural: float | None, unit: str) -> None:
    """Gain and poles; `natural` is the profile's hydraulic frequency, where it is comparable."""
    facts, stds, n = best.model.facts(), best.model.facts_std(), best.model.order
    out.tell("gain at rest", facts[0], stds[0], unit)
    hz, zeta = facts[1 : n + 1], facts[n + 1 :]
    hz_std, zeta_std = stds[1 : n + 1], stds[n + 1 :]
    pairs = [k for k in range(n - 1) if zeta[k] < 1.0 and np.isclose(hz[k], hz[k + 1])]
    seen = [k for k in pairs if explained_about(best.model, held_out, hz[k]) > 0.5]
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
        "holds about that frequency."
        for k in pairs
        if k not in seen
    ]
    if natural is not None and not seen:
        out.not_told.append(f"The hydraulic natural frequency, {natural:.3g} Hz by the profile.")


def explained_about(model: Model, series: list[Series], hz: float) -> float:
    """Share of the output's variance within half an octave either side of `hz` that the model simulates."""
    top = 0.5 / model.period
    edges = [min(hz / np.sqrt(2.0), 0.6 * top), min(hz * np.sqrt(2.0), 0.95 * top)]
    band = butter(2, edges, "bandpass", fs=1.0 / model.period, output="sos")
    whole = left = 0.0
    for s in series:
        whole += float(np.sum(sosfiltfilt(band, s.caused)[s.used] ** 2))
        left += float(np.sum(sosfiltfilt(band, s.caused - model.simulate(s.given))[s.used] ** 2))
    return 1.0 - left / whole


def _judge(out: Outcome, series: list[Series], best: Tested, spectra: Spectra, records: list[Record]) -> None:
    speed = np.abs(np.concatenate([r.speeds(0.02)[0] for r in records]))
    standing = float(np.mean(speed < 0.05 * np.quantile(speed, 0.9)))
    highest = _told_up_to(spectra)
    if highest < 0.9 * spectra.frequency[-1]:
        out.not_told.append(
            f"The response above {highest:.3g} Hz: the squared coherence of input and output is below "
            f"{COHERENT}."
        )
    if best.p_white < 0.01:
        out.notes.append(
            f"The {best.model.structure} model's errors are not white (autocorrelation up to "
            f"{best.worst:.2f}): something is left that a linear model of this order does not say. The "
            "intervals allow for it."
        )
    if standing > STANDING:
        out.notes.append(
            f"The piston hardly moves in {100 * standing:.0f} % of the time: then its friction is in the "
            "response. A test signal about a constant speed leaves it out."
        )
    seconds = sum(s.given.size for s in series) * best.model.period
    out.notes.append(
        f"{seconds:.0f} s with the strongest input, every {1e3 * best.model.period:.3g} ms; every other "
        f"eighth of a stretch is fitted, the rest held out. Orders by BIC."
    )


def _bandwidth(out: Outcome, name: str, found: Spectra, unit: str) -> tuple[str, str]:
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
    shown = Told("", level, level, level, unit).shown()
    if np.isnan(high) or above.size == 0:
        out.not_told.append(
            f"-3 dB bandwidth by {name}: up to {f[-1]:.3g} Hz, the last with coherence, the response does "
            "not surely fall 3 dB below its lowest octave's."
        )
        return f"{shown[0]} {shown[2]}", "–" if np.isnan(value) else f"{value:.3g} Hz?"
    note = f"below the level at {f[0]:.2g} Hz"
    out.told.append(Told(f"-3 dB bandwidth by {name}", value, float(above[-1]), high, "Hz", note))
    return f"{shown[0]} {shown[2]}", f"{value:.3g} Hz"


def _row(t: Tested, best: Tested, unit: str, frequency: Array) -> tuple[str, ...]:
    m = t.model
    fine = np.linspace(0.0, frequency[-1], 4000)
    facts = m.facts()
    corner = half_power_frequency(fine, np.abs(m.at(fine)), abs(facts[0]))
    gain = Told.normal("", facts[0], m.facts_std()[0], unit).shown()
    # Natural frequencies and damping, pairs once.
    poles = dict.fromkeys(zip(facts[1 : m.order + 1].round(2), facts[m.order + 1 :].round(3), strict=True))
    said = (
        "none" if np.isnan(hz) else f"{hz:.3g} Hz" + (f" (ζ {zeta:.2g})" if zeta < 1.0 else "")
        for hz, zeta in poles
    )
    return (
        m.structure + (" (chosen)" if t is best else ""), str(m.order), f"{1e3 * m.delay * m.period:.3g} ms",
        f"{100 * t.fit:.1f} %", "white" if t.p_white >= 0.01 else f"ρ to {t.worst:.2f}", f"{m.bic:.0f}",
        f"{gain[0]} {gain[2]}", "–" if np.isnan(corner) else f"{corner:.3g} Hz", ", ".join(said),
    )  # fmt: skip


def _draw(
    out: Outcome, measured: dict[str, Spectra], tested: list[Tested], best: Tested, natural: float,
    name: str, *, integrate: bool,
) -> None:  # fmt: skip
    magnitude: list[tr.Trace] = []
    angle: list[tr.Trace] = []
    coherence: list[tr.Trace] = []
    f = measured["Welch"].frequency
    fine = np.geomspace(f[0], f[-1], 300)
    drawn: list[tuple[str, str, str, str, Spectra | None, Array, NDArray[np.complex128]]] = [
        (label, key, colour, "solid", measured[label], measured[label].frequency, measured[label].response)
        for label, key, colour in (("Welch", "measured", tr.BLUE), ("ETFE", "etfe", tr.GREY))
    ]
    for t, colour in zip(tested, tr.LINE_COLOURS[1:], strict=False):
        label, dash = t.model.structure, "solid" if t is best else "dot"
        drawn.append((label, label, colour, dash, None, fine, t.model.at(fine)))
    for label, key, colour, dash, spectra, at, response in drawn:
        divisor = 2j * np.pi * at if integrate else np.ones_like(at)
        response = response / divisor
        size, phase = np.abs(response), degrees(response)
        if "measured" in out.curves and at.size:
            phase += _turns(at, phase, out.curves["measured"])
        out.curves[key] = {"frequency_hz": at, "magnitude": size, "phase_deg": phase}
        if spectra is not None:
            radius = spectra.radius / np.abs(divisor)
            low, high = np.maximum(size - radius, 0.1 * size), size + radius
            spread = np.degrees(np.arcsin(np.minimum(radius / np.maximum(size, 1e-300), 1.0)))
            magnitude.append(tr.band(at, decibel(low), decibel(high), "", colour))
            angle.append(tr.band(at, phase - spread, phase + spread, "", colour))
            coherence.append(curve_line(at, spectra.coherence, label, colour))
            least = np.maximum(size - radius, 0.0)
            out.curves[key] |= {
                "magnitude_low": least, "magnitude_high": high, "coherence": spectra.coherence,
            }  # fmt: skip
        magnitude.append(curve_line(at, decibel(response), label, colour, dash))
        angle.append(curve_line(at, phase, label, colour, dash))
    welched = out.curves["measured"]
    mark = {"type": "line", "xref": "x", "yref": "paper", "x0": natural, "x1": natural, "y0": 0, "y1": 1,
            "line": {"width": 1, "dash": "dot"}, "name": tr.MARK}  # fmt: skip
    layout = axes("frequency (Hz)", type="log") | {"shapes": [mark]}
    coherent = welched["coherence"] > SEEN
    seen = coherent if np.any(coherent) else np.ones(f.size, dtype=bool)

    def reach(values: Array, margin: float) -> dict[str, Any]:
        ends = float(values[seen].min() - margin), float(values[seen].max() + margin)
        return layout | {"yaxis": {"range": list(ends)}}

    note = (
        f"shaded: 95 % of Welch and ETFE; dotted upright: the profile's natural frequency, {natural:.3g} Hz"
    )
    level = reach(decibel(welched["magnitude"]), 10.0)
    out.figures = [
        Figure("magnitude", f"Magnitude of {name}", magnitude, level, "dB", note, 340, True),
        Figure("phase", "Phase", angle, reach(welched["phase_deg"], 45.0), "°", "", 300, True),
        Figure("coherence", "Squared coherence", coherence, layout | {"yaxis": {"range": [0, 1.02]}}, "",
               "1: all of the output follows from the input", 240, True),
    ]  # fmt: skip


def _turns(frequency: Array, phase: Array, other: dict[str, Any]) -> float:
    """Whole turns (°) that bring a phase next to another curve's at its first frequency."""
    there = np.interp(frequency[0], other["frequency_hz"], other["phase_deg"])
    return 360.0 * float(np.round((there - phase[0]) / 360.0))


def masked_autocorrelation(series: list[Array], lags: int) -> tuple[Array, Array]:
    """Autocorrelation about zero over pairs that are both there.

    Parameters
    ----------
    series : of (n,) each, NaN where a sample is missing.
    lags : 1 to `lags`.

    Returns
    -------
    (lags,) autocorrelations, and (lags,) numbers of pairs; each is about N(0, 1/pairs) when white.

    Examples
    --------
    >>> rho, pairs = masked_autocorrelation([np.array([1.0, -1.0, np.nan, -1.0, 1.0])], 1)
    >>> rho.tolist(), pairs.tolist()
    ([-1.0], [2.0])
    """
    apart = np.full(lags, np.nan)
    y = np.concatenate([part for one in series for part in (one, apart)])
    there = np.isfinite(y)
    filled = np.where(there, y, 0.0)
    products = np.array([filled[:-k] @ filled[k:] for k in range(1, lags + 1)])
    pairs = np.array([np.sum(there[:-k] & there[k:]) for k in range(1, lags + 1)], dtype=np.float64)
    power = float(filled @ filled) / max(int(there.sum()), 1)
    return products / np.maximum(pairs, 1) / max(power, 1e-300), pairs
