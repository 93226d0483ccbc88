"""Faults' amplitudes with healthy changes of the coefficients marginalised.

A fault moves a balance's coefficients by its amplitude times its columns: from the unit's own, where it was
there before the first frame, or from those before its onset. Healthy coefficients change as well: from log to
log (`Effects.log_variance`), within one as a random walk, which a step is not, and by the regime. A law errs
by an amount of its own at every load and speed (`fdd.residuals.effects.duty_profiles`), and in every duty, so
a change of duty is a draw as a change of log is, the more so the less alike the information before and after.

What healthy logs differ by, and stretches scatter by, is Student's t: one log or stretch may be unusual.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fdd.diagnosis.hypotheses import SuffixSums
from fdd.residuals.bins import FRAME_S
from fdd.residuals.compiled import Array, Indices
from fdd.residuals.effects import Effects

if TYPE_CHECKING:
    from fdd.diagnosis.fitting import Parts


WITHIN_FRAMES = 300.0
"""Frames (150 s) in which the random walk of healthy coefficients has the std `Effects.within`."""
MODES = 24
"""Most modes of that walk, which have 97 % of its variance about its mean."""
LEAST_INFORMATION = 0.05
"""Information of a standard normal variable below which it is left out: it would change no amplitude's
information by more than this share."""
VAGUE = 1e3
"""Prior standard deviation of an amplitude: uninformative."""
STUDENT = 4.0
"""Degrees of freedom of Student's t of what a unit's healthy logs differ by, and of the scores of its healthy
stretches. The likeliest are 3 to 7, by balance, for logs that the spreads were not learnt from (140 simulated
units), and 4 for stretches (25 of them). Lange, Little and Taylor 1989 (doi
10.1080/01621459.1989.10478852) take 4 where nothing is known."""


class BalancePosterior:
    """Gaussian posterior of one balance's coefficients in a log, and of how they drift in it.

    Healthy coefficients are drawn about the unit's by the variance from log to log. About that level they
    wander as a random walk does about its mean, by the first modes of its Karhunen-Loève expansion (cosines),
    go with load and speed, and with the viscosity of oil that warms unmeasured. All of it is columns times
    standard normal variables, turned so that these are independent in the posterior, too.

    Parameters
    ----------
    information, vector : (h, n, n) and (h, n) of its frames, the wander marginalised. healthy : effects of
        the unit (the prior), with the scatter of its own healthy logs. duty_profiles : (h, j), see
        `fdd.residuals.effects.duty_profiles`.

    Attributes
    ----------
    total : (n, n) information of all frames. deviation : (h, n), scores of the frames at the unit's
        coefficients. basis, contribution : (h, n, z), columns of the variables, and what a variable adds to
        the frames' scores. values, score, variance : (z,), of each variable its information, its score and
        its posterior variance. own : (n, z), rotation of the level's variables. rest : (h, n), scores of the
        frames at the posterior mean.
    """

    def __init__(self, information: Array, vector: Array, healthy: Effects, duty_profiles: Array) -> None:
        self.information, self.healthy = information, healthy
        self.total: Array = information.sum(axis=0)
        profiles, columns = _healthy_columns(information, healthy, duty_profiles)
        (frames, j), (_, n, z) = profiles.shape, columns.shape
        flat = columns.reshape(-1, z)
        # Sums over frames of M times two profiles: symmetric in both, and asked where columns are.
        (used,) = np.nonzero(flat.any(axis=1))
        (one, other), pair = _of_triangle(j, used // n)
        (row, column), entry = _of_triangle(n, used % n)
        sums = ((profiles[:, one] * profiles[:, other]).T @ information[:, row, column])[pair, entry]
        values, turned = np.linalg.eigh(flat[used].T @ sums @ flat[used])
        seen = values > LEAST_INFORMATION
        self.values, turned = values[seen], turned[:, seen]
        self.own = turned[:n]
        self.basis = (profiles @ (flat @ turned).reshape(j, -1)).reshape(frames, n, -1)
        self.contribution: Array = information @ self.basis
        self.deviation = vector - information @ healthy.mean
        self.score = self.projected(self.deviation)
        self.variance = 1.0 / (1.0 + self.values)
        self.rest = self.deviation - self.contribution @ (self.variance * self.score)

    @cached_property
    def suffix_sums(self) -> SuffixSums:
        """Of the contribution of the variables, in posterior standard deviations."""
        return SuffixSums(self.contribution * np.sqrt(self.variance))

    def moved(self, time_profiles: Array) -> Array:
        """Contribution (…, n, z) of the variables, summed over time profiles (…, h)."""
        flat = self.contribution.reshape(len(self.contribution), -1)
        return (time_profiles @ flat).reshape(*time_profiles.shape[:-1], *self.contribution.shape[1:])

    def schur_complement(self, time_profile: Array) -> Array:
        """Information (n, n) of a change of the coefficients over a time profile (h,), the healthy variables
        eliminated: the Schur complement of their block."""
        moved = self.moved(time_profile)
        squared = np.einsum("h,hij->ij", time_profile**2, self.information)
        return np.asarray(squared - (moved * self.variance) @ moved.T)

    def conditional(self, changes: Array) -> tuple[Array, Array]:
        """Posterior under the prior conditional on no deviation along changes (f, n) of the coefficients.

        A fault present from the first frame shifts the log's own coefficients, so the two cannot be told
        apart within the log. With the prior's variance along the change taken out, the remaining scores show
        how the change scatters from stretch to stretch.

        Returns
        -------
        (f, z, z) and (f, h, n): covariance of the variables, and `rest`, for each change.
        """
        along = np.linalg.solve(np.linalg.cholesky(self.healthy.covariance), changes.T).T
        along /= np.linalg.norm(along, axis=1, keepdims=True).clip(1e-300)
        along = along @ self.own
        taken = along * self.variance
        # Variables that no frame tells keep their variance of 1.
        left = np.sum(taken * along, axis=1) + 1.0 - np.sum(np.square(along), axis=1)
        inverse = np.diag(self.variance) - taken[:, :, None] * (taken / left[:, None])[:, None]
        return inverse, self.deviation - self.shifted(inverse @ self.score)

    def projected(self, scores: Array) -> Array:
        """Scores (z,) of the variables by scores (h, n) of the frames."""
        return np.asarray(scores.ravel() @ self.basis.reshape(scores.size, self.values.size))

    def shifted(self, variables: Array) -> Array:
        """What variables (…, z) add to the frames' scores, (…, h, n)."""
        flat = self.contribution.reshape(self.deviation.size, self.values.size)
        return (variables @ flat.T).reshape(*variables.shape[:-1], *self.deviation.shape)

    def score_contribution(self, changes: Array) -> Array:
        """What changes (…, n) of the coefficients add to the frames' scores, (…, h, n)."""
        n = changes.shape[-1]
        return (changes @ self.information.reshape(-1, n).T).reshape(*changes.shape[:-1], -1, n)


