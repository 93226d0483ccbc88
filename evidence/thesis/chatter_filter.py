"""Section 7.1.1: the discrete Butterworth filter of eq. 7.5, by zero-order hold and by Tustin's rule."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, freqz, lfilter

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.runs import PERIOD
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

CUTOFF = 350.0
"""rad/s, section 7.1.1."""
PRINTED = {
    "z⁻¹, numerator": 5.28e-2,
    "z⁻², numerator": 4.39e-2,
    "z⁻¹, denominator": -1.514,
    "z⁻², denominator": 0.61,
}
"""Eq. 7.5."""
MISPRINT = {"z⁻¹, numerator": 5.18e-2}
"""What eq. 7.3 makes of it: the other three coefficients are its zero-order hold as printed."""


def discrete_filter(method: str) -> tuple[Array, Array]:
    """Second-order Butterworth filter of 350 rad/s at 1 kHz: numerator and denominator, (3,) each.

    Parameters
    ----------
    method : ``zoh`` or ``tustin``.

    Examples
    --------
    >>> [round(float(x), 4) for x in (*discrete_filter("zoh")[0][1:], *discrete_filter("zoh")[1][1:])]
    [0.0518, 0.0439, -1.5139, 0.6096]
    """
    numerator, denominator = butter(2, CUTOFF, analog=True)
    name = "bilinear" if method == "tustin" else method
    top, bottom, _ = cont2discrete((numerator, denominator), PERIOD, method=name)
    return np.ravel(top), np.asarray(bottom)


def filtered_velocity(position: Array) -> Array:
    """Velocity as section 7.2 shows it: differences of the position through eq. 7.5's filter, (n,)."""
    numerator, denominator = discrete_filter("zoh")
    return np.asarray(lfilter(numerator, denominator, np.diff(position, prepend=position[:1]) / PERIOD))


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Recompute eq. 7.5 both ways; no plant is needed."""
    by = {method: discrete_filter(method) for method in ("zoh", "tustin")}
    places = [(0, 1), (0, 2), (1, 1), (1, 2)]
    rows, cells = [], [("1, numerator", "none", f"{by['zoh'][0][0]:.4f}", f"{by['tustin'][0][0]:.4f}")]
    for (name, printed), (part, k) in zip(PRINTED.items(), places, strict=True):
        held, tustin = float(by["zoh"][part][k]), float(by["tustin"][part][k])
        meant = MISPRINT.get(name, printed)
        rows.append(
            Row(
                f"coefficient of {name}", "eq. 7.5", meant, held, "1", tolerance=0.005 * abs(meant),
                note="" if meant == printed else f"Printed as {printed:g}, a misprint: eq. 7.3 by the "
                f"zero-order hold gives the other three coefficients as printed, and {held:.4f} here.",
                digits=4,
            )
        )  # fmt: skip
        cells.append((name, f"{printed:g}", f"{held:.4f}", f"{tustin:.4f}"))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        frequency = np.geomspace(1.0, 499.0, 500)
        printed = [0.0, 5.28e-2, 4.39e-2], [1.0, -1.514, 0.61]
        for label, (top, bottom), style in (
            ("zero-order hold", by["zoh"], "C0-"),
            ("Tustin", by["tustin"], "C1-"),
            ("thesis, as printed", printed, "k--"),
        ):  # fmt: skip
            _, response = freqz(top, bottom, worN=frequency, fs=1.0 / PERIOD)
            axes.semilogx(frequency, 20.0 * np.log10(np.maximum(np.abs(response), 1e-6)), style, label=label)
        axes.axvline(CUTOFF / (2.0 * np.pi), color="k", linestyle=":", linewidth=0.8)
        axes.annotate("350 rad/s", (CUTOFF / (2.0 * np.pi) * 1.03, 1.5), fontsize=9)
        axes.set(xlabel="frequency (Hz)", ylabel="magnitude (dB)", ylim=(-60.0, 4.0))
        axes.legend()

    return Finding(
        "Chatter filter",
        "Section 7.1.1 turns the Butterworth filter of eq. 7.3 (350 rad/s) into a discrete one for 1 kHz "
        "and says that it does so by Tustin's rule (eq. 7.4). Both conversions are recomputed.",
        rows,
        tables=[Table("Coefficients", ("power of z", "thesis, eq. 7.5", "zero-order hold", "Tustin"), cells)],
        remarks=["The printed coefficients are the zero-order hold's, not Tustin's as the text says."],
        pictures=[Picture("chatter_filter", "Magnitude of the filter.", draw, height=3.6)],
    )
