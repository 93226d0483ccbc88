"""The last ten minutes of an axis, as small as a picture of them needs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from fdd.diagnosis.findings import Estimate
from fdd.samples import CHANNELS, Samples

SPAN_S = 600.0
LOOK_S = 5.0
BAND_S = 0.5
"""Stretches of which least and largest are kept: finer than a pixel of ten minutes."""
FRESH_S = 30 * 86400.0
"""s by which a stamp may differ from the time of day, and yet count as one; else it is from any start."""
Numbers = list[float | None]
_NAMES = tuple(name for name in CHANNELS if name != "time")


class Series(BaseModel):
    """Quantities over the stream's time (s), SI; `std` where there is one."""

    time: list[float] = []
    values: dict[str, Numbers] = {}
    std: dict[str, Numbers] = {}


class Bands(BaseModel):
    """Signals over the stream's time (s), SI: least and largest of each stretch."""

    time: list[float] = []
    low: dict[str, Numbers] = {}
    high: dict[str, Numbers] = {}


class Recent:
    """What is kept of an axis for its page."""

    def __init__(self) -> None:
        most = round(SPAN_S / LOOK_S)
        self._looks: deque[tuple[float, dict[str, Estimate], dict[str, float], dict[str, float]]]
        self._looks = deque(maxlen=most)
        self._bands: deque[tuple[int, NDArray[np.float32], NDArray[np.float32]]]
        self._bands = deque(maxlen=round(SPAN_S / BAND_S))

    def add(self, samples: Samples) -> None:
        """Take samples that follow the last ones."""
        if not len(samples):
            return
        place = np.floor(samples.time / BAND_S).astype(np.int64)
        starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))
        values = np.full((len(_NAMES), len(samples)), np.nan, dtype=np.float32)
        for k, name in enumerate(_NAMES):
            if name in samples:
                values[k] = samples[name]
        low = np.fmin.reduceat(values, starts, axis=1)
        high = np.fmax.reduceat(values, starts, axis=1)
        for k, band in enumerate(place[starts].tolist()):
            one, other = low[:, k], high[:, k]
            if self._bands and self._bands[-1][0] == band:
                _, before, after = self._bands.pop()
                one, other = np.fmin(before, one), np.fmax(after, other)
            self._bands.append((band, one, other))

    def look(
        self,
        time: float,
        estimates: dict[str, Estimate],
        misfits: dict[str, float],
        chances: dict[str, float],
    ) -> None:
        """Take what one look at the evidence gave."""
        self._looks.append((time, estimates, misfits, chances))

    def signals(self) -> Bands:
        """Least and largest of each stretch."""
        time = [band * BAND_S for band, _, _ in self._bands]
        low, high = (np.array([b[k] for b in self._bands]).reshape(-1, len(_NAMES)).T for k in (1, 2))
        seen = [k for k in range(len(_NAMES)) if np.isfinite(low[k]).any()]
        return Bands(
            time=time,
            low={_NAMES[k]: _numbers(low[k]) for k in seen},
            high={_NAMES[k]: _numbers(high[k]) for k in seen},
        )

    def estimates(self) -> Series:
        """Tracked quantities and their standard deviations."""
        values: dict[str, Numbers] = {}
        stds: dict[str, Numbers] = {}
        for name in self._looks[-1][1] if self._looks else ():
            values[name] = [e[name].held for _, e, _, _ in self._looks]
            stds[name] = [e[name].held_std for _, e, _, _ in self._looks]
        return Series(time=[x[0] for x in self._looks], values=values, std=stds)

    def misfits(self) -> Series:
        """How badly each balance closed."""
        return self._over(x[2] for x in self._looks)

    def probabilities(self) -> Series:
        """Of each family."""
        return self._over(x[3] for x in self._looks)

    def _over(self, rows: Iterable[Mapping[str, float]]) -> Series:
        rows = list(rows)
        names = dict.fromkeys(name for row in rows for name in row)
        return Series(time=[x[0] for x in self._looks], values={n: [r.get(n) for r in rows] for n in names})


def _numbers(column: NDArray[np.float32]) -> Numbers:
    return [None if np.isnan(v) else float(v) for v in column]