def _of_triangle(size: int, at: Indices) -> tuple[tuple[Indices, Indices], Indices]:
    """Rows and columns of an upper triangle, and places (k, k) in it of entries between rows `at` (k,)."""
    upper = np.triu_indices(size)
    place = np.zeros((size, size), dtype=np.int64)
    place[upper] = place.T[upper] = np.arange(upper[0].size)
    return upper, place[at[:, None], at]


def _healthy_columns(information: Array, healthy: Effects, duty_profiles: Array) -> tuple[Array, Array]:
    """Time profiles (h, j) of the healthy coefficients' standard normal variables, and what these change of
    the coefficients by each profile, (j, n, z); of a log with information (h, n, n)."""
    frames, n = information.shape[:2]
    along, k = (np.arange(frames) + 0.5) / frames, np.pi * np.arange(1, MODES + 1)
    # A log drifts no further than two logs differ, where that is known.
    most = np.where(healthy.log_variance > 0.0, 2.0 * healthy.log_variance, np.inf)
    drifts = np.sqrt(np.minimum(np.square(healthy.within) * frames / WITHIN_FRAMES, most))
    walk = np.sqrt(2.0) * np.cos(along[:, None] * k) / k
    errors = np.sqrt(np.where(healthy.own, healthy.log_variance, 0.0))
    profiles = np.column_stack([walk, duty_profiles])
    std = np.repeat([drifts, errors], [MODES, duty_profiles.shape[1]], axis=0)
    told = np.square(profiles).T @ np.einsum("hii->hi", information) * np.square(std)
    profile, of = np.nonzero(told > LEAST_INFORMATION)
    used, place = np.unique(profile, return_inverse=True)
    columns = np.zeros((used.size + 2, n, n + of.size + 1))
    columns[0, :, :n] = np.linalg.cholesky(healthy.covariance)
    columns[place + 1, of, n + np.arange(of.size)] = std[profile, of]
    columns[-1, :, -1] = healthy.warming
    each = [np.ones(frames), *profiles.T[used], frames * FRAME_S * (along - 0.5)]
    return np.column_stack(each), columns


