"""How strongly the balances speak for each fault, over every onset.

A fault adds its amplitude ``a`` times its columns ``G`` times its course ``φ`` to the balances' coefficients.
With what held before integrated out, its amplitude has information ``λ`` and score ``b``, and by sums over
hops every onset costs the same:

    λ = Gᵀ[Σφ²M - (ΣφM) T (ΣφM)]G,   b = Gᵀ[Σφm - (ΣφM) T (P⁻¹μ + Σm)],   T = (P⁻¹ + ΣM)⁻¹

P and μ are the unit's own prior. What such an amplitude is worth says `fdd.diagnosis.fitting`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.fitting import GREATEST, LEAST_SCATTER, Explained, Fit, Joint, drift, fit, known_scatter
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.residuals.effects import Effects
from fdd.residuals.ledger import widened

Array = NDArray[np.float64]
Sums = tuple[Array, Array, Array, Array]

RAMP_HOPS = 24
"""Hops over which a ramp grows to its full size: 12 s."""
DRIFT_HOPS = 100
"""Hops in which a drift grows by one: 50 s."""
FREE_SPREAD = 10.0
"""Of what a unit's healthy logs differ by, how far a fault that nobody knows may change a coefficient."""
LEAST_BEFORE, LEAST_AFTER = 6, 6
"""Hops before and after an onset that is looked for inside a log."""


@dataclass
class Amplitude(Fit):
    """A hypothesis with its course, fitted: what the decision needs of it."""

    hypothesis: Hypothesis
    course: Array  # (h,)
    kind: str  # step, ramp or drift
    onset: int
    profile: Array  # (k,) gain over onsets
    onsets: Array  # (k,)


def course_of(kind: str, hops: int, onset: int | NDArray[np.int64]) -> Array:
    """φ of a step, ramp or drift from a hop on, (hops,), or from each of (k, 1), (k, hops)."""
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
            self.balances[name] = Explained(m, v, e)
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
                phi = course_of(kind, self.hops, self.onsets[:, None])
                n = b.rest.shape[1]
                flat = b.information.reshape(self.hops, -1)
                one, two = ((p @ flat).reshape(-1, n, n) for p in (phi, phi**2))
                one_v = phi @ b.rest
            self._sums[name, kind] = two - one @ b.inverse @ one, one_v
        return self._sums[name, kind]

    def shared(self, h: Hypothesis) -> list[tuple[str, Array]]:
        """Balances that speak of a hypothesis, with its columns."""
        return [(name, g) for name, g in h.columns.items() if name in self.balances]

    def best(self, h: Hypothesis, known: list[Amplitude]) -> Amplitude | None:
        """The hypothesis at its likeliest onset and course, beside faults that are known already."""
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
                moved = course_of(kind, self.hops, self.onsets[:, None]) @ rest
            total = total + moved
        return total

    def unexplained(self, found: Amplitude, known: list[Amplitude]) -> float:
        """What any change of a finding's balances would gain from its onset on, beside all that was found.

        What chance alone would make of as many free coefficients is taken off.
        """
        k = int(np.flatnonzero(self.onsets == found.onset)[0])
        total = 0.0
        for name, _ in self.shared(found.hypothesis):
            s, sv = self._over_onsets(name, found.kind)
            left = (sv - self._moved_by(name, found.kind, known))[k]
            spread = np.diag(np.diag(self.balances[name].healthy.covariance)) * FREE_SPREAD**2
            inside = np.linalg.solve(np.eye(left.size) + spread @ s[k], spread)
            total += 0.5 * float(left @ inside @ left - max(found.misfit, 1.0) * np.trace(inside @ s[k]))
        return total

    def fitted(
        self, h: Hypothesis, course: Array, kind: str, onset: int, profile: Array, known: list[Amplitude]
    ) -> Amplitude:
        """A hypothesis with a given course, beside faults that are known."""
        parts = [h, *(n.hypothesis for n in known)]
        courses = np.array([course, *(n.course for n in known)])
        joints = []
        for name, e in self.balances.items():
            if any(name in p.columns for p in parts):
                columns = np.array([p.columns.get(name, np.zeros(e.solution.size)) for p in parts])
                joints.append(Joint(e, columns, courses))
        found = fit(joints, [p.scale for p in parts], signed=h.signed, from_start=onset == 0)
        found.score += float(np.log(h.commonness))
        return Amplitude(**vars(found), hypothesis=h, course=course, kind=kind, onset=onset, profile=profile,
                         onsets=self.onsets)  # fmt: skip

    def sharpness(self, h: Hypothesis, onset: int) -> float | None:
        """Standard deviation of a hypothesis's amplitude, were it a step from a hop on; None where no
        balance speaks of it."""
        if not self.shared(h) or not self.onsets.size:
            return None
        k = int(np.argmin(np.abs(self.onsets - onset)))
        lam = 0.0
        for name, g in self.shared(h):
            s, _ = self._over_onsets(name, "step")
            lam += float(g @ s[k] @ g)
        scatter = known_scatter([(self.balances[name], g) for name, g in self.shared(h)])
        changes = drift([(self.balances[name], g) for name, g in self.shared(h)])
        return float(np.sqrt(max(scatter, LEAST_SCATTER) / max(lam, 1e-12) + changes))

    def correlation(self, one: Amplitude, other: Hypothesis) -> float:
        """How alike another hypothesis's columns are in this log, over the course of a fitted one: 0 to 1."""
        cross, own, others = 0.0, 1e-12, 1e-12
        for name, e in self.balances.items():
            g, f = one.hypothesis.columns.get(name), other.columns.get(name)
            if g is None and f is None:
                continue
            moved = np.tensordot(one.course, e.information, axes=1)
            s = np.tensordot(one.course**2, e.information, axes=1) - moved @ e.inverse @ moved
            own += float(g @ s @ g) if g is not None else 0.0
            others += float(f @ s @ f) if f is not None else 0.0
            cross += float(g @ s @ f) if g is not None and f is not None else 0.0
        return abs(cross) / float(np.sqrt(own * others))
