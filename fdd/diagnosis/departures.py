"""Faults' amplitudes with healthy changes of the coefficients marginalised.

A fault moves a balance's coefficients by its amplitude times its columns: from the unit's own, where it was
there before the first frame, or from those before its onset. Healthy coefficients change as well: from log to
log (`Effects.log_variance`), and within one by what changes in minutes and by the regime. A law errs by an
amount of its own in every duty, so a change of duty is a draw as a change of log is, the more so the less
alike the information before and after it.
"""

from __future__ import annotations

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
    """Covariance (f, n, n) of the change of a healthy log's coefficients between before and after an onset.

    Parameters
    ----------
    after : (f, n, n), information since the onset.
    """
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