class Departures(NamedTuple):
    """Amplitudes (f,) of largest likelihood, the known faults' refitted, their information (f,), and the
    share (f,) of their variance that is from what healthy logs differ by."""

    size: Array
    information: Array
    healthy: Array


def departures(
    balances: Mapping[str, BalancePosterior], parts: Parts, overdispersion: Array, *, from_start: bool
) -> Departures:
    """Estimate each fault's amplitude by generalised least squares, healthy changes being random effects.

    Parameters
    ----------
    overdispersion : (f,), factor on the variance of noise; (m, f) for several at once, and so is all that is
        returned. from_start : faults were there before the first frame.
    """
    precision = 1.0 / np.square(parts.scales)
    joint = precision[:, :, None] * np.eye(precision.shape[1])
    joint = np.array(np.broadcast_to(joint, (*overdispersion.shape, *joint.shape[1:])))
    score, lost = np.zeros(joint.shape[:-1]), np.zeros_like(joint)
    for name, columns in parts.columns.items():
        mine = np.flatnonzero(columns.any(axis=(1, 2)))
        profiles, factor = parts.time_profiles[mine], overdispersion[..., mine]
        own, information, less = _part(balances[name], columns[mine], profiles, factor, from_start=from_start)
        score[..., mine, :] += own
        joint[..., mine, :, :] += information
        lost[..., mine, :, :] += less
    inverse = np.linalg.inv(joint)[..., 0]
    size = np.sum(inverse * score, axis=-1)
    along = inverse / inverse[..., :1]  # the known ones follow the first
    share = inverse[..., 0] * np.sum(along * matvec(lost, along), axis=-1)
    return Departures(np.asarray(size), np.asarray(1.0 / inverse[..., 0]), np.asarray(share))


