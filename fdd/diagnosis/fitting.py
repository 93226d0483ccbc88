"""One fault's amplitude in a log, and how far it really scatters.

A fault adds its amplitude ``a`` times its columns ``G`` times its course ``φ`` to the balances' coefficients.
What keeps ``a² λ`` from passing for evidence that it is not are scores of healthy stretches of two seconds,
of the log and of the unit's baseline: they say how far an amplitude really scatters, the sandwich (or cluster
robust) factor κ (Liang and Zeger 1986, doi 10.1093/biomet/73.1.13). It is measured on the unit itself,
whatever its load, noise and structure. It widens the unit's prior as well: a unit whose balances close badly
also differs more from log to log.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.effects import Effects
from fdd.residuals.rows import BLOCK_HOPS

Array = NDArray[np.float64]

PRIOR_FREEDOM = 2.0
"""Degrees of freedom of the baseline's scatter: how far one log's is from another's. A fault from the start
has no others."""
UNKNOWN_SCATTER = 3.0
"""Scatter of a unit without baseline."""
LEAST_SCATTER = 0.2
"""Least factor: what coefficients wander by, and noises' floors, are assumed with care."""
LOUDEST = 3.0
"""Standard deviations of healthy stretches, or times the median one, that one stretch of 2 s may count for:
bounded influence (Huber 1981, doi 10.1002/0471725250)."""
WITHIN_HOPS = 300.0
"""Hops in which a healthy unit's coefficients wander off by `Effects.within`: two minutes and a half."""
GREATEST = 2.0
"""Severity beyond which no fault goes: 1.0 is gross, and a scale may be off by a factor of two on another
machine."""


class Explained:
    """One balance as evidence sees it.

    Parameters
    ----------
    information, vector : (h, n, n) and (h, n) of its hops, widened by what wanders. healthy : effects of the
        unit, with the scatter of its own healthy logs.
    """

    def __init__(self, information: Array, vector: Array, healthy: Effects) -> None:
        self.information, self.healthy = information, healthy
        self.total: Array = information.sum(axis=0)
        prior = np.linalg.inv(healthy.covariance)
        self.inverse: Array = np.asarray(np.linalg.inv(prior + self.total), dtype=np.float64)
        self.solution: Array = self.inverse @ (prior @ healthy.mean + vector.sum(axis=0))
        self.rest = vector - information @ self.solution

    def beside(self, change: Array) -> Explained:
        """The same hops as stretches see a change (n,) of coefficients that was there from the start.

        The log's own coefficients and such a change are one to all of its hops, so what the unit's prior
        allows along the change is taken from it: what is left differs from stretch to stretch.
        """
        if not change.any():
            return self
        prior: Array = np.asarray(np.linalg.inv(self.healthy.covariance), dtype=np.float64)
        across = self.healthy.covariance - np.outer(change, change) / float(change @ prior @ change)
        other = copy(self)
        other.inverse = np.asarray(np.linalg.solve(np.eye(change.size) + across @ self.total, across))
        pulled = self.rest.sum(axis=0) + self.total @ (self.solution - self.healthy.mean)
        other.solution = self.healthy.mean + other.inverse @ pulled
        other.rest = self.rest + self.information @ (self.solution - other.solution)
        return other


class Joint:
    """Faults in one balance.

    Parameters
    ----------
    columns : (p, n). courses : (p, h).

    Attributes
    ----------
    information, vector : (p, p) and (p,) of the amplitudes.
    """

    def __init__(self, balance: Explained, columns: Array, courses: Array) -> None:
        self.balance, self.columns, self.courses = balance, columns, courses
        self.moved = np.tensordot(courses, balance.information, axes=1)
        crossed = np.tensordot(courses[:, None] * courses, balance.information, axes=1)
        pushed = np.einsum("pij,pj->pi", self.moved, columns)
        self.information: Array = np.einsum("pi,pqij,qj->pq", columns, crossed, columns)
        self.information -= pushed @ balance.inverse @ pushed.T
        self.vector: Array = np.einsum("pi,pi->p", columns, courses @ balance.rest)

    def off(self, a: Array) -> Array:
        """How far each hop's coefficients lie off the log's own solution with these amplitudes, (h, n)."""
        return np.asarray(self.courses.T @ (self.columns * a[:, None]) - self.drawn(a))

    def drawn(self, a: Array) -> Array:
        """How far these amplitudes draw the log's own solution, (n,)."""
        return np.asarray(
            self.balance.inverse @ np.einsum("pij,pj->i", self.moved, self.columns * a[:, None])
        )


