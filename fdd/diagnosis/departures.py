"""Faults' amplitudes against what healthy logs and regimes differ by.

A fault moves a balance's coefficients by its amplitude times its columns: from the unit's own, where it was
there before the first frame, or from those before its onset. Healthy coefficients depart as well: from log to
log (`Effects.log_variance`), and within one by what changes in minutes and by the regime. A law errs by an
amount of its own in every duty, so a change of duty is a draw as a change of log is, the more so the less
alike the information before and after it.

All coefficients of a balance depart together as Student's t: how far those lie which the fault does not move
says what this log departs by anyhow (`BalanceSpread.freedom`, `change_freedom`), and one direction given the
others is Student's t again (`BalanceSpread.tail`, `change_tail`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.effects import Effects

if TYPE_CHECKING:
    from fdd.diagnosis.fitting import Explained, Parts

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

WITHIN_FRAMES = 300.0
"""Frames in which a healthy unit's coefficients wander off by `Effects.within`: two minutes and a half."""
MOST, LEAST = 2.0, 0.005
"""Range of severities that are looked for."""
VAGUE = 1e3
"""Standard deviation of an amplitude of which nothing is known before."""
HALVINGS = 10
"""Of that range's logarithm: to half a per cent."""
LEAST_DIMENSIONS = 0.3
"""Of a balance that tells next to nothing."""


@dataclass(frozen=True)
class _Part:
    """One balance's share.

    Attributes
    ----------
    mine : (f,) faults among all. score, information : (f, p) and (f, p, p), of their amplitudes and the known
        faults', beside what healthy coefficients may do. drawn, by_one : (f, n) and (f, p, n), where
        coefficients are drawn without faults, and by one of size 1. precision : (f, n, n), of healthy
        coefficients. dimensions : (f,), of how many the log tells.
    """

    mine: Indices
    score: Array
    information: Array
    drawn: Array
    by_one: Array
    precision: Array
    dimensions: Array
    healthy: Effects

    def split(self, amplitudes: Array) -> tuple[Array, Array]:
        """How far healthy coefficients would lie (f,), and by how much less all is left to explain (f,)."""
        at = self.drawn - np.einsum("fp,fpn->fn", amplitudes, self.by_one)
        far = np.einsum("fi,fij,fj->f", at, self.precision, at)
        curved = np.einsum("fp,fpq,fq->f", amplitudes, self.information, amplitudes)
        return far, 2.0 * np.einsum("fp,fp->f", amplitudes, self.score) - curved


@dataclass(frozen=True)
class Departures:
    """Likeliest amplitudes (f,), known faults' being free, and their information (f,)."""

    size: Array
    information: Array
    parts: list[_Part]
    from_start: bool
    _score: Array
    _joint: Array

    def _others(self, size: Array) -> Array:
        """Amplitudes (f, p) with the first given and the known faults' as likely as can be."""
        rest = self._score[:, 1:] - self._joint[:, 1:, 0] * size[:, None]
        return np.column_stack([size, np.linalg.solve(self._joint[:, 1:, 1:], rest[..., None])[..., 0]])

    def least(self, score: Array, freedom: float) -> Array:
        """Amplitudes (f,) whose own effect has such log likelihood ratios (f,); infinite beyond `MOST`.

        Parameters
        ----------
        freedom : of what is known of the noise.
        """
        one = np.ones_like(self.size)
        parts = [replace(p, drawn=p.by_one[:, 0], score=p.information[:, :, 0]) for p in self.parts]
        own = sum(_placed(p, self._score.shape) for p in parts)
        low, high = np.full_like(one, np.log(LEAST)), np.full_like(one, np.log(MOST))
        at = high
        for _ in range(HALVINGS):
            a = np.exp(at)
            planted = [
                replace(p, drawn=a[p.mine, None] * p.drawn, score=a[p.mine, None] * p.score) for p in parts
            ]
            seen = replace(self, parts=planted, _score=np.asarray(a[:, None] * own))
            shows = seen.odds(a, one, freedom * one) >= score
            low, high = np.where(shows, low, at), np.where(shows, at, high)
            at = 0.5 * (low + high)
        return np.where(low >= np.log(MOST), np.inf, np.exp(high))

    def odds(self, size: Array, heard: Array, freedom: Array) -> Array:
        """Log likelihood ratio (f,) of amplitudes against none.

        Parameters
        ----------
        size : (f,). heard : (f,), share of an amplitude that stands by bounded influence. freedom : (f,), of
            what is known of the noise.
        """
        odds, noise = np.zeros(size.size), np.zeros(size.size)
        none, some = self._others(np.zeros_like(size)), self._others(size)
        for p in self.parts:
            mine = p.mine
            (far, before), (left, after) = p.split(none[mine]), p.split(some[mine])
            gone = (far - left) * heard[mine] ** 2
            e = p.healthy
            joint, (tail, scale) = (
                (e.freedom, e.tail) if self.from_start else (e.change_freedom, e.change_tail)
            )
            spread = scale**2 * by_others(joint, np.maximum(far - gone, 0.0), p.dimensions)
            odds[mine] += 0.5 * (tail + 1.0) * np.sign(gone) * np.log1p(np.abs(gone) / spread / tail)
            noise[mine] += (after - before) * heard[mine] ** 2 - gone
        return np.asarray(odds + 0.5 * (freedom + 1.0) * np.sign(noise) * np.log1p(np.abs(noise) / freedom))


