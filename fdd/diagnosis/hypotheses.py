"""The catalogue's signatures as columns of this unit's balances, and the time profiles of faults."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fdd.faults import CATALOGUE, unusable
from fdd.residuals.balances import BALANCES
from fdd.residuals.compiled import Array, Indices, sum_from_here
from fdd.residuals.effects import Effects
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

RECOVERED = "recovered"
"""Stands in a fault's place where the end of one is meant."""
USUAL_SEVERITY = 0.7
"""Standard deviation of a severity before any log is seen: most lie below the gross one."""


class Shape(NamedTuple):
    """Shape of a time profile: a step, a ramp that grows to its full size over that many frames, or a drift
    that goes on by as much in each of them; the share of the size that is there at once, and by what power of
    time it grows."""

    kind: str
    frames: int
    at_once: float = 0.0
    power: int = 1


STEP, RAMP, DRIFT = Shape("step", 0, 1.0), Shape("ramp", 24), Shape("drift", 100)
SHAPES = (STEP, RAMP, DRIFT)
"""Of faults that are sought. More lengths of ramps find no more of them, and chance finds more."""
LENGTHS = (2, 4, 8, 16, 24, 40, 60, 90)
GROWTHS = ((0.0, 1), (0.0, 2), (1 / 3, 1), (2 / 3, 1))
"""Share that is there at once, and power of time: a hole grows by the square of its width, and what begins
with a part of its size, as in oil that warms, a ramp from nothing would date seconds early."""
DATED = (STEP, *(Shape("ramp", frames, *growth) for growth in GROWTHS for frames in LENGTHS))
"""Shapes that a fault's onset is told by once it is found: ramps of 1 to 45 s."""
DATED_PRIOR = np.repeat([0.6, 0.3 / 16, 0.1 / 16], [1, 16, 16])
"""Prior probabilities: most faults are there at once, and of the others most grow from nothing; assumed."""
AT_START = 0.1
"""Prior probability that what comes and goes acts in the first frame, as in the recipes; assumed. Else it
begins in any."""
SWITCHES = 0.05
"""Probability that it goes, or comes back, from one frame to the next: ten seconds on average; assumed."""
MOST_ODDS = 50.0
"""Of the logarithm, beyond which a frame leaves no doubt."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which one fault shows on this unit.

    Attributes
    ----------
    fault, label : of the catalogue. columns : balance to (n,) change of its coefficients per severity.
    scale : prior standard deviation of the amplitudes. signed : the amplitude cannot be negative.
    time_profiles : kinds of `SHAPES` that it may take. prior_weight : prior weight among alike ones. ends :
        the fault that it is the end of.
    """

    fault: str
    label: str
    columns: dict[str, Array]
    scale: float
    signed: bool
    time_profiles: tuple[str, ...] = ("step", "ramp")
    prior_weight: float = 1.0
    side: int | None = None
    variant: str | None = None
    channel: str | None = None
    ends: str | None = None


class HealthyUnit:
    """What signatures may ask (see `fdd.faults.Healthy`)."""

    def __init__(self, effects: dict[str, Effects], scales: Scales) -> None:
        self.effects, self.scales = effects, scales
        self.leakage_ratio = scales.fault_leakage / scales.leakage
        self.speed_ratio = scales.speed / 100.0
        self.relief_ratio = scales.pressure / scales.valve
        self.charge_ratio = scales.charge / scales.valve

    def mean(self, balance: str, column: str) -> float:
        """Coefficient of that column while the unit is healthy."""
        return float(self.effects[balance].mean[BALANCES[balance].columns.index(column)])


def hypotheses(unit: Unit, effects: dict[str, Effects]) -> list[Hypothesis]:
    """All signatures of the catalogue for a unit.

    Raises InputError: a package's fault names what the balances do not have.
    """
    healthy = HealthyUnit(effects, Scales.of(unit))
    out = []
    for entry in CATALOGUE.values():
        for s in entry.signatures:
            columns = {}
            for balance, changes in s.columns(healthy).items():
                if balance not in BALANCES:
                    raise unusable(entry.id, f"there is no balance {balance!r}", BALANCES)
                names = BALANCES[balance].columns
                columns[balance] = np.zeros(len(names))
                for name, change in changes.items():
                    if name not in names:
                        raise unusable(entry.id, f"balance {balance!r} has no column {name!r}", names)
                    columns[balance][names.index(name)] = change
            out.append(Hypothesis(
                entry.id, s.label, columns, USUAL_SEVERITY, s.signed, s.courses, s.commonness,
                s.side, s.variant, s.channel,
            ))  # fmt: skip
    return out