@dataclass
class Fit:
    """A fault's amplitude.

    Attributes
    ----------
    size, variance : of the amplitude, as far as its own time scatters. level : of the amplitude while it
        acts, where it comes and goes. gain : half the quadratic form,
        without any correction. kappa, misfit : how healthy stretches scatter, over what their information
        says, and how those of the fault's own time do. blocks : stretches of 2 s behind it. score : log of
        the robust likelihood ratio.
    """

    size: float
    variance: float
    level: float
    gain: float
    kappa: float
    misfit: float
    blocks: float
    score: float


def fit(joints: Sequence[Joint], scales: Sequence[float], *, signed: bool, from_start: bool) -> Fit:
    """Fit the first of some faults beside the others.

    Parameters
    ----------
    joints : in all balances that speak of one of them. scales : prior std of each amplitude. signed : the
        first one is a severity. from_start : it was there before the first hop.
    """
    information = np.diag([1.0 / s**2 for s in scales]) + sum(j.information for j in joints)
    vector = np.sum([j.vector for j in joints], axis=0)
    a: Array = np.asarray(np.linalg.solve(information, vector), dtype=np.float64)
    free = float(a[0])
    if signed and not 0.0 <= free <= GREATEST:
        a[0] = min(max(free, 0.0), GREATEST)
        a[1:] = np.linalg.solve(information[1:, 1:], vector[1:] - information[1:, 0] * a[0])
    size = float(a[0])
    inverse = np.linalg.inv(information)
    told = 1.0 / float(inverse[0, 0])
    gain = 0.5 * told * (free**2 - (free - size) ** 2)  # at its bounds less than the free amplitude's
    # The amplitudes' direction for the first one, the others free.
    along: Array = np.asarray(size * told * inverse[:, 0], dtype=np.float64)
    drawn = [(j.balance, j.drawn(along)) for j in joints]
    held = sum(float(d @ np.linalg.solve(b.healthy.covariance, d)) for b, d in drawn)
    if from_start:
        joints = [Joint(j.balance.beside(j.columns[0]), j.columns, j.courses) for j in joints]
        vague = [1e-9 / scales[0] ** 2, *(1.0 / s**2 for s in scales[1:])]  # not none: a log may tell nothing
        seen_alone = np.diag(vague) + sum(j.information for j in joints)
        a = np.asarray(np.linalg.solve(seen_alone, np.sum([j.vector for j in joints], axis=0)))
        inverse = np.linalg.inv(seen_alone)
        along = np.asarray(a[0] / inverse[0, 0] * inverse[:, 0], dtype=np.float64)
    hops = joints[0].courses.shape[1]
    scores, weights, pulls, pushes = (np.zeros(hops) for _ in range(4))
    directions = []
    for j in joints:
        e = j.balance
        left = e.rest - np.einsum("hij,hj->hi", e.information, j.off(a))
        seen = j.off(along)
        scores += np.einsum("hn,hn->h", seen, left)
        weights += np.einsum("hi,hij,hj->h", seen, e.information, seen)
        acting = size * np.outer(j.courses[0], j.columns[0])
        pulls += np.einsum("hn,hn->h", acting, left)
        pushes += np.einsum("hi,hij,hj->h", acting, e.information, acting)
        directions.append(along @ j.columns)
    block = np.arange(hops) // BLOCK_HOPS
    u: Array = np.bincount(block, scores).astype(np.float64)
    w: Array = np.bincount(block, weights).clip(1e-100)
    blocks = float(w.sum() ** 2 / np.sum(w**2))
    misfit = max(1.0, float(np.sum(u**2) / w.sum()) * blocks / max(blocks - 2.0, 1.0))
    kappa, freedom = _scatter(u, w, joints, directions, held)
    changes = drift([(j.balance, j.columns[0]) for j in joints])
    precision = 1.0 / (kappa / told + changes)
    share = precision * _heard(u, w, kappa) ** 2
    freedom = PRIOR_FREEDOM if from_start else freedom
    # Student's t of the free amplitude about the fault's and about none: what lies beyond a fault's bounds
    # is no fault, and says how far amplitudes scatter.
    odds = (freedom + share * free**2) / (freedom + share * (free - size) ** 2)
    score = 0.5 * (freedom + 1.0) * np.log(odds) - 0.5 * np.log1p(scales[0] ** 2 * precision)
    if signed:
        score += np.log(2.0) + log_normal(float(size * np.sqrt(precision)))
    most = max(GREATEST, abs(size))
    level = float(np.clip(size * _while_acting(pulls, pushes, kappa), -most, most))
    variance = max(kappa, misfit) / told + changes
    return Fit(size, variance, level, gain, kappa, misfit, blocks, float(score))


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


