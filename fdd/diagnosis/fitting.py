"""Faults' amplitudes in a log, and how far they really scatter.

A fault adds its amplitude ``a`` times its columns ``G`` times its time profile ``φ`` to the balances'
coefficients. What keeps ``a² λ`` from passing for evidence that it is not are scores of healthy stretches of
two seconds, of the log and of the unit's baseline: they say how far an amplitude really scatters, the
sandwich (or cluster robust) factor κ (Liang and Zeger 1986, doi 10.1093/biomet/73.1.13). It is measured on
the unit itself, whatever its load, noise and structure. It widens the unit's prior as well: a unit whose
balances close badly also differs more from log to log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.departures import Departures, departures
from fdd.residuals.bins import BLOCK_FRAMES
from fdd.residuals.effects import Effects

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

PRIOR_FREEDOM = 2.0
"""Stretches that the baseline's scatter counts for: how far one log's is from another's."""
UNKNOWN_SCATTER = 3.0
"""Scatter of a unit without baseline."""
LEAST_SCATTER = 0.2
"""Least factor: what coefficients wander by, and noises' floors, are assumed with care."""
FEW_STRETCHES = 2.0
"""Of b stretches behind an amplitude the share b / (b + 2) counts: what one stretch alone shows may be an
event of its own, as a machine's start is."""
GREATEST = 2.0
"""Severity beyond which no fault goes: 1.0 is gross, and a scale may be off by a factor of two on another
machine."""


class BalancePosterior:
    """One balance as evidence sees it.

    Parameters
    ----------
    information, vector : (h, n, n) and (h, n) of its frames, widened by what wanders. healthy : effects of
        the unit, with the scatter of its own healthy logs.

    Attributes
    ----------
    solution, inverse, root : (n,), (n, n) and (n, n), the log's own coefficients, their covariance and a
        square root of it. rest : (h, n), of the vectors beside the solution.
    """

    def __init__(self, information: Array, vector: Array, healthy: Effects) -> None:
        self.information, self.healthy = information, healthy
        self.total: Array = information.sum(axis=0)
        prior = np.linalg.inv(healthy.covariance)
        self.inverse: Array = np.asarray(np.linalg.inv(prior + self.total), dtype=np.float64)
        self.solution: Array = self.inverse @ (prior @ healthy.mean + vector.sum(axis=0))
        self.rest = vector - information @ self.solution

        values, vectors = np.linalg.eigh(0.5 * (self.inverse + self.inverse.T))
        self.root: Array = vectors * np.sqrt(values.clip(0.0))

    def schur_complement(self, time_profile: Array) -> Array:
        """Information (n, n) of a change of the coefficients over a time profile (h,), the log's own free."""
        n = time_profile.size
        flat = self.information.reshape(n, -1)
        moved, squared = (c @ flat for c in (time_profile, time_profile**2))
        shape = self.information.shape[1:]
        moved = moved.reshape(shape)
        return np.asarray(squared.reshape(shape) - moved @ self.inverse @ moved)

    def conditional(self, changes: Array) -> tuple[Array, Array]:
        """The same frames as stretches see changes (f, n) of coefficients that were there from the start.

        The log's own coefficients and such a change are one to all of its frames, so what the unit's prior
        allows along the change is taken from it: what is left differs from stretch to stretch.

        Returns
        -------
        (f, n, n) and (f, h, n): `inverse` and `rest` for each of them.
        """
        covariance = self.healthy.covariance
        along = np.einsum("fi,ij,fj->f", changes, np.linalg.inv(covariance), changes)
        outer = changes[:, :, None] * changes[:, None, :]
        across = covariance - outer / np.where(along > 0.0, along, 1.0)[:, None, None]
        inverse: Array = np.asarray(np.linalg.solve(np.eye(changes.shape[1]) + across @ self.total, across))
        contribution = self.rest.sum(axis=0) + self.total @ (self.solution - self.healthy.mean)
        moved = self.solution - self.healthy.mean - inverse @ contribution
        return inverse, self.rest + self.score_contribution(moved)

    def score_contribution(self, changes: Array) -> Array:
        """What changes (…, n) of coefficients add to the frames' vectors, (…, h, n)."""
        n = changes.shape[-1]
        return (changes @ self.information.reshape(-1, n).T).reshape(*changes.shape[:-1], -1, n)


