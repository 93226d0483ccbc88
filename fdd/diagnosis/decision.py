"""From evidence to findings: detection, isolation, and the search for further faults.

Detection goes by the score of the best hypothesis. Isolation goes by the posterior among hypotheses whose
columns correlate in this log. A fault's law holds only to `LAW_DOUBT` of its effect, so gains that differ by
no more do not separate faults: they form one ambiguity group, led by the one of largest prior weight at its
amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.evidence import LAW_DOUBT, Amplitude, Evidence
from fdd.diagnosis.hypotheses import RAMP, RECOVERED, Hypothesis, end_of
from fdd.diagnosis.model import root

SAME_EFFECT = 0.5
"""Correlation of columns from which two hypotheses explain the same change."""
GROUP_SHARE = 0.05
"""Share of the posterior from which a fault belongs to the answer's ambiguity group."""
MOST_FAULTS, MOST_FINDINGS = 3, 6
"""Faults of an answer, and findings that they are sought among: a transducer's bias shows in two balances."""
USUAL_SIZE = 0.5
"""Mode of the prior of a severity (Rayleigh's distribution)."""
SECOND_FAULT = 2.0
"""Prior log odds against a second fault; assumed: one faulty unit in eight has two."""
UNKNOWN_BELOW = 0.3
"""Share of a change explained below which its cause is called unknown. On simulated kinds of machine and laws
(seeds 6002, 5511) 2 of 196 right leading findings explained less, and 16 of 180 whose fault was taken out of
the catalogue: as many, were one fault in ten outside it. From there to a half it was 5 and 7."""
LAWS_REST = 0.5
"""Share explained below which a finding beside a larger one of its balances is what that one's law leaves."""
TOGETHER_FRAMES = 4
"""Frames within which two onsets count as the same."""


@dataclass
class Found:
    """One finding: its leading hypothesis, and the share of each fault that would explain it as well.

    Attributes
    ----------
    explained : share of the change of its balances that it explains, given the other findings.
    gain_ratio : its gain over that of the leading finding, which it is beside; None of the leading one.
    """

    lead: Amplitude
    score: float
    shares: dict[str, float]
    explained: float = 1.0
    gain_ratio: float | None = None

    @property
    def known(self) -> bool:
        """Whether the catalogue has its cause, which explains enough of the change."""
        return self.explained >= UNKNOWN_BELOW

    @property
    def second_evidence(self) -> tuple[float, float] | None:
        """What tells a fault beside the leading one from what that one's law leaves, which no fault explains
        well, and which is small: the score's root times the share explained, and the logarithm of the gains'
        ratio; None of the leading one."""
        if self.gain_ratio is None:
            return None
        explained = self.explained if self.known else 1.0  # an unknown fault does not claim to explain it
        return root(self.score) * explained, math.log(min(max(self.gain_ratio, 1e-5), 1e3))

    @property
    def group(self) -> list[str]:
        """Faults of the ambiguity group, the leading one first."""
        if not self.known:
            return ["unknown"]
        lead, by_share = self.lead.hypothesis.fault, sorted(self.shares.items(), key=lambda x: -x[1])
        return [lead, *(f for f, s in by_share if s >= GROUP_SHARE and f not in (lead, RECOVERED))]