def drift(columns: Sequence[tuple[Explained, Array]]) -> float:
    """Variance of an amplitude by what a healthy unit itself changes over a log: nothing less is a fault."""
    told = sum(float(np.sum(np.square(g / e.healthy.within))) for e, g in columns)
    return len(columns[0][0].information) / WITHIN_HOPS / max(told, 1e-300)


def _heard(u: Array, w: Array, kappa: float) -> float:
    """Share of an amplitude that stands when no stretch speaks louder than three standard deviations of
    healthy ones, or than three times the median one: a fault is there in many."""
    z = (u + w) / np.sqrt(kappa * w)
    loudest = LOUDEST * max(1.0, float(np.median(z)))
    heard = float(np.sqrt(w) @ np.clip(z, -loudest, loudest)) / max(float(np.sqrt(w) @ z), 1e-300)
    return min(max(heard, 0.0), 1.0)


def _while_acting(u: Array, w: Array, kappa: float) -> float:
    """Amplitude of a fault while it acts, over its mean: 2 where it acts half the time.

    Of the hops' amplitudes, each is weighed by itself; what their errors add to their squares is taken off.
    """
    acts = w > 1e-3 * w.max(initial=1e-300)
    u, w = u[acts], w[acts]
    square = float(np.sum(np.square(u + w) / w)) - kappa * w.size
    return max(square / max(float(np.sum(u + w)), 1e-300), 1.0)


def _scatter(
    u: Array, w: Array, joints: Sequence[Joint], directions: Sequence[Array], held: float
) -> tuple[float, float]:
    """Factor by which scores scatter more than their information says, and its degrees of freedom.

    It is that of healthy time: of the unit's baseline in the direction at hand, and of the log's stretches
    in which the fault does not act (of all, where it always acts). How badly a fault's own time is
    explained must not make the fault look like chance. The baseline counts as `PRIOR_FREEDOM` of them
    (moderated variance: Smyth 2004, doi 10.2202/1544-6115.1027).
    """
    course = joints[0].courses[0]
    block = np.arange(course.size) // BLOCK_HOPS
    acts = np.bincount(block, np.minimum(course, 1.0)) / np.bincount(block)
    quiet = (1.0 - acts) * w if course[0] < 0.5 else w
    stretches = max(float(quiet.sum() ** 2 / max(np.sum(quiet**2), 1e-300)) - 1.0, 0.0)
    if course[0] < 0.5:  # what the unit's prior holds, stretches of the log do not
        stretches *= float(quiet.sum() / max(quiet.sum() + held, 1e-300))
    own = float(np.sum(quiet * u**2 / w)) / max(float(quiet.sum()), 1e-300)
    known = known_scatter([(j.balance, d) for j, d in zip(joints, directions, strict=True)])
    freedom = PRIOR_FREEDOM + stretches
    return max((PRIOR_FREEDOM * known + stretches * own) / freedom, LEAST_SCATTER), freedom


def known_scatter(directions: Sequence[tuple[Explained, Array]]) -> float:
    """That factor by the unit's baseline alone, for a change (n,) of each balance's coefficients."""
    told = [float(d @ e.total @ d) for e, d in directions]
    seen = []
    for e, d in directions:
        before = float(d @ e.healthy.information @ d)
        seen.append(float(d @ e.healthy.scatter @ d) / before if before > 0.0 else UNKNOWN_SCATTER)
    return float(np.dot(told, seen) / max(sum(told), 1e-300))
