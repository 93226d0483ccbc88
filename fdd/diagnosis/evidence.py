"""How strongly the balances speak for each fault, over every onset.

A fault adds its amplitude ``a`` times its columns ``G`` times its course ``φ`` to the balances' coefficients.
With what held before integrated out, its amplitude has information ``λ`` and score ``b``, and by sums over
hops every onset costs the same:

    λ = Gᵀ[Σφ²M - (ΣφM) T (ΣφM)]G,   b = Gᵀ[Σφm - (ΣφM) T (P⁻¹μ + Σm)],   T = (P⁻¹ + ΣM)⁻¹

P and μ are the unit's own prior. Three things keep ``a² λ`` from passing for evidence that it is not:

- A healthy unit's coefficients change as well, by N(0, R), at the same moment: that change is integrated
  out, alike for all hypotheses.
- Scores of healthy stretches of two seconds, of the log and of the unit's baseline, say how far an
  amplitude really scatters: the sandwich (or cluster robust) factor κ (Liang and Zeger 1986, doi
  10.1093/biomet/73.1.13). It is measured on the unit itself, whatever its load, noise and structure.
- That factor rests on few stretches, so the ratio of likelihoods is that of Student's t with as many
  degrees of freedom, and no stretch counts for more than three standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from fdd.diagnosis.hypotheses import Hypothesis
from fdd.residuals.effects import Effects
from fdd.residuals.ledger import widened
from fdd.residuals.rows import BLOCK_HOPS

Array = NDArray[np.float64]
Sums = tuple[Array, Array, Array, Array]

RAMP_HOPS = 24
"""Hops over which a ramp grows to its full size: 12 s."""
DRIFT_HOPS = 100
"""Hops in which a drift grows by one: 50 s."""
LEAST_BEFORE, LEAST_AFTER = 6, 6
"""Hops before and after an onset that is looked for inside a log."""
START_FREEDOM = 2.0
"""And so few degrees of freedom that has, of three healthy logs."""
PRIOR_FREEDOM = 4.0
"""Stretches of 2 s that the baseline's scatter counts for: how far one log's is from another's."""
UNKNOWN_SCATTER = 3.0
"""Scatter of a unit without baseline."""
LEAST_SCATTER = 0.2
"""Least factor: what coefficients wander by, and noises' floors, are assumed with care."""
LOUDEST = 3.0
"""Standard deviations of healthy stretches that one stretch of 2 s may count for: bounded influence (Huber
1981, doi 10.1002/0471725250)."""
GREATEST = 2.0
"""Severity beyond which no fault goes: 1.0 is gross, and a scale may be off by a factor of two on another
machine."""
START_DOUBT = 2.0
"""Times `between`: a fault that was there from the start rests on the unit's baseline alone, whose few logs
know little of
how logs differ."""


@dataclass
class Explained:
    """One balance as evidence sees it: its hops' sums, widened by what wanders, and the solution of all of
    them."""

    information: Array  # (h, n, n)
    inverse: Array  # (n, n), T
    total: Array  # (n, n), information of all hops
    solution: Array  # (n,), of all hops without any fault
    rest: Array  # (h, n), scores that it leaves
    within: Array  # (n,), std of what a healthy log's coefficients change by
    between: Array  # (n,), and of what one log differs by from another
    healthy: Effects  # of the unit, with the scatter of its own healthy logs


@dataclass
class Amplitude:
    """A hypothesis with its course, fitted: what the decision needs of it."""

    hypothesis: Hypothesis
    course: Array  # (h,)
    kind: str  # step, ramp or drift
    onset: int
    size: float
    variance: float  # of the size, by the larger of the two factors
    gain: float  # half the quadratic form, without any correction
    kappa: float  # how healthy stretches scatter, over what their information says
    misfit: float  # and how the fault's own do
    blocks: float
    score: float  # log of the robust likelihood ratio
    profile: Array  # (k,) gain over onsets
    onsets: Array  # (k,)


def course_of(kind: str, hops: int, onset: int) -> Array:
    """φ of a step, ramp or drift from a hop on, (hops,)."""
    since = np.arange(hops) - onset
    if kind == "ramp":
        return np.clip((since + 0.5) / RAMP_HOPS, 0.0, 1.0)
    if kind == "drift":
        return np.maximum((since + 0.5) / DRIFT_HOPS, 0.0)
    return (since >= 0).astype(np.float64)