def decide(
    evidence: Evidence, hypotheses: Sequence[Hypothesis], threshold: float, standing: Collection[str] = ()
) -> tuple[list[Found], float]:
    """Findings above a threshold, the surest first, and the largest score that is left.

    Faults are added one by one, the others refitted (orthogonal matching pursuit: Pati, Rezaiifar and
    Krishnaprasad 1993, doi 10.1109/ACSSC.1993.342465), and dropped where later ones leave them less than half
    of the score asked for, so that it ends (Zhang 2011, doi 10.1109/TIT.2011.2146690). The end of a fault
    that was found is a finding too: `Hypothesis.ends` names it.

    Parameters
    ----------
    standing : labels of hypotheses active before. They are taken first: after a recovery the original fault
        explains less than a fault of opposite sign would.
    """
    found: list[Found] = []
    added = 0
    while True:
        known = [f.lead for f in found]
        ends = [end_of(k.hypothesis, k.size) for k in known if k.hypothesis.ends is None]
        fits = evidence.fits([*hypotheses, *ends], known)
        fits = [f for f in fits if f.gain > 0.0 and not _comes_along(f, known)]
        against = SECOND_FAULT if found else 0.0
        score = max((f.score for f in fits), default=against)
        faults = [f for f in _each_once(found) if f.lead.hypothesis.ends is None]
        enough = len(faults) == MOST_FAULTS or added == MOST_FINDINGS
        if not fits or score - against < threshold or enough:
            for f in found:
                left = max(evidence.unexplained(f.lead, known), 0.0)
                f.explained = f.lead.gain / (f.lead.gain + left) if left > 0.0 else 1.0
            once = [f for f in _each_once(found) if f.explained >= LAWS_REST or not _of_a_larger(f, found)]
            for f in once:
                others = [g.lead for g in found if g is not f]
                f.lead = evidence.dated(f.lead, others, steady=not f.known)
            # What the breaks in a fault's course explain is no other fault.
            breaks = any(f.lead.begun is not None for f in once)
            once = [f for f in once if not breaks or _needed(f.lead, threshold)]
            # A fault is not in doubt for its own end, which may be the surer finding.
            begun = [f for f in once if f.lead.hypothesis.ends is None]
            first = leading([f.lead for f in begun], [f.score for f in begun]) if begun else None
            for f in once:
                beside = None if f.lead is first else first
                f.gain_ratio = None if beside is None else f.lead.gain / max(beside.gain, 1e-9)
            told = [f for f in once if f.gain_ratio is None or not _alike_a_larger(evidence, f, begun)]
            return told, score - against
        sure = [f for f in fits if f.score - against >= threshold]
        stand = [f for f in sure if f.hypothesis.label in standing and f.hypothesis.ends is None]
        seed = leading(stand or sure, [f.score for f in stand or sure])
        if stand:
            fits = [f for f in fits if abs(f.onset - seed.onset) <= TOGETHER_FRAMES]
        found.append(_isolated(evidence, seed, fits, score))
        added += 1
        if found[-1].lead.hypothesis.ends is not None:
            _take_its_end(evidence, found)
        elif all(f.lead.hypothesis.ends is None for f in found):
            found = beside_the_newest(evidence, found, hypotheses, threshold)


def leading(fits: Sequence[Amplitude], scores: Sequence[float]) -> Amplitude:
    """Of those in the balances of the surest, by its score, the largest gain over its misfit: a part of a
    large deviation, or what its law leaves, may have the larger score."""
    best = fits[int(np.argmax(scores))].hypothesis.columns.keys()
    rivals = (f for f in fits if best & f.hypothesis.columns.keys())
    return max(rivals, key=lambda f: f.gain / np.sqrt(f.reduced_chi_square))


def beside_the_newest(
    evidence: Evidence, found: list[Found], hypotheses: Sequence[Hypothesis], threshold: float
) -> list[Found]:
    """Earlier findings isolated anew, each beside all the others; without those that these make needless."""
    kept = list(found)
    for f in found[:-1]:
        others = [g.lead for g in kept if g is not f]
        lead = evidence.refitted(f.lead, others)
        if not _needed(lead, threshold) or lead.gain <= 0.0 or _comes_along(lead, others):
            kept = [g for g in kept if g is not f]
            continue
        alike = zip(hypotheses, evidence.correlations(lead, hypotheses) > SAME_EFFECT, strict=True)
        rivals = evidence.fits([h for h, c in alike if c and h is not lead.hypothesis], others)
        fits = [lead, *(r for r in rivals if not _comes_along(r, others))]
        anew = _isolated(evidence, lead, fits, f.score)
        f.lead, f.shares = anew.lead, anew.shares
    return kept


def _needed(lead: Amplitude, threshold: float) -> bool:
    """Whether half of the score asked for is left beside the others, or it is an end, or comes and goes."""
    kept = lead.begun is not None or lead.hypothesis.ends is not None
    return kept or lead.score - SECOND_FAULT >= 0.5 * threshold


def _each_once(found: list[Found]) -> list[Found]:
    """The surest finding of each fault of one part: another of the same explains what its law leaves."""
    once: dict[tuple[object, ...], Found] = {}
    for f in found:
        h = f.lead.hypothesis
        once.setdefault((h.fault, h.ends, h.side, h.channel) if f.known else ("unknown",), f)
    return list(once.values())


