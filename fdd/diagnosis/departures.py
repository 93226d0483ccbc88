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
    overdispersion : (f,), factor on the variance of noise. from_start : faults were there
        before the first frame.
    """
    precision = 1.0 / np.square(parts.scales)
    joint = precision[:, :, None] * np.eye(precision.shape[1])
    score = np.zeros(precision.shape)
    lost = np.zeros_like(joint)
    for name, columns in parts.columns.items():
        mine = np.flatnonzero(columns.any(axis=(1, 2)))
        profiles, factor = parts.time_profiles[mine], overdispersion[mine]
        own, information, less = _part(balances[name], columns[mine], profiles, factor, from_start=from_start)
        score[mine] += own
        joint[mine] += information
        lost[mine] += less
    size = np.linalg.solve(joint, score[..., None])[:, 0, 0]
    inverse = np.linalg.inv(joint)[:, :, 0]
    along = inverse / inverse[:, :1]  # the known ones follow the first
    share = inverse[:, 0] * np.einsum("fp,fpq,fq->f", along, lost, along)
    return Departures(np.asarray(size), np.asarray(1.0 / inverse[:, 0]), np.asarray(share))


def _part(
    e: BalancePosterior, g: Array, time_profiles: Array, overdispersion: Array, *, from_start: bool
) -> tuple[Array, Array, Array]:
    """One balance's scores (f, p) and information (f, p, p) of the amplitudes, healthy changes of the
    coefficients marginalised; and how much information a relative increase of the prior's variance costs.

    Parameters
    ----------
    g : (f, p, n) columns. time_profiles : (f, p, h).
    """
    f, p, n = g.shape
    flat = e.information.reshape(len(e.information), -1)
    k = overdispersion[:, None, None]
    sums = (time_profiles @ flat).reshape(f, p, n, n) / k[..., None]
    both = np.stack([(time_profiles[:, i, None] * time_profiles) @ flat for i in range(p)], axis=1)
    both = both.reshape(f, p, p, n, n) / k[..., None, None]
    prior, total = np.linalg.inv(e.healthy.covariance), e.total / k
    if from_start:
        own = np.broadcast_to(e.healthy.mean, (f, n))
        contribution = np.einsum("fpij,fpj->fpi", sums, g)
        inverse_variance = np.broadcast_to(prior, total.shape)
    else:
        inverse = np.linalg.inv(prior + total)
        seen = e.rest.sum(axis=0) + e.total @ e.solution
        own = (inverse @ (prior @ e.healthy.mean + seen / overdispersion[:, None])[..., None])[..., 0]
        both = both - np.einsum("fpij,fjk,fqkl->fpqil", sums, inverse, sums)
        total, contribution = both[:, 0, 0], np.einsum("fpij,fpj->fpi", both[:, 0], g)
        inverse_variance = np.linalg.inv(changes(e, k * sums[:, 0]))
    rest = time_profiles @ e.rest / k + np.einsum("fpij,fj->fpi", sums, e.solution - own)
    if from_start:
        vector = (e.rest.sum(axis=0) + (e.solution - own) @ e.total) / overdispersion[:, None]
    else:
        vector = rest[:, 0]
    marginal = np.linalg.inv(inverse_variance + total)
    shift = np.einsum("fij,fj->fi", marginal, vector)
    by_one = np.einsum("fij,fpj->fpi", marginal, contribution)
    if from_start:
        own_shift = by_one
    else:
        before = np.einsum("fpij,fpj->fpi", sums, g) - np.einsum("fij,fpj->fpi", sums[:, 0], by_one)
        own_shift = np.einsum("fij,fpj->fpi", inverse, before)
    score = np.einsum("fpn,fpn->fp", g, rest)
    information = np.einsum("fpi,fpqij,fqj->fpq", g, both, g)
    return (
        score - np.einsum("fpi,fi->fp", contribution, shift),
        information - np.einsum("fpi,fqi->fpq", contribution, by_one),
        np.einsum("fpi,ij,fqj->fpq", own_shift, prior, own_shift),
    )


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
    return np.asarray(np.clip(np.sum(one * two, axis=(1, 2)) / np.maximum(own, 1e-300), 0.0, 1.0))
