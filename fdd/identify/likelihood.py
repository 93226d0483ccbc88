"""Maximum of a likelihood over the logarithms of noise levels, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimators.eha_noise import Noise

Array = NDArray[np.float64]

STEP = 0.7
"""First step in ln σ: a factor of two."""
FINEST = 0.1
"""Change of ln σ below which a search is done."""
FARTHEST = np.log(300.0)
"""Largest change of ln σ from where the search starts."""
PRIOR = np.log(10.0)
"""Standard deviation of ln σ about its start: keeps what the data does not tell where it was."""
HIDDEN = 3.0 * STEP
"""How much higher a level is tried where a small rise changes nothing."""
LEAST_MOVE = 0.3
"""Log-likelihood that a move must gain: where nothing changes, nothing wanders."""
LEAST_GAIN = 3.0
"""Log-likelihood between a level and half or twice of it, below which the data does not tell it."""


@dataclass(frozen=True)
class LogScaleFit:
    """Result of `maximise`.

    Attributes
    ----------
    noise : with the levels found.
    told : of each level that the data tells, its relative standard deviation.
    value, start_value : log-likelihood at the end and at the start.
    evaluations : of the likelihood.
    """

    noise: Noise
    told: dict[str, float]
    value: float
    start_value: float
    evaluations: int


class _Search:
    """One likelihood, remembered by point, with its prior."""

    def __init__(self, likelihoods: Callable[[Noise], Array], start: Noise, names: Sequence[str]) -> None:
        self.likelihoods, self.start, self.names = likelihoods, start, tuple(names)
        self.base = np.array([np.log(getattr(start, n)) for n in self.names])
        self.seen: dict[tuple[float, ...], Array] = {}

    def noise(self, u: Array) -> Noise:
        return replace(self.start, **{n: float(np.exp(v)) for n, v in zip(self.names, u, strict=True)})

    def parts(self, u: Array) -> Array:
        """Log-likelihood of each stretch."""
        key = tuple(np.round(u, 9))
        if key not in self.seen:
            self.seen[key] = self.likelihoods(self.noise(u))
        return self.seen[key]

    def value(self, u: Array) -> float:
        """Log-posterior."""
        away = u - self.base
        if np.any(np.abs(away) > FARTHEST):
            return -np.inf
        return float(np.sum(self.parts(u)) - 0.5 * np.sum((away / PRIOR) ** 2))


def maximise(
    likelihoods: Callable[[Noise], Array], start: Noise, names: Sequence[str], sweeps: int = 3
) -> LogScaleFit:
    """Pattern search in ln σ with parabolas; deterministic, and robust to a filter that fails.

    Noise levels act on different channels and frequencies, so they are nearly independent of each
    other on a logarithmic scale, and a search along one after the other needs few evaluations.

    Parameters
    ----------
    likelihoods : noise to the log-likelihood of each stretch, (k,); minus infinity is allowed.
    start : where to begin; also the centre of a wide log-normal prior.
    names : fields of `Noise` to search.
    sweeps : over the names; ends sooner when nothing changes by a tenth.

    Returns
    -------
    LogScaleFit : the standard deviation is the larger one of the curvature's, and of the sandwich
        ``H⁻¹ Σ(g − ḡ)² H⁻¹`` over the stretches' slopes g (White 1982, doi 10.2307/1912526): stretches of
        a plant that is not the model disagree more than white noise would let them.
    """
    search = _Search(likelihoods, start, names)
    u = search.base.copy()
    start_value = float(np.sum(search.parts(u)))
    active = list(range(len(u)))
    step = np.full(len(u), STEP)
    for sweep in range(sweeps):
        moved, begun = 0.0, u.copy()
        for i in list(active):
            before = u[i]
            u[i] = _along(search, u, i, float(step[i]))
            moved = max(moved, abs(u[i] - before))
            # Not in the first sweep: a level that another one hides may show when that one is right.
            if sweep > 0 and _flat(search, u, i):
                active.remove(i)
            step[i] = max(0.4 * step[i], 2.0 * FINEST)
        u = _onward(search, u, u - begun)
        if moved < FINEST or not active:
            break
    told = {search.names[i]: _deviation(search, u, i) for i in active if _tells(search, u, i)}
    return LogScaleFit(search.noise(u), told, float(np.sum(search.parts(u))), start_value, len(search.seen))


def _onward(search: _Search, u: Array, way: Array) -> Array:
    """As far again as the sweep went, while that helps: along a valley no single level finds the way
    (Hooke and Jeeves 1961, doi 10.1145/321062.321069)."""
    here = search.value(u) + LEAST_MOVE
    for _ in range(4):
        there = search.value(u + way)
        if not there > here:
            break
        u, here = u + way, there
        way = 2.0 * way
    return u


def _moved(u: Array, i: int, by: float) -> Array:
    out = u.copy()
    out[i] += by
    return out


def _along(search: _Search, u: Array, i: int, step: float) -> float:
    """The best level along coordinate `i`: bracketed by steps that double, then a parabola's top."""
    centre, here = u[i], search.value(u) + LEAST_MOVE

    def at(level: float) -> float:
        return search.value(_moved(u, i, level - u[i]))

    up, down = at(centre + step), at(centre - step)
    if here > up > here - 2.0 * LEAST_MOVE and at(centre + HIDDEN) > here:
        # A sensor's noise that others hide until it is some times as large.
        centre, here = centre + HIDDEN, at(centre + HIDDEN)
        up, down = at(centre + step), at(centre - step)
    if max(up, down) > here:
        direction = 1.0 if up > down else -1.0
        behind, ahead = here, max(up, down)
        while ahead > here:
            centre, behind, here = centre + direction * step, here, ahead
            ahead = at(centre + direction * step)
            if ahead > here:  # twice as far from now on
                centre, here, step = centre + direction * step, ahead, 2.0 * step
                behind, ahead = at(centre - direction * step), at(centre + direction * step)
        up, down = (ahead, behind) if direction > 0.0 else (behind, ahead)
    vertex = centre + step * _vertex(down, here, up)
    return float(vertex) if at(vertex) > here else float(centre)