class Joint:
    """Faults in one balance, each beside those that are known.

    Parameters
    ----------
    mine : (f,) of these faults among all. columns : (f, p, n), of a fault and of the known ones.
        time_profiles : (f, p, h). from_start : as stretches see a fault that was there before the first
            frame.

    Attributes
    ----------
    information, vector : (f, p, p) and (f, p) of the amplitudes.
    """

    def __init__(
        self, balance: BalancePosterior, mine: Indices, columns: Array, time_profiles: Array, *,
        from_start: bool = False,
    ) -> None:  # fmt: skip
        self.balance, self.mine, self.columns, self.time_profiles = balance, mine, columns, time_profiles
        self.inverse, self.rest = balance.inverse[None], balance.rest[None]
        if from_start:
            self.inverse, self.rest = balance.conditional(columns[:, 0])
        self.acting = time_profiles[..., None] * columns[:, :, None, :]
        self.contribution = time_profiles[..., None] * balance.score_contribution(columns)
        self.total_contribution = self.contribution.sum(axis=2)
        f, p = columns.shape[:2]
        acting = self.acting.reshape(f, p, -1)
        self.information: Array = acting @ np.swapaxes(self.contribution.reshape(f, p, -1), 1, 2)
        total = self.total_contribution
        self.information -= total @ self.inverse @ np.swapaxes(total, 1, 2)
        self.vector: Array = (acting @ self.rest.reshape(len(self.rest), -1, 1))[..., 0]

    def nuisance_shift(self, a: Array) -> Array:
        """How far amplitudes (f, p) draw the log's own solution, (f, n)."""
        total = np.einsum("fpn,fp->fn", self.total_contribution, a)
        return np.asarray((self.inverse @ total[..., None])[..., 0])

    def frame_shift(self, a: Array) -> tuple[Array, Array]:
        """How far each frame's coefficients lie off the log's own solution with these amplitudes, and what
        that adds to its vector, (f, h, n) each."""
        shift = self.nuisance_shift(a)
        off = np.einsum("fphn,fp->fhn", self.acting, a) - shift[:, None]
        return off, np.einsum("fphn,fp->fhn", self.contribution, a) - self.balance.score_contribution(shift)


@dataclass
class Fit:
    """A fault's amplitude.

    Attributes
    ----------
    size, variance : of the amplitude, as far as its own time scatters. active_amplitude : of the amplitude
        while it acts, where it comes and goes. gain : half the quadratic form, by the rows' own variance
        alone.
        overdispersion, reduced_chi_square : how healthy stretches scatter, over what their information says,
        and how those of the fault's own time do. blocks : stretches that speak for it, as many as alike ones
        would be. score : see `log_odds`.
    """

    size: float
    variance: float
    active_amplitude: float
    gain: float
    overdispersion: float
    reduced_chi_square: float
    blocks: float
    score: float


@dataclass(frozen=True)
class Parts:
    """Faults to be fitted, each beside those that are known.

    Attributes
    ----------
    columns : balance to (f, p, n), of a fault and of the known ones; of balances that speak of any.
    time_profiles : (f, p, h). scales : (f, p) prior std of each amplitude. signed : (f,), the fault is a
        severity.
    """

    columns: dict[str, Array]
    time_profiles: Array
    scales: Array
    signed: Flags

    def joints(self, balances: Mapping[str, BalancePosterior], *, from_start: bool = False) -> list[Joint]:
        """In every balance that speaks of them."""
        out = []
        for name, columns in self.columns.items():
            mine = np.flatnonzero(columns.any(axis=(1, 2)))
            profiles = self.time_profiles[mine]
            out.append(Joint(balances[name], mine, columns[mine], profiles, from_start=from_start))
        return out


class Stretches(NamedTuple):
    """Frames whose errors may hang together, and the least by which they scatter, over their information."""

    frames: int = BLOCK_FRAMES
    least: float = LEAST_SCATTER


