"""A quantity over a minute, an hour or a day, and how two parts of one span are merged."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

SPANS_S = {"minute": 60.0, "hour": 3600.0, "day": 86400.0}
"""Level to its span; all begin at whole multiples of it (UTC)."""


@dataclass(frozen=True)
class Rollup:
    """What a quantity was over a span; SI.

    Attributes
    ----------
    start_wall : Unix seconds, any within the span; the store sets the span's beginning.
    n : values. std : of all of them (divided by n, not n - 1), with what each value errs by itself.
    """

    axis: str
    quantity: str
    start_wall: float
    n: int
    mean: float
    std: float
    min: float
    max: float

    def over(self, level: str) -> Rollup:
        """The same, of the span of a level that it belongs to.

        Examples
        --------
        >>> Rollup("A1", "leakage", 7325.0, 1, 2.0, 0.0, 2.0, 2.0).over("hour").start_wall
        7200.0
        """
        span = SPANS_S[level]
        return replace(self, start_wall=math.floor(self.start_wall / span) * span)


def merged(a: Rollup, b: Rollup) -> Rollup:
    """Both parts together, by Chan, Golub and LeVeque's update (1979), which loses no digits.

    Examples
    --------
    >>> one, two = (Rollup("A1", "leakage", 0.0, n, m, 0.0, m, m) for n, m in ((1, 2.0), (3, 6.0)))
    >>> both = merged(one, two); both.n, both.mean, round(both.std, 3)
    (4, 5.0, 1.732)
    """
    n = a.n + b.n
    apart = b.mean - a.mean
    square = (a.n * a.std**2 + b.n * b.std**2 + apart**2 * (a.n * b.n / n)) / n
    least, most = min(a.min, b.min), max(a.max, b.max)
    return replace(a, n=n, mean=a.mean + apart * (b.n / n), std=math.sqrt(square), min=least, max=most)
