"""Faults' amplitudes with healthy changes of the coefficients marginalised.

A fault moves a balance's coefficients by its amplitude times its columns: from the unit's own, where it was
there before the first frame, or from those before its onset. Healthy coefficients change as well: from log to
log (`Effects.log_variance`), and within one by what changes in minutes and by the regime. A law errs by an
amount of its own in every duty, so a change of duty is a draw as a change of log is, the more so the less
alike the information before and after it.

What healthy logs differ by, and stretches scatter by, is Student's t: one log or stretch may be unusual.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.bins import FRAME_S

if TYPE_CHECKING:
    from fdd.diagnosis.fitting import BalancePosterior, Parts

Array = NDArray[np.float64]

WITHIN_FRAMES = 300.0
"""Frames (150 s) in which the random walk of a healthy unit's coefficients has the standard deviation
`Effects.within`."""
VAGUE = 1e3
"""Prior standard deviation of an amplitude: uninformative."""
STUDENT = 4.0
"""Degrees of freedom of Student's t of what a unit's healthy logs differ by, and of the scores of its healthy
stretches. The likeliest are 3 to 7, by balance, for logs that the spreads were not learnt from (140 simulated
units), and 4 for stretches (25 of them). Lange, Little and Taylor 1989 (doi
10.1080/01621459.1989.10478852) take 4 where nothing is known."""


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
    share = inverse[..., 0] * np.sum(along * _times(lost, along), axis=-1)
    return Departures(np.asarray(size), np.asarray(1.0 / inverse[..., 0]), np.asarray(share))


def _part(
    e: BalancePosterior, g: Array, time_profiles: Array, overdispersion: Array, *, from_start: bool
) -> tuple[Array, Array, Array]:
    """One balance's scores (…, f, p) and information (…, f, p, p) of the amplitudes, healthy changes of the
    coefficients marginalised; and how much information a relative increase of the prior's variance costs.

    Noise of κ times the variance is a prior of κ times the precision, and all information divided by κ.

    Parameters
    ----------
    g : (f, p, n) columns. time_profiles : (f, p, h). overdispersion : (…, f), κ.
    """
    f, p, n = g.shape
    flat = e.information.reshape(len(e.information), -1)
    sums = (time_profiles @ flat).reshape(f, p, n, n)
    moved = _times(sums, g)
    both = np.stack([(time_profiles[:, i, None] * time_profiles) @ flat for i in range(p)], axis=1)
    contribution = _times(both.reshape(f, p, p, n, n), g[:, None])  # of the second to the first's scores
    information = np.sum(g[:, :, None] * contribution, axis=-1)
    k, prior = overdispersion[..., None, None], np.linalg.inv(e.healthy.covariance)
    seen = e.rest.sum(axis=0) + e.total @ e.solution
    if from_start:
        own, contribution, total = e.healthy.mean, moved, e.total
        vector, inverse_variance = seen - e.total @ own, prior
    else:
        by_frames = np.asarray(np.linalg.inv(k * prior + e.total), dtype=np.float64)
        own = _times(by_frames, k[..., 0] * (prior @ e.healthy.mean) + seen)[..., None, :]
        first, taken = sums[:, 0], moved @ by_frames  # symmetric
        information = information - taken @ np.swapaxes(moved, -1, -2)
        contribution = contribution[:, 0] - taken @ first
        total = np.asarray(both.reshape(f, p, p, n, n)[:, 0, 0] - first @ by_frames @ first)
        inverse_variance = np.linalg.inv(changes(e, first))
    rest = time_profiles @ e.rest + _times(sums, e.solution - own)
    marginal = np.linalg.inv(k * inverse_variance + total)
    by_one = contribution @ marginal
    if from_start:
        own_shift = by_one
    else:
        vector = rest[..., 0, :]
        own_shift = (moved - by_one @ first) @ by_frames
    score = np.sum(g * rest, axis=-1) - _times(by_one, vector)
    information = information - by_one @ np.swapaxes(contribution, -1, -2)
    return score / k[..., 0], information / k, own_shift @ prior @ np.swapaxes(own_shift, -1, -2)


def _times(matrices: Array, vectors: Array) -> Array:
    """Matrices times vectors, over the axes before them."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def changes(e: BalancePosterior, after: Array) -> Array:
    """Covariance (f, n, n) of the change of a healthy log's coefficients between before and after an onset;
    `after` (f, n, n) is the information since it."""
    healthy, frames = e.healthy, len(e.information)
    unlike = 1.0 - _alike(e, e.total - after, after)
    # A load's coefficients vary from log to log since loads do, which no change of duty brings about.
    by_duty = np.where(healthy.own, healthy.log_variance, 0.0)
    # Two halves of a log differ no more than two logs do; of epochs, which are logs, that is taken out.
    most = np.where(healthy.log_variance > 0.0, 2.0 * healthy.log_variance, np.inf)
    own = np.minimum(np.square(healthy.within) * frames / WITHIN_FRAMES, most)
    own = own + 2.0 * unlike[:, None] * by_duty
    # Between the means of two halves lies half of a log.
    warmed = 0.5 * frames * FRAME_S * healthy.warming * np.ones_like(healthy.mean)
    return np.asarray(own[:, :, None] * np.eye(own.shape[1]) + np.outer(warmed, warmed))


