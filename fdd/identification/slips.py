"""Which mistaken unit of measure makes a factor: mm read as m, rpm as rad/s, bar as Pa."""

from __future__ import annotations

from math import log

from fdd.measures import MEASURES

NEAR = 1.25
"""Factor within which a slip explains what was found; of lengths, angles and pressures no two slips of one
channel are nearer than 1.4 to each other, and none is nearer than 2.5 to one."""
COMMON = ("m", "rad", "rad/s", "Pa", "kPa", "bar", "mm", "deg", "rpm", "MPa")
"""Units in which logs are most often written or read, the commonest first."""


def slips(factor: float, dimension: str) -> str:
    """Pairs of units that make a channel `factor` times too large, in words; empty where none does.

    Examples
    --------
    >>> slips(1000.0, "length")
    'mm read as m'
    >>> slips(9.6, "angular_speed")
    'rpm read as rad/s'
    >>> slips(0.01, "pressure")
    'bar read as kPa'
    >>> slips(1.1, "pressure")
    ''
    """
    if factor <= 0.0:
        return ""
    fitting = []
    for true, t in MEASURES.items():
        for read, r in MEASURES.items():
            if not t.dimension == r.dimension == dimension or t.factor == r.factor:
                continue
            off = abs(log(factor * t.factor / r.factor))
            if off < log(NEAR):
                fitting.append((round(off, 2), _rank(read) + _rank(true), f"{true} read as {read}"))
    return min(fitting)[2] if fitting else ""


def _rank(name: str) -> int:
    return COMMON.index(name) if name in COMMON else len(COMMON)