class Evidence:
    """All balances of one axis over the hops at hand.

    Parameters
    ----------
    entries : balance name to its hops' sums. effects : what the first hop is held against. from_start :
        whether that is
        the unit's baseline, so that a fault may have been there before the first hop.
    """

    def __init__(
        self, entries: dict[str, Sums], effects: dict[str, Effects], *, from_start: bool = True
    ) -> None:
        self.hops = 0
        self.balances: dict[str, Explained] = {}
        for name, (information, vector, rows, _) in entries.items():
            self.hops = len(rows)
            if not rows.any():
                continue
            e = effects[name]
            m, v = widened(information, vector, e.wander)
            prior = np.linalg.inv(e.covariance)
            inverse = np.linalg.inv(prior + m.sum(axis=0))
            solution = inverse @ (prior @ e.mean + v.sum(axis=0))
            self.balances[name] = Explained(
                m, inverse, m.sum(axis=0), solution, v - m @ solution, e.within, e.between, e
            )
        inside = np.arange(LEAST_BEFORE, self.hops - LEAST_AFTER)
        first = [0] if from_start and self.hops > LEAST_AFTER else []
        self.onsets = np.concatenate([np.array(first, dtype=np.int64), inside])
        self._sums: dict[tuple[str, str], tuple[Array, Array]] = {}

    def _over_onsets(self, name: str, kind: str) -> tuple[Array, Array]:
        """Information (k, n, n) and score (k, n) of a balance's change at every onset."""
        if (name, kind) not in self._sums:
            b = self.balances[name]
            if kind == "step":  # suffix sums
                one = two = np.cumsum(b.information[::-1], axis=0)[::-1][self.onsets]
                one_v = np.cumsum(b.rest[::-1], axis=0)[::-1][self.onsets]
            else:
                phi = np.array([course_of(kind, self.hops, int(t)) for t in self.onsets])
                n = b.rest.shape[1]
                flat = b.information.reshape(self.hops, -1)
                one, two = ((p @ flat).reshape(-1, n, n) for p in (phi, phi**2))
                one_v = phi @ b.rest
            self._sums[name, kind] = two - one @ b.inverse @ one, one_v
        return self._sums[name, kind]

    def _softened(self, name: str, information: Array, onset: int) -> Array:
        """Information (n, n) of a change from an onset on, with a healthy unit's own change let in."""
        e = self.balances[name]
        std = START_DOUBT * e.between if onset == 0 else e.within
        return widened(0.5 * (information + information.T), np.zeros(std.size), std)[0]

    def shared(self, h: Hypothesis) -> list[tuple[str, Array]]:
        """Balances that speak of a hypothesis, with its columns."""
        return [(name, g) for name, g in h.columns.items() if name in self.balances]

    def best(self, h: Hypothesis, known: list[Amplitude]) -> Amplitude | None:
        """The hypothesis at its likeliest onset and course, beside faults that are known already.

        The onset goes by the evidence as it is: with a healthy unit's own change let in, a long stretch tells
        no more than a short one, and the onset of the largest amplitude would win, not the likeliest one.
        """
        if not self.shared(h) or not self.onsets.size:
            return None
        found = None
        for kind in h.courses:
            lam, b = np.full(self.onsets.size, 1.0 / h.scale**2), np.zeros(self.onsets.size)
            for name, g in self.shared(h):
                s, sv = self._over_onsets(name, kind)
                lam += np.einsum("i,kij,j->k", g, s, g)
                b += (sv - self._moved_by(name, kind, known)) @ g
            size = np.clip(b / lam, 0.0, GREATEST) if h.signed else b / lam
            gain = size * (b - 0.5 * lam * size)
            k = int(np.argmax(gain))
            if gain[k] > 0.0 and (found is None or gain[k] > found[0]):
                found = float(gain[k]), kind, k, gain
        if found is None:
            return None
        _, kind, k, gain = found
        course = course_of(kind, self.hops, int(self.onsets[k]))
        return self.fitted(h, course, kind, int(self.onsets[k]), gain, known)

    def _moved_by(self, name: str, kind: str, known: list[Amplitude]) -> Array | float:
        """What faults that are known add to a balance's scores at every onset, (k, n)."""
        total: Array | float = 0.0
        e = self.balances[name]
        for n in known:
            g = n.hypothesis.columns.get(name)
            if g is None:
                continue
            pulled = n.course[:, None] * (e.information @ (g * n.size))
            rest = pulled - (e.information @ (e.inverse @ pulled.sum(axis=0)))
            if kind == "step":
                moved = np.cumsum(rest[::-1], axis=0)[::-1][self.onsets]
            else:
                moved = np.array([course_of(kind, self.hops, int(t)) for t in self.onsets]) @ rest
            total = total + moved
        return total

    def fitted(
        self, h: Hypothesis, course: Array, kind: str, onset: int, profile: Array, known: list[Amplitude]
    ) -> Amplitude:
        """Amplitude and robust score of a hypothesis with a given course, beside faults that are known."""
        parts = [h, *(n.hypothesis for n in known)]
        courses = np.array([course, *(n.course for n in known)])
        lam, b = np.diag([1.0 / p.scale**2 for p in parts]), np.zeros(len(parts))
        involved = []
        for name, e in self.balances.items():
            if not any(name in p.columns for p in parts):
                continue
            columns = np.array([p.columns.get(name, np.zeros(e.solution.size)) for p in parts])
            moved = np.tensordot(courses, e.information, axes=1)
            crossed = np.tensordot(courses[:, None] * courses, e.information, axes=1)
            pushed = np.einsum("pij,pj->pi", moved, columns)
            # The faults among each other, and with the change that a healthy unit makes at the same moment.
            among = np.einsum("pi,pqij,qj->pq", columns, crossed, columns) - pushed @ e.inverse @ pushed.T
            beside = np.einsum("pi,pij->pj", columns, crossed[:, 0]) - pushed @ e.inverse @ moved[0]
            own = crossed[0, 0] - moved[0] @ e.inverse @ moved[0]
            spread = START_DOUBT * e.between if onset == 0 else e.within
            eased = np.linalg.inv(own + np.diag(1.0 / spread**2))
            across = beside @ eased
            vectors = courses @ e.rest
            lam += among - across @ beside.T
            b += np.einsum("pi,pi->p", columns, vectors) - across @ vectors[0]
            involved.append((e, columns, moved, eased @ vectors[0], across))
        a = np.linalg.solve(lam, b)
        free = float(a[0])
        if h.signed and not 0.0 <= a[0] <= GREATEST:
            a[0] = min(max(a[0], 0.0), GREATEST)
            a[1:] = np.linalg.solve(lam[1:, 1:], b[1:] - lam[1:, 0] * a[0])
        size = float(a[0])
        inverse = np.linalg.inv(lam)
        told = 1.0 / float(inverse[0, 0])
        along = size * told * inverse[:, 0]  # the amplitudes' direction for h's own, the others free
        scores, weights, healthy = np.zeros(self.hops), np.zeros(self.hops), []
        for e, columns, moved, change, across in involved:
            own = -across.T @ along
            fitted = _off(e, courses, moved, columns * a[:, None], change - across.T @ a)
            seen = _off(e, courses, moved, columns * along[:, None], own)
            left = e.rest - np.einsum("hij,hj->hi", e.information, fitted)
            scores += np.einsum("hn,hn->h", seen, left)
            weights += np.einsum("hi,hij,hj->h", seen, e.information, seen)
            healthy.append((e, along @ columns + own))
        block = np.arange(self.hops) // BLOCK_HOPS
        u: Array = np.bincount(block, scores).astype(np.float64)
        w: Array = np.bincount(block, weights).clip(1e-100)
        blocks = float(w.sum() ** 2 / np.sum(w**2))
        misfit = max(1.0, float(np.sum(u**2) / w.sum()) * blocks / max(blocks - 2.0, 1.0))
        kappa, freedom = self._scatter(u, w, course, healthy)
        if onset == 0:  # one log more, however long it is
            freedom = START_FREEDOM
        gain = 0.5 * told * (free**2 - (free - size) ** 2)  # less than the free amplitude's, if it is bounded
        # No stretch speaks louder than three standard deviations of healthy ones: a fault is there in many.
        z = (u + w) / np.sqrt(kappa * w)
        heard = float(np.sqrt(w) @ np.clip(z, -LOUDEST, LOUDEST)) / max(float(np.sqrt(w) @ z), 1e-300)
        square = max(2.0 * gain / kappa, 0.0) * min(max(heard, 0.0), 1.0) ** 2
        score = 0.5 * (freedom + 1.0) * np.log1p(square / freedom) + np.log(h.commonness)
        score -= 0.5 * np.log1p(h.scale**2 * told / kappa)
        if h.signed:
            score += float(np.log(2.0) + log_ndtr(size * np.sqrt(told / kappa)))
        return Amplitude(
            h, course, kind, onset, size, max(kappa, misfit) / told, gain, kappa, misfit, blocks,
            float(score), profile, self.onsets,
        )  # fmt: skip

    def _scatter(
        self, u: Array, w: Array, course: Array, healthy: list[tuple[Explained, Array]]
    ) -> tuple[float, float]:
        """Factor by which scores scatter more than their information says, and its degrees of freedom.

        It is that of healthy time: of the unit's baseline in the direction at hand, and of the log's
        stretches in which the fault does not act (of all, where it always acts). How badly a fault's own
        time is explained must not make the fault look like chance. The baseline counts as `PRIOR_FREEDOM`
        stretches (moderated variance: Smyth 2004, doi 10.2202/1544-6115.1027).
        """
        block = np.arange(self.hops) // BLOCK_HOPS
        acts = np.bincount(block, np.minimum(course, 1.0)) / np.bincount(block)
        quiet = (1.0 - acts) * w if course[0] < 0.5 else w
        stretches = float(quiet.sum() ** 2 / max(np.sum(quiet**2), 1e-300))
        own = float(np.sum(quiet * u**2 / w)) / max(float(quiet.sum()), 1e-300)
        weight, known = 0.0, 0.0
        for e, d in healthy:
            told = float(d @ e.total @ d)
            before = float(d @ e.healthy.information @ d)
            seen = float(d @ e.healthy.scatter @ d) / before if before > 0.0 else UNKNOWN_SCATTER
            weight, known = weight + told, known + told * seen
        freedom = PRIOR_FREEDOM + max(stretches - 1.0, 0.0)
        kappa = (PRIOR_FREEDOM * known / max(weight, 1e-300) + max(stretches - 1.0, 0.0) * own) / freedom
        return max(kappa, LEAST_SCATTER), freedom

    def sharpness(self, h: Hypothesis, onset: int) -> float | None:
        """Standard deviation of a hypothesis's amplitude, were it a step from a hop on; None where no
        balance speaks of it."""
        if not self.shared(h) or not self.onsets.size:
            return None
        k = int(np.argmin(np.abs(self.onsets - onset)))
        lam = 0.0
        for name, g in self.shared(h):
            s, _ = self._over_onsets(name, "step")
            lam += float(g @ self._softened(name, s[k], int(self.onsets[k])) @ g)
        return float(1.0 / np.sqrt(max(lam, 1e-12)))

    def correlation(self, one: Amplitude, other: Hypothesis) -> float:
        """How alike another hypothesis's columns are in this log, over the course of a fitted one: -1 to
        1."""
        cross, own, others = 0.0, 1e-12, 1e-12
        for name, e in self.balances.items():
            g, f = one.hypothesis.columns.get(name), other.columns.get(name)
            if g is None and f is None:
                continue
            moved = np.tensordot(one.course, e.information, axes=1)
            s = np.tensordot(one.course**2, e.information, axes=1) - moved @ e.inverse @ moved
            s = self._softened(name, s, one.onset)
            own += float(g @ s @ g) if g is not None else 0.0
            others += float(f @ s @ f) if f is not None else 0.0
            cross += float(g @ s @ f) if g is not None and f is not None else 0.0
        return abs(cross) / float(np.sqrt(own * others))


def _off(e: Explained, courses: Array, moved: Array, changes: Array, own: Array) -> Array:
    """How far each hop's coefficients lie off the log's own solution, if these changes act, (h, n).

    Parameters
    ----------
    courses : (p, h). moved : (p, n, n) information that each course weighs. changes : (p, n) of the faults.
    own : (n,) of the healthy unit, with the first fault's course.
    """
    drawn = moved[0] @ own + np.einsum("pij,pj->i", moved, changes)
    return np.asarray(courses.T @ changes + np.outer(courses[0], own) - e.inverse @ drawn)