def _of_a_larger(one: Found, found: list[Found]) -> bool:
    """Whether a known fault changes a balance of a finding more."""
    own = one.lead.hypothesis.columns.keys()
    larger = [f for f in found if f.known and f.lead.gain > one.lead.gain]
    return any(f.lead.hypothesis.columns.keys() & own for f in larger)


def _alike_a_larger(evidence: Evidence, one: Found, begun: list[Found]) -> bool:
    """Whether a larger fault has the same effect: what its law leaves looks like that, at any time. Of 16
    such findings in logs of one fault none was another, of 22 in logs of two 11 (seeds 6001, 6002, 5511)."""
    larger = [f.lead.hypothesis for f in begun if f.lead.gain > one.lead.gain]
    same = evidence.correlations(one.lead, larger) > SAME_EFFECT if larger else ()
    return one.lead.hypothesis.ends is None and any(same)


def _take_its_end(evidence: Evidence, found: list[Found]) -> None:
    """Refit a fault jointly with its end, found last: without it the size is the mean since its onset."""
    end = found[-1].lead
    whole = next(f for f in found if f.lead.hypothesis.fault == end.hypothesis.ends)
    others = [f.lead for f in found[:-1] if f is not whole]
    whole.lead = evidence.refitted(whole.lead, [*others, end])
    its_end = end_of(whole.lead.hypothesis, whole.lead.size)
    found[-1].lead = evidence.refitted(end, [*others, whole.lead], its_end)


def _comes_along(fit: Amplitude, known: list[Amplitude]) -> bool:
    """True if a simultaneous change is a side effect of a known fault.

    It comes from the model error of that fault's law. A ramp in whose growth the other begins counts as
    simultaneous. A fault does not end where it begins.
    """
    for n in known:
        first, later = sorted((fit, n), key=lambda f: f.onset)
        grown = first.onset + (RAMP.frames if first.shape == RAMP else 0)
        if later.onset > grown + TOGETHER_FRAMES:
            continue
        shared = n.hypothesis.columns.keys() & fit.hypothesis.columns.keys()
        of_its_law = bool(shared) and fit.gain <= LAW_DOUBT**2 * n.gain
        if of_its_law or fit.hypothesis.ends == n.hypothesis.fault:
            return True
    return False


def _usual(fit: Amplitude) -> float:
    """Prior density of a fault at its amplitude: prior weight times Rayleigh's distribution."""
    if fit.hypothesis.ends is not None:
        return 1.0
    if not fit.hypothesis.signed:
        return fit.hypothesis.prior_weight
    size = fit.active_amplitude
    return fit.hypothesis.prior_weight * size * float(np.exp(-0.5 * np.square(size / USUAL_SIZE)))


def _isolated(evidence: Evidence, seed: Amplitude, fits: list[Amplitude], score: float) -> Found:
    """Isolation: posterior of the faults whose columns correlate with the best hypothesis's."""
    alike = evidence.correlations(seed, [f.hypothesis for f in fits])
    candidates = [f for f, c in zip(fits, alike.tolist(), strict=True) if c > SAME_EFFECT and f.gain > 0.0]
    # Tempered by misfit and model error, by balance: what laws leave unexplained in one does not separate
    # faults, but neither does a large effect in one hide what another says.
    parts = np.array([f.by_balance for f in candidates])
    best = parts[np.argmax([f.gain for f in candidates])]
    largest = np.maximum(parts.max(axis=1), best.max(axis=0))
    tempered = (parts[:, 0] - best[0]) / (seed.reduced_chi_square + LAW_DOUBT**2 * largest)
    ratio = tempered.sum(axis=1)
    weight = np.exp(ratio - ratio.max())
    weight *= np.array([_usual(f) for f in candidates])
    weight /= weight.sum()
    shares: dict[str, float] = {}
    for f, w in zip(candidates, weight, strict=True):
        shares[f.hypothesis.fault] = shares.get(f.hypothesis.fault, 0.0) + float(w)
    fault = max(shares, key=lambda k: shares[k])
    own = [k for k, f in enumerate(candidates) if f.hypothesis.fault == fault]
    return Found(candidates[max(own, key=lambda k: weight[k])], score, shares)
