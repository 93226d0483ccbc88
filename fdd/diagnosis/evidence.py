"""Evidence of the balances for each fault: amplitudes and log likelihood ratios over every onset.

A fault adds its amplitude ``a`` times its columns ``G`` times its time profile ``φ`` to the balances'
coefficients. With the coefficients before the onset marginalised, its amplitude has information ``λ`` and
score ``b``; suffix sums over frames give every onset at the same cost:

    λ = Gᵀ[Σφ²M - (ΣφMB) T (ΣφMB)ᵀ]G,   b = Gᵀ[Σφm - (ΣφMB) T ΣBᵀm],   T = (I + ΣBᵀMB)⁻¹

B are the columns of what a healthy log's coefficients differ by from the unit's own, about which m is taken
(`BalancePosterior`). `fdd.diagnosis.fitting` turns amplitudes into scores.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fdd.diagnosis.departures import VAGUE, BalancePosterior, as_normal, by_duty, freedom
from fdd.diagnosis.fitting import GREATEST, Fit, Parts, Stretches, by_noise_model, fit, known_scatter
from fdd.diagnosis.hypotheses import (
    DATED,
    DATED_PRIOR,
    SHAPES,
    STEP,
    Hypothesis,
    Shape,
    SuffixSums,
    coming_and_going,
    correlated,
    time_profile_of,
)
from fdd.residuals.compiled import Array, Flags
from fdd.residuals.effects import Effects, duty_profiles

Known = tuple[tuple[int, Shape, int, float], ...]

FREE_SPREAD = 10.0
"""Prior std of an unmodelled fault's change of a coefficient, in the healthy unit's from log to log."""
LEAST_GAIN = 2.0
"""Nats of log likelihood ratio up to which a fault is not fitted: its score, less by what a free amplitude
gains by chance, is about 0 at most."""
Z80 = 1.2816
"""Standard normal's 90 % quantile: an 80 % interval either way."""
TIMING_DOUBT = 0.1
"""Error of a time profile as a share of the fault's effect, for no fault keeps to a line: with it 80 %
intervals held the onset of 79 % of 200 simulated faults, with 0.08 of 77 %."""
LAW_DOUBT = 0.25
"""Model error of a fault's law, as a share of its effect: flow by the root of pressure and flow by pressure
differ by that much over a range from none to full (4 to 6 % of the energy)."""
ROUNDS = 3
"""In which amplitude and course of a fault that comes and goes are found in turn."""
LEAST_BEFORE, LEAST_AFTER = 4, 6
"""Fewest stretches before, and frames after, an onset inside a log: a machine that starts up is no reference
for itself."""


@dataclass
class Amplitude(Fit):
    """A fitted hypothesis: amplitude, shape of the time profile and onset."""

    hypothesis: Hypothesis
    time_profile: Array  # (h,)
    shape: Shape  # of the likeliest time profile, and its onset
    onset: int
    onset_gains: Array  # (shapes, k) gains of all shapes of time profiles over onsets
    onsets: Array  # (k,)
    begun: Array | None = None  # (h,) of what comes and goes, probability that it has begun

    @property
    def scatter(self) -> float:
        """Variance of the stretches' scores over their information, by healthy time or under the fault."""
        return max(self.overdispersion, self.reduced_chi_square)

    def onset_quantiles(self, *shares: float) -> list[int]:
        """Frames up to which shares of the onset's posterior lie, over all shapes; the first is the step."""
        if self.begun is not None:
            within = np.searchsorted(self.begun, shares).clip(max=self.begun.size - 1)
            return [int(k) for k in within]
        scatter = self.scatter + TIMING_DOUBT**2 * self.gain
        weight = np.exp((self.onset_gains - self.onset_gains.max()) / scatter)
        weight = DATED_PRIOR[: len(weight)] @ weight
        below = np.cumsum(weight) / weight.sum()
        return [int(self.onsets[np.searchsorted(below, share)]) for share in shares]


def there_before(shape: Shape, onset: int) -> bool:
    """Whether a fault was there before the first frame. One that grows from there on is a change within the
    log, held against what healthy logs change by."""
    return onset == 0 and shape == STEP


