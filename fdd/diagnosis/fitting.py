"""Faults' amplitudes in a log, and how far they really scatter.

A fault adds its amplitude ``a`` times its columns ``G`` times its time profile ``φ`` to the balances'
coefficients. By the rows' noise alone ``a² λ`` overstates the evidence. The overdispersion κ corrects it: the
sandwich (cluster robust) ratio of the variance of scores to their information, from scores summed over
healthy stretches of two seconds of the log and of the unit's baseline (Liang and Zeger 1986, doi
10.1093/biomet/73.1.13). So it is measured on the unit itself, whatever its load, noise and structure. It
multiplies the unit's prior variance as well: a unit whose balances close badly also differs more from log to
log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fdd.diagnosis.departures import BalancePosterior, Departures, departures, freedom, heavy_tailed, matvec
from fdd.residuals.bins import BLOCK_FRAMES
from fdd.residuals.compiled import Array, Flags, Indices

PRIOR_FREEDOM = 2.0
"""Prior degrees of freedom: stretches of 2 s that the baseline's overdispersion counts for, since it varies
from log to log. They are the only ones for a fault present from the first sample."""
UNKNOWN_SCATTER = 3.0
"""Overdispersion of a unit without baseline."""
LEAST_SCATTER = 0.2
"""Lower bound of the overdispersion; below 1 since wander and noise floors are those of the worse units."""
GREATEST = 2.0
"""Upper bound of a severity: 1.0 is gross, and the scale may be off by a factor of two on another machine."""


class Joint:
    """Normal equations, in one balance, of the amplitudes of faults, each fitted jointly with the known ones.

    Parameters
    ----------
    mine : (f,) indices of these faults among all. columns : (f, p, n), of a fault and of the known ones.
        time_profiles : (f, p, h). from_start : by `BalancePosterior.conditional`, for faults present before
        the first frame.

    Attributes
    ----------
    acting : (f, p, h, n) change of the coefficients per amplitude. contribution : the same, of the frames'
        scores. information, vector : (f, p, p) and (f, p) of the amplitudes.
    """

    def __init__(
        self, balance: BalancePosterior, mine: Indices, columns: Array, time_profiles: Array, *,
        from_start: bool = False,
    ) -> None:  # fmt: skip
        self.balance, self.mine = balance, mine
        self.inverse, self.rest = np.diag(balance.variance)[None], balance.rest[None]
        if from_start:
            self.inverse, self.rest = balance.conditional(columns[:, 0])
        self.acting = time_profiles[..., None] * columns[:, :, None, :]
        self.contribution = time_profiles[..., None] * balance.score_contribution(columns)
        self.total_contribution: Array = np.sum(columns[..., None] * balance.moved(time_profiles), axis=2)
        f, p = columns.shape[:2]
        acting = self.acting.reshape(f, p, -1)
        self.information: Array = acting @ np.swapaxes(self.contribution.reshape(f, p, -1), 1, 2)
        total = self.total_contribution
        self.information -= total @ self.inverse @ np.swapaxes(total, 1, 2)
        self.vector: Array = (acting @ self.rest.reshape(len(self.rest), -1, 1))[..., 0]

    def frame_shift(self, a: Array) -> tuple[Array, Array]:
        """Deviation of each frame's coefficients from the log's own, with amplitudes (f, p), and what it adds
        to the frame's score, (f, h, n) each."""
        total = np.einsum("fpz,fp->fz", self.total_contribution, a)
        shift = matvec(self.inverse, total)  # of the log's own variables, the nuisance parameters
        flat = self.balance.basis.reshape(self.balance.deviation.size, shift.shape[1])
        off = np.einsum("fphn,fp->fhn", self.acting, a)
        off -= (shift @ flat.T).reshape(off.shape)
        return off, np.einsum("fphn,fp->fhn", self.contribution, a) - self.balance.shifted(shift)


@dataclass
class Fit:
    """A fault's amplitude.

    Attributes
    ----------
    size, variance : of the amplitude, averaged over its time profile. active_amplitude : amplitude while it
        acts, larger than `size` for an intermittent fault. gain : log likelihood ratio by the rows' own
        variance alone. overdispersion : variance of the scores of healthy stretches over their information.
        reduced_chi_square : the same of the stretches under the fault. blocks : effective number of stretches
        behind it. score : log odds against none, without the prior weight. by_balance : (2, balances) what
        each adds to the log likelihood ratio, and would add if the fault acted there as its law says.
    """

    size: float
    variance: float
    active_amplitude: float
    gain: float
    overdispersion: float
    reduced_chi_square: float
    blocks: float
    score: float
    by_balance: Array