def fit(
    balances: Mapping[str, BalancePosterior], parts: Parts, *, from_start: bool, stretches: Stretches
) -> list[Fit]:
    """Fit each fault beside the known ones.

    Parameters
    ----------
    from_start : they were there before the first frame.
    """
    joints = parts.joints(balances)
    scales, time_profiles = parts.scales, parts.time_profiles
    information, vector = _summed(joints, 1.0 / scales**2)
    a: Array = _solved(information, vector)
    free = a[:, 0].copy()
    size = np.where(parts.signed, np.clip(free, 0.0, GREATEST), free)
    for f in np.flatnonzero(size != free):
        a[f, 0] = size[f]
        others = vector[f, 1:] - information[f, 1:, 0] * size[f]
        a[f, 1:] = np.linalg.solve(information[f, 1:, 1:], others)
    inverse = np.linalg.inv(information)
    schur = 1.0 / inverse[:, 0, 0]  # information of the amplitude, the known faults' free
    # The amplitudes' direction for the first one, the others free.
    along = (size * schur)[:, None] * inverse[:, :, 0]
    prior_information = np.zeros(size.size)
    for j in joints:
        d = j.nuisance_shift(along[j.mine])
        weighed = np.linalg.solve(j.balance.healthy.covariance, d.T).T
        prior_information[j.mine] += np.einsum("fn,fn->f", d, weighed)
    if from_start:
        joints = parts.joints(balances, from_start=True)
        vague = 1.0 / scales**2
        vague[:, 0] *= 1e-9  # not none: a log may tell nothing
        information, vector = _summed(joints, vague)
        a = _solved(information, vector)
        inverse = np.linalg.inv(information)
        along = (a[:, 0] / inverse[:, 0, 0])[:, None] * inverse[:, :, 0]
    frames = time_profiles.shape[2]
    scores, weights, frame_scores, frame_information = np.zeros((4, size.size, frames))
    for j in joints:
        k = j.mine
        seen, contribution = j.frame_shift(a[k])
        left = j.rest - contribution
        if scales.shape[1] > 1:  # else the amplitude is its own direction
            seen, contribution = j.frame_shift(along[k])
        scores[k] += np.einsum("fhn,fhn->fh", seen, left)
        weights[k] += np.einsum("fhn,fhn->fh", seen, contribution)
        acting = size[k, None, None] * j.acting[:, 0]
        frame_scores[k] += np.einsum("fhn,fhn->fh", acting, left)
        frame_information[k] += size[k, None] * np.einsum("fhn,fhn->fh", acting, j.contribution[:, 0])
    blocks = np.arange(0, frames, stretches.frames)
    u = np.add.reduceat(scores, blocks, axis=1)
    w = np.add.reduceat(weights, blocks, axis=1).clip(1e-100)
    count = w.sum(axis=1) ** 2 / np.sum(w**2, axis=1)
    reduced_chi_square = np.sum(u**2, axis=1) / w.sum(axis=1) * count / np.maximum(count - 2.0, 1.0)
    reduced_chi_square = np.maximum(reduced_chi_square, 1.0)
    directions = {n: np.einsum("fp,fpn->fn", along, c) for n, c in parts.columns.items()}
    known = known_scatter(balances, directions)
    overdispersion = _scatter(u, w, time_profiles[:, 0], known, prior_information, blocks)
    overdispersion = overdispersion.clip(stretches.least)
    found = departures(balances, parts, overdispersion, from_start=from_start)
    precision = found.information
    size = np.where(parts.signed, np.clip(found.size, 0.0, GREATEST), found.size)
    # What healthy stretches scatter by differs from fault to fault: gains that are compared leave it out.
    gain = _gain(departures(balances, parts, np.ones(size.size), from_start=from_start), size)
    gain = np.maximum(gain, schur * size * (free - 0.5 * size))
    ratio = _gain(quasi_likely(balances, parts, overdispersion, from_start=from_start), size)
    spoken = np.maximum(u + w, 0.0)
    behind = spoken.sum(axis=1) ** 2 / np.maximum(np.sum(spoken**2, axis=1), 1e-300)
    score = log_odds(ratio, behind, scales[:, 0] ** 2 * precision)
    likely = np.array([np.log(2.0) + log_normal(z) for z in (size * np.sqrt(precision)).tolist()])
    score += np.where(parts.signed, likely, 0.0)
    most = np.maximum(GREATEST, np.abs(size))
    while_acting = _while_acting(frame_scores, frame_information, overdispersion)
    active_amplitude = np.clip(size * while_acting, -most, most)
    variance = 1.0 / precision + np.maximum(reduced_chi_square - overdispersion, 0.0) / schur
    columns = np.column_stack(
        [size, variance, active_amplitude, gain, overdispersion, reduced_chi_square, behind, score]
    )
    return [Fit(*row) for row in columns.tolist()]


def _summed(joints: Sequence[Joint], precision: Array) -> tuple[Array, Array]:
    """Information (f, p, p) and vector (f, p) of all balances, and of a prior's precision (f, p)."""
    information = precision[:, :, None] * np.eye(precision.shape[1])
    vector = np.zeros(precision.shape)
    for j in joints:
        information[j.mine] += j.information
        vector[j.mine] += j.vector
    return information, vector


def _solved(information: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(information, vector[..., None])[..., 0])


def log_normal(z: float) -> float:
    """Logarithm of the normal distribution function; `scipy.special` takes a quarter of a second to import.

    Examples
    --------
    >>> round(log_normal(0.0), 6), round(log_normal(-50.0), 3)
    (-0.693147, -1254.831)
    """
    if z > 0.0:
        return math.log1p(-0.5 * math.erfc(z / math.sqrt(2.0)))
    if z > -30.0:
        return math.log(0.5 * math.erfc(-z / math.sqrt(2.0)))
    r = 1.0 / z**2  # the asymptotic series: erfc is too small to be written from here on
    return -0.5 * z**2 - math.log(-z * math.sqrt(2.0 * math.pi)) + math.log1p(-r * (1 - r * (3 - 15 * r)))


