"""Frequency response of one's own log by Welch, and the hydraulic resonance in it (thesis 6.1 to 6.4).

With what the thesis leaves to the eye: coherence, and confidence of the response and of what is read from it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.data_sheet.plausibility import resonance
from fdd.identification import Array
from fdd.identification.experiments import Outcome, Told, axes, curve_line
from fdd.identification.experiments.dynamics import (
    COHERENT,
    PolePair,
    Spectra,
    fit_pole_pair,
    half_power_frequency,
    stretches,
    welch,
)
from fdd.identification.record import Record
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

RATE = 8.0
"""Samples per period of the profile's natural frequency: enough for twice that frequency, and no more."""
SEEN = 0.3
"""Squared coherence from which points set the plots' ranges."""
STANDING = 0.05
"""Of the time at less than a twentieth of the usual speed: then friction on reversal is in the response."""
LEAST_POINTS = 8
"""Coherent frequencies that a response needs."""
LEAST_FIT = 0.9
"""Of a pole pair in the response: one that sticks and slips has none."""
SHARP = 0.1
"""Relative standard deviation of a natural frequency up to which it is a figure."""


def decibel(response: NDArray[np.complex128] | Array) -> Array:
    """Magnitude in dB, at least -180."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(response), 1e-9)))


def degrees(response: NDArray[np.complex128]) -> Array:
    """Phase in degrees, without jumps."""
    return np.asarray(np.degrees(np.unwrap(np.angle(response))))


def frequency_response(
    records: list[Record], unit: Unit, *, given: str = "pump_speed", window_s: float = 1.0
) -> Outcome:
    """Estimate the response of the piston's velocity to pump_speed or command, in windows of `window_s`.

    The profile's natural frequency sets the grid and is compared with.

    Raises InputError: as `stretches` and `welch`.
    """
    natural = resonance(unit)
    parts, period = stretches(records, given, RATE * natural)
    out = Outcome("frequency-response", f"Frequency response, {given.replace('_', ' ')} to velocity")
    found = welch(parts, period, window_s)
    # The highest frequency with coherence about it.
    smooth = np.convolve(found.coherence, np.full(3, 1.0 / 3.0), mode="same")
    coherent = found.frequency[smooth > COHERENT]
    poles = None
    if np.count_nonzero(found.coherence > COHERENT) < LEAST_POINTS or not coherent.size:
        out.not_told.append(
            f"The response: the squared coherence of input and output is below {COHERENT}. Record a chirp or "
            "binary noise about a constant speed."
        )
    else:
        _tell_levels(out, found)
        if given == "pump_speed":
            poles = _tell_poles(out, found, natural)
        if coherent[-1] < 0.9 * found.frequency[-1]:
            out.not_told.append(
                f"The response above {coherent[-1]:.3g} Hz: the squared coherence of input and output is "
                f"below {COHERENT}."
            )
        speed = np.abs(np.concatenate([r.speeds(0.02)[0] for r in records]))
        standing = float(np.mean(speed < 0.05 * np.quantile(speed, 0.9)))
        if standing > STANDING:
            out.notes.append(
                f"The piston hardly moves in {100 * standing:.0f} % of the time: then its friction is in the "
                "response. A test signal about a constant speed leaves it out."
            )
        seconds = sum(len(part) for part in parts) * period
        out.notes.append(
            f"{seconds:.0f} s with the strongest input, every {1e3 * period:.3g} ms; Welch's method, Hann "
            f"windows of {window_s:.3g} s."
        )
    _draw(out, found, poles, natural)
    return out


def _tell_poles(out: Outcome, found: Spectra, natural: float) -> PolePair | None:
    """The hydraulic resonance beside the profile's, `natural` (Hz); None where the response shows none."""
    poles = fit_pole_pair(found, natural)
    seen = found.frequency[found.coherence > COHERENT]
    if poles is not None:
        (_, hz, damping, _), (_, hz_std, damping_std, _) = poles.theta, poles.std
        if poles.fit > LEAST_FIT and 0.0 < damping < 1.0 and hz < seen[-1] and hz_std < SHARP * hz:
            off = f"profile: hydraulic {natural:.3g} Hz, this is {100.0 * (hz / natural - 1.0):+.1f} % off"
            out.tell("natural frequency of a pole pair", hz, hz_std, "Hz", off)
            out.tell("its damping ratio", damping, damping_std, "1")
            return poles
    out.not_told.append(
        f"The hydraulic natural frequency, {natural:.3g} Hz by the profile: no pole pair gives the response."
    )
    return None