def _part(
    e: BalancePosterior, g: Array, time_profiles: Array, overdispersion: Array, *, from_start: bool
) -> tuple[Array, Array, Array]:
    """One balance's scores (…, f, p) and information (…, f, p, p) of the amplitudes, healthy changes of the
    coefficients marginalised; and how much information a relative increase of the variance from log to log
    costs. `g` (f, p, n) are columns, `time_profiles` (f, p, h).

    Noise of κ (…, f) times the variance is a prior of κ times the precision, and all information over κ.
    """
    f, p, n = g.shape
    flat = e.information.reshape(len(e.information), -1)
    both = np.stack([(time_profiles[:, i, None] * time_profiles) @ flat for i in range(p)], axis=1)
    contribution = matvec(both.reshape(f, p, p, n, n), g[:, None])  # of the second to the first's scores
    information = np.sum(g[:, :, None] * contribution, axis=-1)
    score = np.sum(g * (time_profiles @ e.deviation), axis=-1)
    sums = e.moved(time_profiles)
    moved = np.sum(g[..., None] * sums, axis=2)  # (f, p, z)
    k = overdispersion[..., None, None]
    weight = 1.0 / (k + e.values)
    shift = moved * weight
    information = information - shift @ np.swapaxes(moved, -1, -2)
    score = score - shift @ e.score
    if not from_start:
        first = both.reshape(f, p, p, n, n)[:, 0, 0]
        root = np.sqrt(by_duty(e, first))
        changed = root[..., None] * sums[:, 0]
        transposed = np.swapaxes(changed, -1, -2)
        total = root[..., None] * first * root[..., None, :] - (changed * weight) @ transposed
        by_change = contribution[:, 0] * root[:, None] - shift @ transposed
        vector = root * (time_profiles[:, 0] @ e.deviation) - (changed * weight) @ e.score
        by_one = by_change @ np.linalg.inv(k * np.eye(n) + total)
        score = score - matvec(by_one, vector)
        information = information - by_one @ np.swapaxes(by_change, -1, -2)
        shift = shift - by_one @ (changed * weight)
    own_shift = shift @ e.own.T
    return score / k[..., 0], information / k, own_shift @ np.swapaxes(own_shift, -1, -2)


def by_duty(e: BalancePosterior, after: Array) -> Array:
    """Variance (f, n) of the change of a healthy log's coefficients by a change of duty at an onset; `after`
    (f, n, n) is the information since it.

    It goes by the cosine similarity of the information before and after, scaled by the standard deviation
    from log to log: 1 where the duty is the same.
    """
    std = np.sqrt(e.healthy.log_variance)
    one, two = (x * std * std[:, None] for x in (e.total - after, after))
    own = np.sqrt(np.sum(one * one, axis=(1, 2)) * np.sum(two * two, axis=(1, 2)))
    # Where all is before or all is after, the rest is rounding, which resembles nothing.
    rounding = 1e-9 * np.sum(np.square(one + two), axis=(1, 2))
    alike = np.clip(np.sum(one * two, axis=(1, 2)) / (own + rounding + 1e-300), 0.0, 1.0)
    # A load's coefficients vary from log to log since loads do, which no change of duty brings about.
    own_variance = np.where(e.healthy.own, e.healthy.log_variance, 0.0)
    return np.asarray(2.0 * (1.0 - alike)[:, None] * own_variance)


def matvec(matrices: Array, vectors: Array) -> Array:
    """Matrices times vectors, over the axes before them, as `numpy.matvec` from 2.2 on."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def freedom(healthy: Array, blocks: Array) -> Array:
    """Degrees of freedom (f,) of amplitudes, by Welch's formula (1947, doi 10.1093/biomet/34.1-2.28).

    `healthy` is the share of the variance that is what healthy logs differ by, the rest is noise. `blocks` is
    the effective number of stretches: many make it normal, one alone may be a singular event, as a start is.
    """
    noise = np.square(1.0 - healthy) / np.maximum(blocks, 1.0)
    return np.asarray(STUDENT / np.maximum(np.square(healthy) + noise, 1e-6))


def heavy_tailed(ratio: Array, freedom: Array) -> Array:
    """Log likelihood ratio (f,) by Student's t of what is `ratio` by a normal of the same scale."""
    return np.asarray(0.5 * (freedom + 1.0) * np.log1p(2.0 * np.maximum(ratio, 0.0) / freedom))


def as_normal(ratio: Array, freedom: Array) -> Array:
    """Inverse of `heavy_tailed`."""
    return np.asarray(0.5 * freedom * np.expm1(np.minimum(2.0 * ratio / (freedom + 1.0), 700.0)))
