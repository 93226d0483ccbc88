"""The last ten minutes of an axis, as small as a picture of them needs."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from fdd.diagnosis.findings import Estimate
from fdd.samples import CHANNELS, Samples

SPAN_S = 600.0
LOOK_S = 5.0
BAND_S = 1.2
"""Stretches of which least and largest are kept: five hundred of them are what a picture has room for."""
FRESH_S = 30 * 86400.0
"""s by which a stamp may differ from the time of day, and yet count as one; else it is from any start."""
Numbers = list[float | None]
_NAMES = tuple(name for name in CHANNELS if name != "time")
_Floats = NDArray[np.float32]


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
        # Time, estimates, misfits and probabilities; number of the stretch, least and largest.
        self._looks: deque[tuple[float, dict[str, Estimate], dict[str, float], dict[str, float]]]
        self._looks = deque(maxlen=round(SPAN_S / LOOK_S))
        self._bands: deque[tuple[int, _Floats, _Floats]] = deque(maxlen=round(SPAN_S / BAND_S))

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

    def drawn(self) -> dict[str, Any]:
        """Estimates, misfits of the balances and probabilities of the families (`Series`), and signals."""
        times = [look[0] for look in self._looks]
        names = self._looks[-1][1] if self._looks else ()
        low, high = (np.array([b[k] for b in self._bands]).reshape(-1, len(_NAMES)).T for k in (1, 2))
        seen = [k for k in range(len(_NAMES)) if np.isfinite(low[k]).any()]
        return {
            "estimates": Series(
                time=times,
                values={name: [look[1][name].held for look in self._looks] for name in names},
                std={name: [look[1][name].held_std for look in self._looks] for name in names},
            ),
            "misfits": _series(times, [look[2] for look in self._looks]),
            "probabilities": _series(times, [look[3] for look in self._looks]),
            "signals": Bands(
                time=[band * BAND_S for band, _, _ in self._bands],
                low={_NAMES[k]: _numbers(low[k]) for k in seen},
                high={_NAMES[k]: _numbers(high[k]) for k in seen},
            ),
        }


def _series(times: list[float], rows: Sequence[Mapping[str, float]]) -> Series:
    names = dict.fromkeys(name for row in rows for name in row)
    return Series(time=times, values={n: [r.get(n) for r in rows] for n in names})


def _numbers(column: _Floats) -> Numbers:
    return [None if np.isnan(v) else float(v) for v in column]