def _tell_levels(out: Outcome, found: Spectra) -> None:
    """Level of the lowest octave, and the -3 dB frequency below it."""
    seen = found.coherence > COHERENT
    f, size, radius = found.frequency[seen], np.abs(found.response[seen]), found.radius[seen]
    lowest = f <= 2.0 * f[0]
    level = float(np.median(size[lowest]))
    octave = f"from {f[0]:.2g} to {2.0 * f[0]:.2g} Hz"
    out.told.append(Told.within("gain by Welch", level, float(np.median(radius[lowest])), "m/rad", octave))
    value = half_power_frequency(f, size, level)
    # About this crossing: where the band surely is above before, and surely below after.
    above = f[(f <= value) & (size - radius > level / np.sqrt(2.0))]
    high = half_power_frequency(f, np.where(f < value, level, size + radius), level)
    if np.isnan(high) or above.size == 0:
        out.not_told.append(
            f"-3 dB bandwidth by Welch: up to {f[-1]:.3g} Hz, the last with coherence, the response does "
            "not surely fall 3 dB below its lowest octave's."
        )
        return
    note = f"below the level at {f[0]:.2g} Hz"
    out.told.append(Told("-3 dB bandwidth by Welch", value, float(above[-1]), high, "Hz", note))


def _draw(out: Outcome, measured: Spectra, poles: PolePair | None, natural: float) -> None:
    f, radius = measured.frequency, measured.radius
    size, phase = np.abs(measured.response), degrees(measured.response)
    low, high = np.maximum(size - radius, 0.0), size + radius
    spread = np.degrees(np.arcsin(np.minimum(radius / np.maximum(size, 1e-300), 1.0)))
    out.curves["measured"] = {
        "frequency_hz": f, "magnitude": size, "phase_deg": phase, "magnitude_low": low,
        "magnitude_high": high, "coherence": measured.coherence,
    }  # fmt: skip
    magnitude = [
        tr.band(f, decibel(np.maximum(low, 0.1 * size)), decibel(high), "", tr.BLUE),
        curve_line(f, decibel(size), "Welch", tr.BLUE),
    ]
    angle = [
        tr.band(f, phase - spread, phase + spread, "", tr.BLUE),
        curve_line(f, phase, "Welch", tr.BLUE),
    ]
    if poles is not None:
        fine = np.geomspace(f[0], f[-1], 300)
        response = poles.at(fine)
        modelled = degrees(response)
        # Whole turns bring the fit's phase next to the measured one.
        modelled += 360.0 * float(np.round((phase[0] - modelled[0]) / 360.0))
        out.curves["pole_pair"] = {
            "frequency_hz": fine, "magnitude": np.abs(response), "phase_deg": modelled,
        }  # fmt: skip
        magnitude.append(curve_line(fine, decibel(response), "pole pair", tr.VERMILLION))
        angle.append(curve_line(fine, modelled, "pole pair", tr.VERMILLION))
    layout = axes("frequency (Hz)", type="log") | {"shapes": [tr.upright(natural, dash="dot")]}
    seen = measured.coherence > SEEN
    seen = seen if np.any(seen) else np.ones(f.size, dtype=bool)

    def reach(values: Array, margin: float) -> dict[str, Any]:
        ends = float(values[seen].min() - margin), float(values[seen].max() + margin)
        return layout | {"yaxis": {"range": list(ends)}}

    note = f"shaded: 95 % of Welch; dotted upright: the profile's natural frequency, {natural:.3g} Hz"
    coherence = [curve_line(f, measured.coherence, "Welch", tr.BLUE)]
    out.figures = [
        Figure("magnitude", "Magnitude of velocity", magnitude, reach(decibel(size), 10.0), "dB", note, 340,
               True),
        Figure("phase", "Phase", angle, reach(phase, 45.0), "°", "", 300, True),
        Figure("coherence", "Squared coherence", coherence, layout | {"yaxis": {"range": [0, 1.02]}}, "",
               "1: all of the output follows from the input", 240, True),
    ]  # fmt: skip