def _vertex(down: float, here: float, up: float) -> float:
    """Top of the parabola through three points a step apart, in steps, at most one away."""
    bend = down - 2.0 * here + up
    if not np.isfinite(bend) or bend >= 0.0:
        return 0.0
    return float(np.clip(0.5 * (down - up) / bend, -1.0, 1.0))


def _flat(search: _Search, u: Array, i: int) -> bool:
    """Whether neither half nor twice the level makes any difference."""
    here = np.sum(search.parts(u))
    return all(abs(here - np.sum(search.parts(_moved(u, i, by)))) < LEAST_GAIN for by in (-STEP, STEP))


def _tells(search: _Search, u: Array, i: int) -> bool:
    """Whether half and twice the level are both clearly worse."""
    here = np.sum(search.parts(u))
    return all(here - np.sum(search.parts(_moved(u, i, by))) > LEAST_GAIN for by in (-STEP, STEP))


def _deviation(search: _Search, u: Array, i: int) -> float:
    by = 2.0 * FINEST
    here, up, down = (search.parts(_moved(u, i, d)) for d in (0.0, by, -by))
    if not np.all(np.isfinite(up) & np.isfinite(down)):
        return float("nan")
    bend = float(np.sum(2.0 * here - up - down)) / by**2
    if bend <= 0.0:
        return float("nan")
    slopes = (up - down) / (2.0 * by)
    k = slopes.size
    scatter = float(np.sum((slopes - slopes.mean()) ** 2)) * k / max(k - 1, 1)
    return float(np.sqrt(max(1.0 / bend, scatter / bend**2)))