def by_others(freedom: float, left: Array, dimensions: Array) -> Array:
    """Factor (f,) of one direction's variance by how far the others depart, in Student's t of all of them.

    Parameters
    ----------
    left : (f,), squared departure of the others. dimensions : (f,), of how many coefficients the log tells.
    """
    others = np.maximum(dimensions - 1.0, LEAST_DIMENSIONS)
    return np.asarray((freedom + left) / (freedom + others))


def _placed(part: _Part, shape: tuple[int, ...]) -> Array:
    """A balance's scores among all faults, (f, p)."""
    out = np.zeros(shape)
    out[part.mine] = part.score
    return out


def departures(
    balances: Mapping[str, Explained], parts: Parts, kappa: Array, *, from_start: bool
) -> Departures:
    """Weigh each fault's amplitude by what healthy coefficients depart by.

    Parameters
    ----------
    kappa : (f,), by how much noise scatters over its information. from_start : faults were there before the
        first frame.
    """
    precision = 1.0 / np.square(parts.scales)
    joint = precision[:, :, None] * np.eye(precision.shape[1])
    score = np.zeros(precision.shape)
    found = []
    for name, columns in parts.columns.items():
        e = balances[name]
        mine = np.flatnonzero(columns.any(axis=(1, 2)))
        part = _part(e, columns[mine], parts.courses[mine], kappa[mine], from_start=from_start)
        score[mine] += part.score
        joint[mine] += part.information
        found.append(replace(part, mine=mine))
    size = np.linalg.solve(joint, score[..., None])[:, 0, 0]
    information = np.asarray(1.0 / np.linalg.inv(joint)[:, 0, 0])
    return Departures(np.asarray(size), information, found, from_start, score, joint)


def _part(e: Explained, g: Array, courses: Array, kappa: Array, *, from_start: bool) -> _Part:
    """One balance's share for columns (f, p, n) and courses (f, p, h)."""
    f, p, n = g.shape
    flat = e.information.reshape(len(e.information), -1)
    k = kappa[:, None, None]
    sums = (courses @ flat).reshape(f, p, n, n) / k[..., None]
    both = np.stack([(courses[:, i, None] * courses) @ flat for i in range(p)], axis=1).reshape(f, p, p, n, n)
    both /= k[..., None, None]
    prior, total = np.linalg.inv(e.healthy.covariance), e.total / k
    if from_start:
        own = np.broadcast_to(e.healthy.mean, (f, n))
        pulled, inverse_variance = np.einsum("fpij,fpj->fpi", sums, g), np.broadcast_to(prior, total.shape)
    else:
        inverse = np.linalg.inv(prior + total)
        seen = e.rest.sum(axis=0) + e.total @ e.solution
        own = (inverse @ (prior @ e.healthy.mean + seen / kappa[:, None])[..., None])[..., 0]
        both = both - np.einsum("fpij,fjk,fqkl->fpqil", sums, inverse, sums)
        total, pulled = both[:, 0, 0], np.einsum("fpij,fpj->fpi", both[:, 0], g)
        inverse_variance = np.eye(n) / _changes(e, k * sums[:, 0])[:, :, None]
    rest = courses @ e.rest / k + np.einsum("fpij,fj->fpi", sums, e.solution - own)
    if from_start:
        vector = (e.rest.sum(axis=0) + (e.solution - own) @ e.total) / kappa[:, None]
    else:
        vector = rest[:, 0]
    inverse = np.linalg.inv(inverse_variance + total)
    drawn = np.einsum("fij,fj->fi", inverse, vector)
    by_one = np.einsum("fij,fpj->fpi", inverse, pulled)
    score = np.einsum("fpn,fpn->fp", g, rest)
    information = np.einsum("fpi,fpqij,fqj->fpq", g, both, g)
    return _Part(
        np.arange(f), score - np.einsum("fpi,fi->fp", pulled, drawn),
        information - np.einsum("fpi,fqi->fpq", pulled, by_one),
        drawn, by_one, inverse_variance, np.einsum("fij,fji->f", inverse, total), e.healthy,
    )  # fmt: skip


def _changes(e: Explained, after: Array) -> Array:
    """Variance (f, n) of what healthy coefficients change by; after : information since the onset."""
    unlike = 1.0 - _alike(e, e.total - after, after)
    share = len(e.information) / WITHIN_FRAMES
    return np.asarray(np.square(e.healthy.within) * share + 2.0 * unlike[:, None] * e.healthy.log_variance)


def _alike(e: Explained, before: Array, after: Array) -> Array:
    """Correlation (f,) of the information before and after, in what logs differ by: 1 in one regime."""
    std = np.sqrt(e.healthy.log_variance)
    one, two = (x * std * std[:, None] for x in (before, after))
    own = np.sqrt(np.sum(one * one, axis=(1, 2)) * np.sum(two * two, axis=(1, 2)))
    return np.asarray(np.clip(np.sum(one * two, axis=(1, 2)) / np.maximum(own, 1e-300), 0.0, 1.0))
