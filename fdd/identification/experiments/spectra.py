"""Input and output of a log on a grid as coarse as the question allows, and their spectra."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, decimate
from scipy.stats import f as fisher

from fdd.errors import InputError
from fdd.identification.experiments.polynomial import Series
from fdd.identification.record import Record

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

INPUTS = ("pump_speed", "command")
OUTPUTS = ("rate", "position", "pressure_difference")
LONGEST = 10.0
"""s of one stretch."""
SHORTEST = 2.0
MOST_ROWS = 40_000
"""Of the grid, those with the strongest input: more sharpen little and take minutes."""
QUIET = 0.1
"""Of the strongest stretch's input; weaker ones are left out."""
SETTLING = 0.25
"""s at either end of a stretch that do not count: the state before it is not known."""
PARTS = 8
"""Of each stretch: every other one is for the fit, those between to test it."""
OVERLAPPED = 1.056
"""Windows of Hann overlapping by half per independent one (Welch, doi.org/10.1109/TAU.1967.1161901)."""


def stretches(
    records: list[Record], given: str, caused: str, rate_hz: float, longest: float = LONGEST
) -> tuple[list[Series], float]:
    """The stretches of all logs with the strongest input, and their sampling interval (s).

    Every signal is averaged over each interval: for a held command and for counts of an encoder that is
    exact, where rates taken at one instant would be late by half a sample.

    Parameters
    ----------
    records : logs of one sampling rate. given, caused : of `INPUTS` and `OUTPUTS`.
    rate_hz : the grid is no coarser than this. longest : s of one stretch.

    Returns
    -------
    Stretches about their means whose `used` rows are neither settling nor filtered from beyond an end.

    Raises
    ------
    InputError : no command in the log, logs of different rates, or no gapless two seconds.
    """
    period = records[0].period
    if any(abs(r.period / period - 1.0) > 0.01 for r in records):
        raise InputError("the logs' sampling rates differ", mend="give logs of one rate")
    coarser = max(int(1.0 / (period * rate_hz)), 1)
    found = []
    for record in records:
        signals = np.column_stack([np.diff(_integral(record, c)) / period for c in (given, caused)])
        for rows in _runs(~record.gap[1:], round(longest / period), round(SHORTEST / period)):
            part = signals[rows] - signals[rows].mean(axis=0)
            if coarser > 1:
                part = decimate(part, coarser, ftype="fir", axis=0)
            used = np.ones(part.shape[0], dtype=bool)
            rim = round(SETTLING / (coarser * period))
            used[:rim] = used[-rim:] = False
            found.append(Series(part[:, 0].copy(), part[:, 1].copy(), used))
    if not found:
        raise InputError(f"no {SHORTEST:.0f} s without a gap", mend="record without gaps")
    found.sort(key=lambda s: -float(np.std(s.given)))
    strongest = float(np.std(found[0].given))
    kept = [s for s in found if np.std(s.given) >= QUIET * strongest]
    sizes = np.cumsum([s.given.size for s in kept])
    return kept[: max(int(np.searchsorted(sizes, MOST_ROWS)), 1)], coarser * period


def _integral(record: Record, name: str) -> Array:
    """(n,) what, differenced, is a signal's mean over each sampling interval."""
    if name == "pump_speed":
        return record.angle
    if name in ("rate", "position"):
        return record.position
    values = record.difference if name == "pressure_difference" else record.command
    if values is None:
        raise InputError("the log has no command", mend="use --input pump_speed, or map a column to command")
    held = values if name == "command" else np.append(0.5 * (values[1:] + values[:-1]), 0.0)
    return np.concatenate([[0.0], np.cumsum(held[:-1]) * record.period])


def _runs(good: NDArray[np.bool_], longest: int, shortest: int) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(np.int8), [0]))))
    runs = []
    for start, stop in edges.reshape(-1, 2):
        count = -(-(stop - start) // longest)
        ends = np.linspace(start, stop, count + 1).astype(int)
        runs += [slice(a, b) for a, b in pairwise(ends) if b - a >= shortest]
    return runs


def halves(series: list[Series]) -> tuple[list[Series], list[Series]]:
    """The same stretches, with every other part to fit and the parts between to test."""

    def only(s: Series, odd: int) -> Series:
        part = np.arange(s.given.size) * PARTS // s.given.size
        return Series(s.given, s.caused, s.used & (part % 2 == odd))

    return [only(s, 0) for s in series], [only(s, 1) for s in series]


@dataclass(frozen=True)
class Spectra:
    """Empirical response over frequency (n,) in Hz.

    Attributes
    ----------
    response : cross spectrum over the input's own. coherence : squared, 0 to 1.
    radius : of the circle about the response that holds the true one in 95 %.
    """

    frequency: Array
    response: ComplexArray
    coherence: Array
    radius: Array


def welch(series: list[Series], period: float, window_s: float) -> Spectra:
    """Welch's estimate with Hann windows of `window_s` that overlap by half, over all stretches."""
    rows = max(round(window_s / period), 16)
    own = out = cross = np.zeros(rows // 2 + 1, dtype=np.complex128)
    windows = 0
    for s in series:
        count = max((s.given.size - rows) // (rows - rows // 2) + 1, 0)
        if count:
            both = [csd(a, b, 1.0 / period, nperseg=rows, detrend="linear")[1]
                    for a, b in ((s.given, s.given), (s.caused, s.caused), (s.given, s.caused))]  # fmt: skip
            own, out, cross = (x + count * y for x, y in zip((own, out, cross), both, strict=True))
            windows += count
    frequency = np.asarray(np.fft.rfftfreq(rows, period), dtype=np.float64)
    use = (frequency > 0.0) & (frequency < 0.4 / period)
    free = max(windows / OVERLAPPED, 2.0)
    return averaged(frequency[use], np.real(own)[use], np.real(out)[use], cross[use], free)


def averaged(frequency: Array, own: Array, out: Array, cross: ComplexArray, independent: float) -> Spectra:
    """Response, coherence and 95 % radius from averaged powers.

    The band is Bendat and Piersol's (Random Data, 9.2.3).

    Parameters
    ----------
    frequency : (n,) Hz. own, out, cross : (n,) powers of input and output, output times conjugate input.
    independent : number of independent ones in each average; with one alone nothing is known of the noise.
    """
    own, out = (np.maximum(x, 1e-12 * x.max(initial=0.0) + 1e-300) for x in (own, out))
    response = cross / own
    coherence = np.clip(np.abs(cross) ** 2 / own / out, 1e-9, 1.0)
    free = max(independent, 1.05)
    share = fisher.ppf(0.95, 2, 2.0 * free - 2.0) / (free - 1.0) * (1.0 / coherence - 1.0)
    return Spectra(frequency, response, coherence, np.abs(response) * np.sqrt(share))