def _alike(e: BalancePosterior, before: Array, after: Array) -> Array:
    """Cosine similarity (f,) of the information matrices before and after, scaled by the standard deviation
    from log to log: 1 where the duty is the same."""
    std = np.sqrt(e.healthy.log_variance)
    one, two = (x * std * std[:, None] for x in (before, after))
    own = np.sqrt(np.sum(one * one, axis=(1, 2)) * np.sum(two * two, axis=(1, 2)))
    # Where all is before or all is after, the rest is rounding, which resembles nothing.
    rounding = 1e-9 * np.sum(np.square(one + two), axis=(1, 2))
    return np.asarray(np.clip(np.sum(one * two, axis=(1, 2)) / (own + rounding + 1e-300), 0.0, 1.0))


def unusual(balances: Mapping[str, BalancePosterior], parts: Parts, overdispersion: Array) -> Array:
    """Excess (f,) of a log's variance about its unit over the usual one, by the directions of the
    coefficients in which no fault acts. What logs differ by is a multivariate Student's t: one that is
    unusual is so in all directions. The variance is the posterior mean of its scale, no less than usual."""
    square, count = np.zeros((2, len(parts.signed)))
    for name, columns in parts.columns.items():
        e, mine = balances[name], np.flatnonzero(columns[:, 0].any(axis=1))
        root = np.linalg.cholesky(e.healthy.covariance)
        told, turned = np.linalg.eigh(root.T @ e.total @ root)
        basis = root @ turned / np.sqrt(told.clip(1e-9) * (1.0 + told.clip(1e-9)))
        weight = told.clip(0.0) / (1.0 + told.clip(0.0))
        off = (e.rest.sum(axis=0) + e.total @ (e.solution - e.healthy.mean)) @ basis
        acting = parts.time_profiles[mine] @ e.information.reshape(len(e.information), -1)
        acting = acting.reshape(*acting.shape[:2], *e.total.shape)
        sums = np.einsum("fpij,fpj->fpi", acting, columns[mine]) @ basis
        _, size, q = np.linalg.svd(sums, full_matrices=False)
        q = np.where(size[..., None] > 1e-9 * size[:, :1, None], q, 0.0)
        left = off - np.einsum("fpi,fp->fi", q, q @ off)
        square[mine] += np.square(left) @ weight
        count[mine] += weight.sum() - np.square(q).sum(axis=1) @ weight
    square /= 1.0 + overdispersion
    return np.asarray(np.maximum(square - count, 0.0) / (STUDENT + count))


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