@dataclass(frozen=True)
class Parts:
    """Faults to be fitted, each jointly with those that are known.

    Attributes
    ----------
    columns : balance to (f, p, n), of a fault and of the known ones; of balances that any of them changes.
    time_profiles : (f, p, h). scales : (f, p) prior std of each amplitude. signed : (f,), the fault is a
        severity.
    """

    columns: dict[str, Array]
    time_profiles: Array
    scales: Array
    signed: Flags

    def joints(self, balances: Mapping[str, BalancePosterior], *, from_start: bool = False) -> list[Joint]:
        """In every balance that they change."""
        changed = {name: np.flatnonzero(c.any(axis=(1, 2))) for name, c in self.columns.items()}
        return [
            Joint(balances[n], k, self.columns[n][k], self.time_profiles[k], from_start=from_start)
            for n, k in changed.items()
        ]


class Stretches(NamedTuple):
    """Length of a stretch (frames) whose errors may be correlated, and lower bound of the overdispersion."""

    frames: int = BLOCK_FRAMES
    least: float = LEAST_SCATTER


def fit(
    balances: Mapping[str, BalancePosterior], parts: Parts, *, from_start: bool, stretches: Stretches
) -> list[Fit]:
    """Fit each fault jointly with the known ones; `from_start`: present before the first frame."""
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
    # Direction of the amplitudes for the first one, the known ones fitted to it.
    along = (size * schur)[:, None] * inverse[:, :, 0]
    by_balance = np.zeros((size.size, 2, len(balances)))
    for place, j in zip(map(list(balances).index, parts.columns), joints, strict=True):
        d = along[j.mine]
        expected = 0.5 * np.einsum("fp,fpq,fq->f", d, j.information, d)
        left = j.vector - matvec(j.information, a[j.mine])
        by_balance[j.mine, :, place] = np.stack([np.sum(d * left, axis=1) + expected, expected], axis=1)
    if from_start:
        joints = parts.joints(balances, from_start=True)
        vague = 1.0 / scales**2
        vague[:, 0] *= 1e-9  # not zero: a log may have no information
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
    u, w = (np.add.reduceat(x, blocks, axis=1) for x in (scores, weights))
    w = w.clip(1e-100)
    count = w.sum(axis=1) ** 2 / np.sum(w**2, axis=1)
    reduced_chi_square = np.sum(u**2, axis=1) / w.sum(axis=1) * count / np.maximum(count - 2.0, 1.0)
    reduced_chi_square = np.maximum(reduced_chi_square, 1.0)
    directions = {n: np.einsum("fp,fpn->fn", along, c) for n, c in parts.columns.items()}
    known = known_scatter(balances, directions)
    overdispersion = _scatter(u, w, time_profiles[:, 0], known, blocks)
    overdispersion = overdispersion.clip(stretches.least)
    # The overdispersion differs from fault to fault: gains, which are compared with each other, leave it out.
    plain, found, likely = by_noise_model(balances, parts, overdispersion, from_start=from_start)
    precision = found.information
    size = np.where(parts.signed, np.clip(found.size, 0.0, GREATEST), found.size)
    gain = _gain(plain, np.where(parts.signed, np.clip(plain.size, 0.0, GREATEST), plain.size))
    gain = np.maximum(gain, schur * size * (free - 0.5 * size))
    spoken = np.maximum(u + w, 0.0)
    behind = spoken.sum(axis=1) ** 2 / np.maximum(np.sum(spoken**2, axis=1), 1e-300)
    most = np.maximum(GREATEST, np.abs(size))
    while_acting = _while_acting(frame_scores, frame_information, overdispersion)
    active_amplitude = np.clip(size * while_acting, -most, most)
    # Of a fault that acts a share s of the time a step leaves (1 - s) / s of its gain, and less of one whose
    # law errs. What is left beyond, the log scatters by.
    course = np.abs(active_amplitude) / np.maximum(np.abs(size), 1e-300) - 1.0
    beyond = np.maximum(0.5 * reduced_chi_square * behind - np.maximum(course, 1.0) * gain, 0.0)
    beyond /= 1.0 + overdispersion
    tails = freedom(likely.healthy, behind)
    ratio = heavy_tailed(beyond + _gain(likely, size), tails) - heavy_tailed(beyond, tails)
    occam = 0.5 * np.log1p(scales[:, 0] ** 2 * precision)  # of Laplace's approximation
    score = ratio - occam
    # The posterior's share above zero over the prior's, which is a half: 2 Φ(z).
    above = [math.log1p(math.erf(z)) for z in np.abs(size * np.sqrt(0.5 * precision)).tolist()]
    score += np.where(parts.signed, above, 0.0)
    variance = 1.0 / precision + np.maximum(reduced_chi_square - overdispersion, 0.0) / schur
    rows = (size, variance, active_amplitude, gain, overdispersion, reduced_chi_square, behind, score)
    fits = zip(np.column_stack(rows).tolist(), by_balance, strict=True)
    return [Fit(*[*row, parts_of_gain]) for row, parts_of_gain in fits]