def end_of(h: Hypothesis, size: float) -> Hypothesis:
    """That a fault of an amplitude is over: all that it changed steps back."""
    columns = {balance: -size * change for balance, change in h.columns.items()}
    return Hypothesis(RECOVERED, h.label, columns, 1.0, signed=True, time_profiles=(STEP.kind,), ends=h.fault)


def time_profile_of(shape: Shape, frames: int, onset: int) -> Array:
    """Time profile φ (frames,) of a shape that begins with a frame."""
    since = np.arange(frames) - onset
    step = (since >= 0).astype(np.float64)
    if shape.kind == "step":
        return step
    grown = np.clip((since + 0.5) / shape.frames, 0.0, 1.0 if shape.kind == "ramp" else None)
    return shape.at_once * step + (1.0 - shape.at_once) * grown**shape.power


def coming_and_going(log_odds: Array) -> tuple[Array, Array]:
    """Posterior probabilities (h,) that a fault has begun by each frame, and that it acts in it.

    By a hidden Markov chain of the states not yet, acting and away; forward and backward recursions as in
    Rabiner 1989 (doi 10.1109/5.18626). `log_odds` (h,) are the log likelihood ratios of each frame's rows,
    the fault acting against not.
    """
    odds = np.exp(np.clip(log_odds, -MOST_ODDS, MOST_ODDS))
    likelihood = np.column_stack([np.ones_like(odds), odds, np.ones_like(odds)])
    begins, stays = 1.0 / odds.size, 1.0 - SWITCHES
    step = np.array([[1.0 - begins, begins, 0.0], [0.0, stays, SWITCHES], [0.0, SWITCHES, stays]])
    forward, backward = np.ones((2, odds.size, 3))
    forward[0] = likelihood[0] * (1.0 - AT_START, AT_START, 0.0)
    for k in range(1, odds.size):
        state = forward[k - 1] @ step * likelihood[k]
        forward[k] = state / state.sum()
    for k in range(odds.size - 2, -1, -1):
        state = step @ (likelihood[k + 1] * backward[k + 1])
        backward[k] = state / state.sum()
    both = forward * backward
    both /= both.sum(axis=1, keepdims=True)
    return 1.0 - both[:, 0], both[:, 1]


def correlated(profiles: Array, x: Array) -> Iterator[Array]:
    """Sums over frames of x (h, z) times each of the time profiles (s, h), begun with each frame; by FFT."""
    size = 2 * len(x)  # SciPy's own would transform x for each profile, in twice the time
    transformed = np.fft.rfft(x, size, axis=0)
    for profile in np.fft.rfft(profiles, size).conj():
        yield np.fft.irfft(profile[:, None] * transformed, size, axis=0)[: len(x)]


class SuffixSums:
    """Sums over frames of (h, …) times a time profile or its square, for each onset of the profile, (k, …);
    by repeated suffix sums, so that every onset costs the same."""

    def __init__(self, x: Array) -> None:
        self.one = _from_here(x)
        self.two = _from_here(self.one)
        self.grown = self.two - 0.5 * self.one

    def over(self, shape: Shape, onsets: Indices) -> Array:
        """Σ φ x."""
        if shape.kind == "step":
            return self.one[onsets]
        past = _at(self.grown, onsets + shape.frames) if shape.kind == "ramp" else 0.0
        return np.asarray((self.grown[onsets] - past) / shape.frames)

    def squared(self, shape: Shape, onsets: Indices) -> Array:
        """Σ φ² x."""
        if shape.kind == "step":
            return self.one[onsets]
        square, past = 2.0 * (_from_here(self.two) - self.two) + 0.25 * self.one, np.zeros(1)
        if shape.kind == "ramp":
            # Past its end a ramp has grown by its whole length l: (k + l)² - l² = k² + 2 l k is too much.
            past = _at(square + 2.0 * shape.frames * self.grown, onsets + shape.frames)
        return np.asarray((square[onsets] - past) / shape.frames**2)


def _from_here(x: Array) -> Array:
    """Sums of (h, …) from each frame to the last."""
    out = np.array(x)
    sum_from_here(out.reshape(len(x), -1))
    return out


def _at(x: Array, frames: Indices) -> Array:
    """Values at frames; none after the last one."""
    out = np.zeros((frames.size, *x.shape[1:]))
    inside = frames < len(x)
    out[inside] = x[frames[inside]]
    return out