def _gain(found: Departures, size: Array) -> Array:
    """Log likelihood ratio (f,) of amplitudes of a size against none."""
    return size * found.information * (found.size - 0.5 * size)


def quasi_likely(
    balances: Mapping[str, BalancePosterior], parts: Parts, overdispersion: Array, *, from_start: bool
) -> Departures:
    """Amplitudes by a quasi-likelihood (Wedderburn 1974, doi 10.1093/biomet/61.3.439): rows err as their
    noise says, and as much as healthy stretches scatter beyond it.

    A unit whose balances close badly differs more from log to log as well, so that from the start all is less
    sure; what changes within a healthy log is stated as it is.
    """
    if not from_start:
        return departures(balances, parts, 1.0 + overdispersion, from_start=False)
    found = departures(balances, parts, np.ones_like(overdispersion), from_start=True)
    return Departures(found.size, found.information / (1.0 + overdispersion))


def log_odds(ratio: Array, blocks: Array, amplitude_variance_ratio: Array) -> Array:
    """Log odds (f,) of faults against none, before how common they are.

    Parameters
    ----------
    ratio : log of the quasi-likelihood ratio. blocks : stretches that speak for the fault.
        amplitude_variance_ratio : prior variance of the amplitude over that in the log, for what the freedom
        to choose it is worth (Laplace's approximation).
    """
    return ratio * blocks / (blocks + FEW_STRETCHES) - 0.5 * np.log1p(amplitude_variance_ratio)


def _while_acting(u: Array, w: Array, overdispersion: Array) -> Array:
    """Amplitudes (f,) of faults while they act, over their means: 2 for one that acts half the time.

    Of the frames' amplitudes, each is weighed by itself; what their errors add to their squares is taken off.
    """
    acts = w > 1e-3 * w.max(axis=1, initial=1e-300, keepdims=True)
    square = np.sum(np.where(acts, np.square(u + w) / np.where(acts, w, 1.0), 0.0), axis=1)
    square -= overdispersion * acts.sum(axis=1)
    total = np.sum(u + w, axis=1, where=acts)
    # Where its frames speak against it all together, they do not tell how it comes and goes.
    return np.asarray(np.maximum(np.divide(square, total, out=np.ones_like(total), where=total > 1e-9), 1.0))


def _scatter(
    u: Array, w: Array, time_profiles: Array, known: Array, prior_information: Array, blocks: Indices
) -> Array:
    """Factor (f,) by which scores scatter more than their information says.

    It is that of healthy time: of the unit's baseline in the direction at hand (`known_scatter`), and of the
    log's stretches in which the fault does not act (of all, where it always acts). How badly a fault's own
    time is explained must not make the fault look like chance. The baseline counts as `PRIOR_FREEDOM` of
    them (moderated variance: Smyth 2004, doi 10.2202/1544-6115.1027).

    Parameters
    ----------
    time_profiles : (f, h) of the faults. prior_information : (f,), what the unit's prior holds of each.
        blocks : first frames of stretches.
    """
    lengths = np.diff(np.append(blocks, time_profiles.shape[1]))
    acts = np.add.reduceat(np.minimum(time_profiles, 1.0), blocks, axis=1) / lengths
    later = time_profiles[:, :1] < 0.5
    quiet = np.where(later, (1.0 - acts) * w, w)
    quiet_information = quiet.sum(axis=1)
    stretches = np.maximum(quiet_information**2 / np.maximum(np.sum(quiet**2, axis=1), 1e-300) - 1.0, 0.0)
    # What the unit's prior holds, stretches of the log do not.
    stretches *= np.where(
        later[:, 0], quiet_information / np.maximum(quiet_information + prior_information, 1e-300), 1.0
    )
    own = np.sum(quiet * u**2 / w, axis=1) / np.maximum(quiet_information, 1e-300)
    return np.asarray((PRIOR_FREEDOM * known + stretches * own) / (PRIOR_FREEDOM + stretches))


def known_scatter(balances: Mapping[str, BalancePosterior], directions: Mapping[str, Array]) -> Array:
    """That factor by the unit's baseline alone, (f,), for changes (f, n) of each balance's coefficients."""
    information, scatter = 0.0, 0.0
    for name, d in directions.items():
        e = balances[name]
        here, before, seen = (
            np.einsum("fi,ij,fj->f", d, m, d) for m in (e.total, e.healthy.information, e.healthy.scatter)
        )
        known = np.where(before > 0.0, seen / np.where(before > 0.0, before, 1.0), UNKNOWN_SCATTER)
        information, scatter = information + here, scatter + here * known
    return np.asarray(scatter / np.maximum(information, 1e-300))