def _summed(joints: Sequence[Joint], precision: Array) -> tuple[Array, Array]:
    """Information (f, p, p) and vector (f, p) summed over balances and a prior of that precision (f, p)."""
    information = precision[:, :, None] * np.eye(precision.shape[1])
    vector = np.zeros(precision.shape)
    for j in joints:
        information[j.mine] += j.information
        vector[j.mine] += j.vector
    return information, vector


def _solved(information: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(information, vector[..., None])[..., 0])


def _gain(found: Departures, size: Array) -> Array:
    """Log likelihood ratio (f,) of amplitudes against none."""
    return size * found.information * (found.size - 0.5 * size)


def by_noise_model(
    balances: Mapping[str, BalancePosterior], parts: Parts, overdispersion: Array, *, from_start: bool
) -> tuple[Departures, Departures, Departures]:
    """Amplitudes with the rows' own noise, with κ times its variance, and by a quasi-likelihood.

    The quasi-likelihood (Wedderburn 1974, doi 10.1093/biomet/61.3.439) has noise of 1 + κ times the variance.
    From the start the unit's prior counts with the same factor, since a unit whose balances close badly
    differs more from log to log as well; the variance of changes within a healthy log is used as it is.
    """
    ones = np.ones_like(overdispersion)
    factors = [ones, overdispersion] if from_start else [ones, overdispersion, 1.0 + overdispersion]
    all_of = departures(balances, parts, np.stack(factors), from_start=from_start)
    plain, found, *likely = (Departures(*x) for x in zip(*all_of, strict=True))
    if from_start:
        likely = [plain._replace(information=plain.information / (1.0 + overdispersion))]
    return plain, found, likely[0]


def _while_acting(u: Array, w: Array, overdispersion: Array) -> Array:
    """Amplitude while acting over the mean amplitude (f,): 2 for a fault that acts half the time. It is the
    mean of the frames' amplitudes weighted by themselves, less the bias by their errors' variance."""
    acts = w > 1e-3 * w.max(axis=1, initial=1e-300, keepdims=True)
    square = np.sum(np.where(acts, np.square(u + w) / np.where(acts, w, 1.0), 0.0), axis=1)
    square -= overdispersion * acts.sum(axis=1)
    total = np.sum(u + w, axis=1, where=acts)
    # Where the frames together speak against the fault the ratio means nothing.
    return np.asarray(np.maximum(np.divide(square, total, out=np.ones_like(total), where=total > 1e-9), 1.0))


def _scatter(u: Array, w: Array, time_profiles: Array, known: Array, blocks: Indices) -> Array:
    """Overdispersion (f,): variance of the stretches' scores over their information.

    It is estimated on healthy time: on the unit's baseline in the fault's direction (`known_scatter`), and on
    the log's stretches in which the fault does not act (on all, where it always acts). The fault's own time
    is left out, since a law that fits it badly would make the fault look like chance. The baseline, by which
    it is `known` (f,), counts as `PRIOR_FREEDOM` degrees of freedom (moderated variance: Smyth 2004, doi
    10.2202/1544-6115.1027). `u`, `w` (f, stretches) are scores and information of stretches, which begin with
    frames `blocks`.
    """
    lengths = np.diff(np.append(blocks, time_profiles.shape[1]))
    acts = np.add.reduceat(np.minimum(time_profiles, 1.0), blocks, axis=1) / lengths
    quiet = np.where(time_profiles[:, :1] < 0.5, (1.0 - acts) * w, w)
    information = quiet.sum(axis=1)
    stretches = information**2 / np.maximum(np.sum(quiet**2, axis=1), 1e-300) - 1.0
    stretches = np.maximum(stretches, 0.0)
    own = np.sum(quiet * u**2 / w, axis=1) / np.maximum(information, 1e-300)
    return np.asarray((PRIOR_FREEDOM * known + stretches * own) / (PRIOR_FREEDOM + stretches))


def known_scatter(balances: Mapping[str, BalancePosterior], directions: Mapping[str, Array]) -> Array:
    """Overdispersion (f,) by the unit's baseline alone, in directions (f, n) of balances' coefficients."""
    information, scatter = 0.0, 0.0
    for name, d in directions.items():
        e = balances[name]
        here, before, seen = (
            np.einsum("fi,ij,fj->f", d, m, d) for m in (e.total, e.healthy.information, e.healthy.scatter)
        )
        known = np.where(before > 0.0, seen / np.where(before > 0.0, before, 1.0), UNKNOWN_SCATTER)
        information, scatter = information + here, scatter + here * known
    return np.asarray(scatter / np.maximum(information, 1e-300))