def _likeliest(gain: Array) -> int:
    """Place of the largest gain over onsets; the middle of a plateau, which frames that tell nothing make."""
    best = np.flatnonzero(gain >= (1.0 - 1e-6) * gain.max())
    return int(best[best.size // 2])


def _gain(b: Array, lam: Array, signed: Flags) -> Array:
    """Log likelihood ratios of amplitudes with such scores and information, within their bounds."""
    size = b / lam
    size = np.where(signed, np.clip(size, 0.0, GREATEST), size)
    return np.asarray(size * (b - 0.5 * lam * size))


class Evidence:
    """The posteriors of all balances of one axis over a window of frames.

    Parameters
    ----------
    frames : balance name to its frames' information (h, n, n) and vector (h, n), the wander marginalised;
        balances without information are left out. effects : prior of the coefficients at the first frame.
        from_start : whether that is the unit's baseline, so that a fault may have been present before the
        first frame. stretches : length of correlated errors and lower bound of the overdispersion. duty :
        (h, 2), see `duty_profiles`; None where all frames have the same.

    Attributes
    ----------
    alone : what `fits` last gave without known faults.
    """

    def __init__(
        self, frames: Mapping[str, tuple[Array, Array]], effects: Mapping[str, Effects], *,
        from_start: bool = True, stretches: Stretches = Stretches(), duty: Array | None = None,
    ) -> None:  # fmt: skip
        self.alone: list[Amplitude] = []
        # By the known faults that a hypothesis shares balances with, and by its identity.
        self._kept: dict[Known, dict[int, tuple[Hypothesis, Amplitude | None]]] = {}
        self.stretches = stretches
        self.frames = max((len(m) for m, _ in frames.values()), default=0)
        profiles = duty_profiles(np.zeros((self.frames, 2)) if duty is None else duty)
        self.balances = {n: BalancePosterior(m, v, effects[n], profiles) for n, (m, v) in frames.items()}
        inside = np.arange(LEAST_BEFORE * stretches.frames, self.frames - LEAST_AFTER)
        first = [0] if from_start and self.frames > LEAST_AFTER else []
        self.onsets = np.concatenate([np.array(first, dtype=np.int64), inside])

    def shared(self, h: Hypothesis) -> bool:
        """Whether any balance at hand has columns of a hypothesis."""
        return any(name in self.balances for name in h.columns)

    def fits(self, hypotheses: Sequence[Hypothesis], known: Sequence[Amplitude]) -> list[Amplitude]:
        """Fit hypotheses at their likeliest onsets and time profiles, jointly with known faults; those
        without gain are left out. A known fault matters to those alone that share a balance with it, be it by
        way of another known one, and fits that nothing new matters to are kept."""
        if not self.onsets.size:
            return []
        groups: dict[tuple[int, ...], list[Hypothesis]] = {}
        for h in filter(self.shared, hypotheses):
            groups.setdefault(self._coupled(h, known), []).append(h)
        kept: dict[int, Amplitude | None] = {}
        for places, members in groups.items():
            coupled = [known[i] for i in places]
            beside = tuple((id(k.hypothesis), k.shape, k.onset, k.size) for k in coupled)
            fits = self._kept.setdefault(beside, {})
            new = [h for h in members if id(h) not in fits]
            fits |= {id(h): (h, None) for h in new}
            fits |= {id(f.hypothesis): (f.hypothesis, f) for f in self._fits(new, coupled)}
            kept |= {id(h): fits[id(h)][1] for h in members}
        found = [f for h in hypotheses if (f := kept.get(id(h))) is not None]
        if not known:
            self.alone = found
        return found

    def _coupled(self, h: Hypothesis, known: Sequence[Amplitude]) -> tuple[int, ...]:
        """Places of the known faults in a hypothesis's balances, and of those in the balances of these."""
        reached, places = self.balances.keys() & h.columns.keys(), set[int]()
        touched = [self.balances.keys() & k.hypothesis.columns.keys() for k in known]
        while more := [i for i, names in enumerate(touched) if i not in places and reached & names]:
            places.update(more)
            reached = reached.union(*(touched[i] for i in more))
        return tuple(sorted(places))

    def _fits(self, testable: Sequence[Hypothesis], known: Sequence[Amplitude]) -> list[Amplitude]:
        """As `fits`, whatever balances they share."""
        if not testable:
            return []
        gains = self._gains(testable, known)
        most = gains.max(axis=2)
        # Of two equal ones, the simpler one.
        best = np.argmax(most >= (1.0 - 1e-9) * most.max(axis=0), axis=0)
        found = [
            (h, SHAPES[one], int(self.onsets[_likeliest(gains[one, i])]), gains[:, i])
            for i, (h, one) in enumerate(zip(testable, best.tolist(), strict=True))
            if most[one, i] > LEAST_GAIN
        ]
        early, later = ([x for x in found if there_before(*x[1:3]) is b] for b in (True, False))
        return [*self.fitted(early, known), *self.fitted(later, known)]

    def dated(self, found: Amplitude, known: Sequence[Amplitude], *, steady: bool = False) -> Amplitude:
        """A fault that began within the log, fitted anew at the likeliest of the shapes `DATED` or, unless
        it is `steady`, as one that comes and goes; what drifts, and the end of a fault, as it is."""
        h = found.hypothesis
        if there_before(found.shape, found.onset) or "ramp" not in h.time_profiles:
            return found
        gains = self._dated_gains(h, known)
        # What is there in the first frame was there before it.
        gains[np.ix_([shape.at_once > 0.0 for shape in DATED], self.onsets == 0)] = -np.inf
        best = int(np.argmax(gains.max(axis=1) + found.scatter * np.log(DATED_PRIOR)))
        (anew,) = self.fitted([(h, DATED[best], int(self.onsets[_likeliest(gains[best])]), gains)], known)
        if steady:
            return anew
        courses = [self._coming_and_going(found, known)]
        ends = [k for k in known if k.hypothesis.ends == h.fault]
        if ends:  # which may be a part of its course
            apart = [k for k in known if all(k is not e for e in ends)]
            explained = sum(k.gain for k in ends)
            courses.append(self._coming_and_going(self.refitted(found, apart), apart, explained))
        return max((c for c in courses if c is not None), key=lambda c: c.gain, default=anew)

    def _coming_and_going(
        self, step: Amplitude, known: Sequence[Amplitude], explained: float = 0.0
    ) -> Amplitude | None:
        """A step fitted as a fault that comes and goes, by expectation maximisation; None where that explains
        no more beyond it, and what else is `explained` of its course, than its law's error could."""
        # A steady one leaves too little that breaks could explain.
        left = 0.5 * step.reduced_chi_square * self.frames / self.stretches.frames
        steady = abs(step.active_amplitude) <= abs(step.size) or left < LAW_DOUBT * step.gain
        if step.shape != STEP or steady:
            return None
        now, columns = step, {n: g for n, g in step.hypothesis.columns.items() if n in self.balances}
        for _ in range(ROUNDS):
            score, information = np.zeros((2, self.frames))
            for name, g in columns.items():
                score += (self.balances[name].rest - self._moved(name, [*known, now])) @ g
                information += self.balances[name].score_contribution(g) @ g
            a = now.active_amplitude
            score += information * now.size * now.time_profile
            noise = max(now.overdispersion, 1.0) + information * np.square(LAW_DOUBT * a)
            begun, acting = coming_and_going(a * (score - 0.5 * a * information) / noise)
            if begun[-1] < 0.5:
                return None
            onset = int(np.searchsorted(begun, 0.5))
            (now,) = self.fitted([(step.hypothesis, STEP, onset, step.onset_gains)], known, [acting])
            now.begun, now.active_amplitude = begun, now.size
        if now.gain <= (1.0 + LAW_DOUBT) * (step.gain + explained):
            return None
        share = float(now.time_profile[now.onset :].mean())
        return replace(now, size=now.size * share, time_profile=now.time_profile / share)

    def _gains(self, hypotheses: Sequence[Hypothesis], known: Sequence[Amplitude]) -> Array:
        """Gains (shapes, f, k) of hypotheses with each shape over onsets; -inf for shapes not taken."""
        scale, signed = (np.array([getattr(h, x) for h in hypotheses]) for x in ("scale", "signed"))
        takes = np.array([[shape.kind in h.time_profiles for h in hypotheses] for shape in SHAPES])
        lam = np.tile(1.0 / scale**2, (len(SHAPES), self.onsets.size, 1))
        b = np.zeros_like(lam)
        for name, e in self.balances.items():
            mine = np.flatnonzero([name in h.columns for h in hypotheses])
            if not mine.size:
                continue
            columns = np.array([h.columns[name] for h in hypotheses if name in h.columns])
            contribution = np.moveaxis(e.score_contribution(columns), 0, 1)  # (h, f, n)
            own = SuffixSums(np.einsum("hfn,fn->hf", contribution, columns))
            scores = SuffixSums((e.rest - self._moved(name, known)) @ columns.T)
            for i, shape in enumerate(SHAPES):
                k = takes[i, mine]
                if k.any():
                    lam[i][:, mine[k]] += own.squared(shape, self.onsets)[:, k]
                    # Less what the log's own level and drift absorb.
                    absorbed = columns[k] @ e.suffix_sums.over(shape, self.onsets)
                    lam[i][:, mine[k]] -= np.einsum("kfz,kfz->kf", absorbed, absorbed)
                    b[i][:, mine[k]] += scores.over(shape, self.onsets)[:, k]
        return np.where(takes[..., None], np.moveaxis(_gain(b, lam, signed), 1, 2), -np.inf)

    def _dated_gains(self, h: Hypothesis, known: Sequence[Amplitude]) -> Array:
        """Gains (shapes, k) of a hypothesis with each of the shapes `DATED` over onsets, as `_gains`."""
        profiles = np.array([time_profile_of(shape, self.frames, 0) for shape in DATED])
        lam = np.full((len(DATED), self.onsets.size), 1.0 / h.scale**2)
        b = np.zeros_like(lam)
        for name in filter(self.balances.__contains__, h.columns):
            e, g = self.balances[name], h.columns[name]
            absorbed = np.einsum("hnz,n,z->hz", e.contribution, g, np.sqrt(e.variance))
            scores = np.column_stack([(e.rest - self._moved(name, known)) @ g, absorbed])
            own = correlated(np.square(profiles), e.score_contribution(g) @ g[:, None])
            for i, (sums, squares) in enumerate(zip(correlated(profiles, scores), own, strict=True)):
                b[i] += sums[self.onsets, 0]
                lam[i] += squares[self.onsets, 0] - np.sum(np.square(sums[self.onsets, 1:]), axis=1)
        takes = np.array([[shape.kind in h.time_profiles] for shape in DATED])
        return np.where(takes, _gain(b, lam, np.array(h.signed)), -np.inf)

    def _moved(self, name: str, known: Sequence[Amplitude]) -> Array | float:
        """Score contribution (h, n) of known faults to a balance's frames, less the shift they cause."""
        e = self.balances[name]
        added = sum(
            n.time_profile[:, None] * e.score_contribution(n.hypothesis.columns[name] * n.size)
            for n in known
            if name in n.hypothesis.columns
        )
        if isinstance(added, int):  # no known fault is in this balance
            return added
        return added - e.shifted(e.variance * e.projected(added))

    def unexplained(self, found: Amplitude, known: Sequence[Amplitude]) -> float:
        """Log likelihood ratio of an unmodelled change of a finding's balances from its onset on, against
        what is found already and healthy variation; less its expectation by chance for as many free
        coefficients."""
        total = 0.0
        for name in (n for n in found.hypothesis.columns if n in self.balances):
            e = self.balances[name]
            s = e.schur_complement(found.time_profile)
            left = found.time_profile @ (e.rest - self._moved(name, known))
            (changed,) = by_duty(e, np.einsum("h,hij->ij", found.time_profile, e.information)[None])
            before = there_before(found.shape, found.onset)
            usual = np.diag(e.healthy.covariance) if before else changed
            wide, own = (
                np.linalg.solve(np.eye(left.size) + v[:, None] * s, np.diag(v))
                for v in (np.diag(e.healthy.covariance) * FREE_SPREAD**2 + usual, usual)
            )
            beyond = wide - own
            by_chance = max(found.reduced_chi_square, 1.0) * np.trace(beyond @ s)
            total += 0.5 * float(left @ beyond @ left - by_chance)
        return total

    def refitted(
        self, old: Amplitude, known: Sequence[Amplitude], hypothesis: Hypothesis | None = None
    ) -> Amplitude:
        """The same fault, or another hypothesis in its place, fitted anew jointly with known faults."""
        (found,) = self.fitted([(hypothesis or old.hypothesis, old.shape, old.onset, old.onset_gains)], known)
        return found

    def fitted(
        self, found: Sequence[tuple[Hypothesis, Shape, int, Array]], known: Sequence[Amplitude],
        courses: Sequence[Array] = (),
    ) -> list[Amplitude]:  # fmt: skip
        """Fit hypotheses with given time profiles, jointly with known faults.

        Parameters
        ----------
        found : hypothesis, shape of time profile, onset (0 for all, or for none) and gains over onsets.
        courses : (h,) of each, in place of its shape: of what began within the log.
        """
        if not found:
            return []
        others = [n.hypothesis for n in known]
        first = np.array(courses or [time_profile_of(shape, self.frames, k) for _, shape, k, _ in found])
        time_profiles = np.stack([first, *(np.tile(n.time_profile, (len(found), 1)) for n in known)], axis=1)
        parts = self._parts([[h, *others] for h, *_ in found], time_profiles)
        out = []
        from_start = not courses and there_before(*found[0][1:3])
        fits = fit(self.balances, parts, from_start=from_start, stretches=self.stretches)
        for (h, shape, onset, gain), time_profile, f in zip(found, first, fits, strict=True):
            f.score += float(np.log(h.prior_weight))
            out.append(Amplitude(**vars(f), hypothesis=h, time_profile=time_profile, shape=shape, onset=onset,
                                 onset_gains=gain, onsets=self.onsets))  # fmt: skip
        return out

    def _columns(self, name: str, hypotheses: Sequence[Hypothesis]) -> Array:
        """Hypotheses' columns (f, n) in a balance, zero where they do not change it."""
        none = np.zeros(self.balances[name].healthy.mean.size)
        return np.array([h.columns.get(name, none) for h in hypotheses])

    def _parts(self, faults: Sequence[Sequence[Hypothesis]], time_profiles: Array) -> Parts:
        """Faults, each with those that it is fitted jointly with, in the balances that any changes."""
        columns = {}
        for name in self.balances:
            rows = np.array([self._columns(name, each) for each in faults])
            if rows.any():
                columns[name] = rows
        scales = np.array([[h.scale for h in each] for each in faults])
        return Parts(columns, time_profiles, scales, np.array([each[0].signed for each in faults]))

    def least_visible(self, hypotheses: Sequence[Hypothesis], onset: int, score: float) -> Array:
        """Smallest amplitude (f,) of each hypothesis that would have this score in nine of ten logs, were it
        a step from a frame on; infinite where no balance has its columns."""
        out = np.full(len(hypotheses), np.inf)
        mine = np.array([k for k, h in enumerate(hypotheses) if self.shared(h)], dtype=np.int64)
        if not mine.size or not self.onsets.size:
            return out
        testable = [hypotheses[k] for k in mine.tolist()]
        onset = int(self.onsets[np.argmin(np.abs(self.onsets - onset))])
        time_profiles = np.tile(time_profile_of(STEP, self.frames, onset), (len(testable), 1, 1))
        parts = self._parts([[h] for h in testable], time_profiles)
        scale, prior_weight = parts.scales[:, 0], np.array([h.prior_weight for h in testable])
        parts = replace(parts, scales=np.full_like(parts.scales, VAGUE))
        overdispersion = known_scatter(self.balances, {name: g[:, 0] for name, g in parts.columns.items()})
        overdispersion = np.maximum(overdispersion, self.stretches.least)
        _, found, likely = by_noise_model(self.balances, parts, overdispersion, from_start=onset == 0)
        blocks = np.full(len(testable), (self.frames - onset) / self.stretches.frames)
        wanted = score + 0.5 * np.log1p(scale**2 * found.information) - np.log(prior_weight)
        ratio = as_normal(wanted.clip(0.0), freedom(likely.healthy, blocks))
        least = np.sqrt(2.0 * ratio / likely.information.clip(1e-300))
        out[mine] = least + Z80 / np.sqrt(found.information)
        return out

    def correlations(self, one: Amplitude, others: Sequence[Hypothesis]) -> Array:
        """Absolute correlation (f,) of other hypotheses' columns with a fitted one's over its time profile,
        in the metric of the information."""
        cross, own, theirs = np.zeros(len(others)), 1e-12, np.full(len(others), 1e-12)
        for name, e in self.balances.items():
            (g,), f = self._columns(name, [one.hypothesis]), self._columns(name, others)
            s = e.schur_complement(one.time_profile)
            own += float(g @ s @ g)
            theirs += np.einsum("fi,ij,fj->f", f, s, f)
            cross += f @ s @ g
        return np.asarray(np.abs(cross) / np.sqrt(own * theirs))
