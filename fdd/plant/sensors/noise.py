"""Noise that stops at a band limit, causal, with the standard deviation that was asked for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

Array = NDArray[np.float64]

RATE = 1000.0
"""Hz, rows per second, usually."""
HIGHEST_LIMIT = 0.45 * RATE
"""Hz; a limit from here on is none."""
_ORDER = 4
_LEFT = 1e-9
"""Share of a transient that is left once the noise counts as settled."""
_LONGEST = 1_000_000


@lru_cache(maxsize=64)
def band_limit(limit_hz: float, rate: float = RATE) -> tuple[Array, int]:
    """Sections that let white noise of deviation 1 through up to a limit and leave it at deviation 1.

    Butterworth of fourth order: half the power at the limit, a thousandth from twice the limit on. Its gain
    is one over the root of the impulse response's sum of squares, which is what it does to white noise.

    Parameters
    ----------
    limit_hz : below `HIGHEST_LIMIT`.
    rate : Hz, rows per second.

    Returns
    -------
    (2, 6) second-order sections, and the rows after which their start is forgotten.

    Examples
    --------
    >>> sections, settled = band_limit(150.0)
    >>> impulse = np.eye(1, 4000)[0]
    >>> round(float(np.sum(sosfilt(sections, impulse) ** 2)), 12), settled < 200
    (1.0, True)
    """
    sections = np.array(butter(_ORDER, limit_hz, fs=rate, output="sos"))
    poles = np.abs(np.concatenate([np.roots(section[3:]) for section in sections]))
    settled = min(int(np.log(_LEFT) / np.log(poles.max())) + 1, _LONGEST)
    impulse = np.zeros(settled + 1)
    impulse[0] = 1.0
    sections[0, :3] /= np.sqrt(np.sum(sosfilt(sections, impulse) ** 2))
    return sections, settled
