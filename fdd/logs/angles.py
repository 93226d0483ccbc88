"""Angles: unwrapping counts, giving them a direction, and accumulating speeds exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.logs.wire.grid import grid_numbers
from fdd.samples import Column

LONGEST_BRIDGE = 1.0
"""s; over a longer gap nobody knows how far the pump turned, and nothing is added."""


def sample_numbers(time: Column, period: float) -> NDArray[np.int64]:
    """Number of each row on the grid of the nominal period, so that gaps are whole periods.

    A stamp that came late makes a long step and then a short one; the row keeps
    its own number, it is not counted as a missing row.

    Parameters
    ----------
    time : (n,) s, increasing.
    period : s, nominal.

    Returns
    -------
    (n,) integers, strictly increasing; a step of k means k - 1 missing rows.

    Examples
    --------
    >>> sample_numbers(np.array([0.0, 1.0, 2.9, 3.0, 5.0]), 1.0).tolist()
    [0, 1, 2, 3, 5]
    >>> sample_numbers(np.array([0.0, 1.0, 2.4999, 2.9998, 4.0]), 1.0).tolist()
    [0, 1, 2, 3, 4]
    """
    if time.size == 0:
        return np.empty(0, dtype=np.int64)
    return np.asarray(grid_numbers(time, period))


def accumulate_speed(time: Column, speed: Column, period: float) -> Column:
    """Angle from speed samples, each of which stands for one nominal period.

    Where the speed is a count difference over the nominal period, this gives the
    counts back exactly. Missing rows and NaN are bridged by the mean of their
    neighbours times the periods missed, up to `LONGEST_BRIDGE`.

    Parameters
    ----------
    time : (n,) s, increasing.
    speed : (n,) rad/s, NaN where missing.
    period : s.

    Returns
    -------
    (n,) rad, 0 at the first row that has a speed; NaN where the speed is NaN.
    """
    angle = np.full(time.size, np.nan)
    there = np.flatnonzero(np.isfinite(speed))
    if there.size == 0:
        return angle
    numbers = sample_numbers(time, period)[there]
    present = speed[there]
    missed = np.diff(numbers) - 1
    del numbers
    missed[missed * period > LONGEST_BRIDGE] = 0
    turned = period * (present[1:] + missed * 0.5 * (present[1:] + present[:-1]))
    del missed, present
    angle[there] = np.concatenate(([0.0], np.cumsum(turned, out=turned)))
    return angle


def unwrap_counts(raw: Column, wrap: float) -> Column:
    """An angle that starts again at 0 each `wrap` counts, made continuous.

    NaN rows stay NaN and are passed over.
    """
    out = raw.copy()
    there = np.isfinite(raw)
    out[there] = np.unwrap(raw[there], period=wrap)
    return out


def directed(raw: Column, direction: Column, *, accumulate: bool) -> Column:
    """Give a quantity the sign of another one, e.g. of a directional valve.

    Parameters
    ----------
    raw : (n,) values; NaN where missing.
    direction : (n,) only its sign counts; NaN keeps the last sign. Before the first one a value is missing,
        and an angle stands.
    accumulate : True for an angle: each step takes the sign of the row it ends
        in. False multiplies the values.
    """
    known = np.where(np.isfinite(direction), np.arange(direction.size), -1)
    last = np.maximum.accumulate(known) if known.size else known
    sign = np.where(last >= 0, np.sign(direction[last]), 0.0 if accumulate else np.nan)
    if not accumulate:
        return np.asarray(raw * sign)
    out = raw.copy()
    there = np.flatnonzero(np.isfinite(raw))
    if there.size:
        steps = np.diff(raw[there]) * sign[there[1:]]
        out[there] = np.concatenate(([raw[there[0]]], raw[there[0]] + np.cumsum(steps)))
    return out
