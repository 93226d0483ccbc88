"""How strongly the balances speak for each fault, over every onset.

A fault adds its amplitude ``a`` times its columns ``G`` times its course ``φ`` to the balances' coefficients.
With what held before integrated out, its amplitude has information ``λ`` and score ``b``, and by sums over
hops every onset costs the same:

    λ = Gᵀ[Σφ²M - (ΣφM) T (ΣφM)]G,   b = Gᵀ[Σφm - (ΣφM) T (P⁻¹μ + Σm)],   T = (P⁻¹ + ΣM)⁻¹

P and μ are the unit's own prior. Three things keep ``a² λ`` from passing for evidence that it is not:

- A healthy unit's coefficients change as well, by N(0, R), at the same moment: that change is integrated out,
  alike for all hypotheses.
- The hops' own scores about the fitted model say how far the amplitude really scatters: the sandwich (or
  cluster robust) factor κ, from blocks of two seconds (Liang and Zeger 1986, doi 10.1093/biomet/73.1.13). It
  is measured in the log itself, whatever the load, the noise and the structure of the machine.
- That factor rests on few blocks, so the ratio of likelihoods is that of Student's t with as many degrees of
  freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from fdd.diagnosis.hypotheses import Hypothesis
from fdd.residuals.effects import Effects
from fdd.residuals.ledger import widened

Array = NDArray[np.float64]
Sums = tuple[Array, Array, Array, Array]

RAMP_HOPS = 24
"""Hops over which a ramp grows to its full size: 12 s."""
DRIFT_HOPS = 100
"""Hops in which a drift grows by one: 50 s."""
BLOCK_HOPS = 4
"""Hops of a block whose errors may hang together: 2 s."""
LEAST_BEFORE, LEAST_AFTER = 6, 6
"""Hops before and after an onset that is looked for inside a log."""
SWITCH_COST = 6.0
"""Log-likelihood that one switching on or off of an intermittent fault has to earn."""


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
    vector: Array  # (h, n)
    inverse: Array  # (n, n), T
    solution: Array  # (n,), of all hops without any fault
    within: Array  # (n,), std of what a healthy log's coefficients change by
    between: Array  # (n,), and of what one log differs by from another


@dataclass
class Amplitude:
    """A hypothesis with its course, fitted: what the decision needs of it."""

    hypothesis: Hypothesis
    course: Array  # (h,)
    kind: str  # step, ramp, intermittent
    onset: int
    size: Array  # (q,)
    covariance: Array  # (q, q), sandwich and model error
    gain: float  # half the quadratic form, without any correction
    kappa: float
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
            self.balances[name] = Explained(
                m, v, inverse, inverse @ (prior @ e.mean + v.sum(axis=0)), e.within, e.between
            )
        inside = np.arange(LEAST_BEFORE, self.hops - LEAST_AFTER)
        first = [0] if from_start and self.hops > LEAST_AFTER else []
        self.onsets = np.concatenate([np.array(first, dtype=np.int64), inside])
        self._sums: dict[tuple[str, str], tuple[Array, Array]] = {}

    def _over_onsets(self, name: str, kind: str) -> tuple[Array, Array]:
        """Information (k, n, n) and score (k, n) of a balance's change at every onset."""
        if (name, kind) not in self._sums:
            b = self.balances[name]
            rest = b.vector - b.information @ b.solution
            if kind == "step":  # suffix sums
                one = two = np.cumsum(b.information[::-1], axis=0)[::-1][self.onsets]
                one_v = np.cumsum(rest[::-1], axis=0)[::-1][self.onsets]
            else:
                phi = np.array([course_of(kind, self.hops, int(t)) for t in self.onsets])
                n = b.vector.shape[1]
                flat = b.information.reshape(self.hops, -1)
                one, two = ((p @ flat).reshape(-1, n, n) for p in (phi, phi**2))
                one_v = phi @ rest
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
            lam = np.repeat(np.diag(1.0 / h.scale**2)[None], self.onsets.size, axis=0)
            b = np.zeros((self.onsets.size, h.scale.size))
            for name, g in self.shared(h):
                s, sv = self._over_onsets(name, kind)
                lam += g.T @ s @ g
                b += (sv - self._moved_by(name, kind, known)) @ g
            size = np.linalg.solve(lam, b[..., None])[..., 0]
            if h.signed:
                size = np.clip(size, 0.0, GREATEST)
            gain = np.einsum("ki,ki->k", b, size) - 0.5 * np.einsum("ki,kij,kj->k", size, lam, size)
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
            pulled = n.course[:, None] * (e.information @ (g @ n.size))
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
        """Amplitude, sandwich and robust score of a hypothesis with a given course."""
        parts = [(h, course), *((n.hypothesis, n.course) for n in known)]
        total = sum(p.scale.size for p, _ in parts)
        lam, b = np.diag(np.concatenate([1.0 / p.scale**2 for p, _ in parts])), np.zeros(total)
        scores, weights = np.zeros((self.hops, total)), np.zeros((self.hops, total, total))
        involved = []
        for name, e in self.balances.items():
            if all(name not in p.columns for p, _ in parts):
                continue
            n = e.solution.size
            # Columns of the faults, and of the change that a healthy unit makes at the same moment.
            direct = np.concatenate(
                [c[:, None, None] * p.columns.get(name, np.zeros((n, p.scale.size)))[None] for p, c in parts]
                + [course[:, None, None] * np.eye(n)[None]], axis=2,
            )  # fmt: skip
            pulled = e.information @ direct
            influence = direct - (e.inverse @ pulled.sum(axis=0))[None]
            both = np.einsum("hnq,hnr->qr", influence, pulled)
            rest = e.vector - e.information @ e.solution
            vector = np.einsum("hnq,hn->q", influence, rest)
            spread = e.between if onset == 0 else e.within
            own = np.linalg.inv(
                both[total:, total:] + np.diag(1.0 / (START_DOUBT * spread if onset == 0 else spread) ** 2)
            )
            across = both[:total, total:] @ own
            lam += both[:total, :total] - across @ both[total:, :total]
            b += vector[:total] - across @ vector[total:]
            involved.append((e, influence, rest, own, both, vector, across))
        a = np.linalg.solve(lam, b)
        q = h.scale.size
        if h.signed and not 0.0 <= a[0] <= GREATEST:
            a[0] = min(max(a[0], 0.0), GREATEST)
            if total > 1:
                a[1:] = np.linalg.solve(lam[1:, 1:], b[1:] - lam[1:, 0] * a[0])
        for e, influence, rest, own, both, vector, across in involved:
            change = own @ (vector[total:] - both[total:, :total] @ a)
            left = rest - (e.information @ (influence @ np.concatenate([a, change]))[..., None])[..., 0]
            seen = influence[:, :, :total] - influence[:, :, total:] @ across.T
            scores += np.einsum("hnq,hn->hq", seen, left)
            weights += np.swapaxes(seen, 1, 2) @ e.information @ seen
        inverse = np.linalg.inv(lam)
        own_information = np.linalg.inv(inverse[:q, :q])
        size = np.asarray(a[:q], dtype=np.float64)
        along = inverse[:, :q] @ (own_information @ size)  # direction of h's own amplitude, the others free
        block = np.arange(self.hops) // BLOCK_HOPS
        u = np.bincount(block, scores @ along)
        w = np.bincount(block, np.einsum("i,hij,j->h", along, weights, along))
        blocks = float(w.sum() ** 2 / max(np.sum(w**2), 1e-300))
        freedom = max(blocks - 2.0, 1.0)
        kappa = max(1.0, float(np.sum(u**2) / max(w.sum(), 1e-300)) * blocks / freedom)
        spread = kappa * inverse[:q, :q]
        free = inverse[:q] @ b  # the amplitude without its bounds: the gain at the bounded one is less
        gain = 0.5 * float(free @ own_information @ free - (free - size) @ own_information @ (free - size))
        square = max(2.0 * gain / kappa, 0.0)
        score = 0.5 * (freedom + 1.0) * np.log1p(square / freedom)
        occam = 0.5 * float(np.linalg.slogdet(np.eye(q) + np.diag(h.scale**2) @ own_information / kappa)[1])
        if h.signed:
            occam -= float(np.log(2.0) + log_ndtr(size[0] / np.sqrt(spread[0, 0])))
        return Amplitude(
            h, course, kind, onset, size, spread, gain, kappa, blocks, score - occam, profile, self.onsets
        )

    def sharpness(self, h: Hypothesis, onset: int) -> float | None:
        """Standard deviation of a hypothesis's amplitude, were it a step from a hop on; None where no
        balance speaks of it."""
        if not self.shared(h) or not self.onsets.size:
            return None
        k = int(np.argmin(np.abs(self.onsets - onset)))
        lam = 0.0
        for name, g in self.shared(h):
            s, _ = self._over_onsets(name, "step")
            lam += float((g.T @ self._softened(name, s[k], int(self.onsets[k])) @ g)[0, 0])
        return float(1.0 / np.sqrt(max(lam, 1e-12)))

    def correlation(self, one: Amplitude, other: Hypothesis) -> float:
        """How alike another hypothesis's columns are in this log, over the course of a fitted one: -1 to
        1."""
        cross = np.zeros((one.size.size, other.scale.size))
        own, others = np.eye(one.size.size) * 1e-12, np.eye(other.scale.size) * 1e-12
        for name, e in self.balances.items():
            g, f = one.hypothesis.columns.get(name), other.columns.get(name)
            if g is None and f is None:
                continue
            moved = np.tensordot(one.course, e.information, axes=1)
            s = np.tensordot(one.course**2, e.information, axes=1) - moved @ e.inverse @ moved
            s = self._softened(name, s, one.onset)
            own += g.T @ s @ g if g is not None else 0.0
            others += f.T @ s @ f if f is not None else 0.0
            if g is not None and f is not None:
                cross += g.T @ s @ f
        drawn = np.linalg.solve(np.linalg.cholesky(own), cross)
        return float(np.linalg.norm(drawn @ np.linalg.inv(np.linalg.cholesky(others)).T, 2))

    def intermittent(self, fit: Amplitude, known: list[Amplitude]) -> Amplitude:
        """The same fault, on and off: the course by dynamic programming over hops, each switch at a cost."""
        course, best = fit.course, fit
        for _ in range(3):
            h, a = fit.hypothesis, best.size
            gain = np.zeros(self.hops)
            for name, g in self.shared(h):
                e = self.balances[name]
                base = e.solution - e.inverse @ (np.tensordot(course, e.information, axes=1) @ (g @ a))
                for n in known:
                    g2 = n.hypothesis.columns.get(name)
                    if g2 is not None:
                        base = base - e.inverse @ (
                            np.tensordot(n.course, e.information, axes=1) @ (g2 @ n.size)
                        )
                rest = e.vector - e.information @ base
                d = g @ a
                gain += rest @ d - 0.5 * np.einsum("i,hij,j->h", d, e.information, d)
            on = _switched(gain / best.kappa, fit.onset)
            if np.array_equal(on, course) or not on.any():
                break
            course = on
            best = self.fitted(h, course, "intermittent", int(np.flatnonzero(on)[0]), fit.profile, known)
        return best


def _switched(gain: Array, onset: int) -> Array:
    """The likeliest on and off of a fault that begins near a hop, (h,)."""
    off, on, trace = 0.0, -SWITCH_COST, []
    for k, g in enumerate(gain):
        come, stay = off - SWITCH_COST, on
        go, rest = on - SWITCH_COST, off
        trace.append((come > stay, go > rest))
        on, off = max(come, stay) + g, max(go, rest)
        if k < onset - BLOCK_HOPS:
            on = -np.inf
    state = on > off
    out = np.zeros(gain.size)
    for k in range(gain.size - 1, -1, -1):
        out[k] = state
        state = (not trace[k][0]) if state else trace[k][1]
    return out
