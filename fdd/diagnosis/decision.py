"""From evidence to findings: is something wrong, which of the faults that would explain it, and is there a
second one.

Detection goes by the robust score of the best hypothesis. Which fault it is goes by likelihood among those
whose columns are alike in this log. No law of a fault holds better than `LAW_DOUBT`, so a gain that falls
short by as little says nothing: such faults are one ambiguity group, and what is commonest, at the size that
it would have, leads.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.evidence import Amplitude, Evidence
from fdd.diagnosis.hypotheses import RECOVERED, Hypothesis, end_of

SAME_EFFECT = 0.5
"""Correlation of columns from which two hypotheses explain the same thing."""
GROUP_SHARE = 0.05
"""Share of the posterior from which a fault belongs to the answer's ambiguity group."""
MOST_FAULTS = 3
USUAL_SIZE = 0.5
"""Severity that is the likeliest before a log is seen (Rayleigh's distribution)."""
SECOND_FAULT = 2.0
"""Log odds against a further fault beside one that was found; assumed: one faulty unit in eight has two."""
TOGETHER_FRAMES = 4
"""Frames within which two onsets are one."""
LAW_DOUBT = 0.25
"""Of a fault's effect: how far its law may be from the machine's. Flow by the root of pressure and flow by
pressure part by that much over a range from none to full (4 to 6 % of the energy)."""


@dataclass
class Found:
    """One finding: its leading hypothesis, and the share of each fault that would explain it as well.

    Attributes
    ----------
    explained : share of what changed in its balances that it explains, beside the other findings.
    """

    lead: Amplitude
    score: float
    shares: dict[str, float]
    explained: float = 1.0

    @property
    def known(self) -> bool:
        """Whether it is one of the catalogue's: what explains less than half of a change is not its cause."""
        return self.explained >= 0.5

    @property
    def group(self) -> list[str]:
        """Faults of the ambiguity group, the leading one first."""
        if not self.known:
            return ["unknown"]
        lead = self.lead.hypothesis.fault
        others = [
            f
            for f, s in sorted(self.shares.items(), key=lambda x: -x[1])
            if s >= GROUP_SHARE and f not in (lead, RECOVERED)
        ]
        return [lead, *others]


def decide(
    evidence: Evidence, hypotheses: Sequence[Hypothesis], threshold: float, standing: Collection[str] = ()
) -> tuple[list[Found], float]:
    """Findings above a threshold, the surest first, and the largest score that is left.

    That a fault which was found is over is one of them too: `Hypothesis.ends` names it.

    Parameters
    ----------
    standing : labels of hypotheses that stood before. They are taken first: what has healed since explains
        less than its opposite would.
    """
    found: list[Found] = []
    known: list[Amplitude] = []
    while True:
        ends = [end_of(k.hypothesis, k.size) for k in known if k.hypothesis.ends is None]
        fits = [
            f
            for f in evidence.fits([*hypotheses, *ends], known)
            if f.gain > 0.0 and not _comes_along(f, known)
        ]
        against = SECOND_FAULT if found else 0.0
        score = max((f.score for f in fits), default=against) - against
        if score < threshold or len(found) == MOST_FAULTS:
            for f in found:
                left = max(evidence.unexplained(f.lead, known), 0.0)
                f.explained = f.lead.gain / (f.lead.gain + left)
            return found, score
        # What leads is what explains most, and well: a part of a large deviation may look surer than all.
        sure = [f for f in fits if f.score - against >= threshold]
        stand = [f for f in sure if f.hypothesis.label in standing and f.hypothesis.ends is None]
        seed = max(stand or sure, key=lambda f: f.gain / np.sqrt(f.reduced_chi_square))
        if stand:
            fits = [f for f in fits if abs(f.onset - seed.onset) <= TOGETHER_FRAMES]
        found.append(_isolated(evidence, seed, fits, score))
        if found[-1].lead.hypothesis.ends is not None:
            _take_its_end(evidence, found)
        known = [f.lead for f in found]


def _take_its_end(evidence: Evidence, found: list[Found]) -> None:
    """Fit a fault again beside its end, found last, and the end beside it: alone, a fault seems as small as
    it is on average over what came after its onset."""
    end = found[-1].lead
    whole = next(f for f in found if f.lead.hypothesis.fault == end.hypothesis.ends)
    others = [f.lead for f in found[:-1] if f is not whole]
    old = whole.lead
    as_it_was = [(old.hypothesis, old.kind, old.onset, old.onset_gains)]
    (whole.lead,) = evidence.fitted(as_it_was, [*others, end])
    its_end = [(end_of(old.hypothesis, whole.lead.size), end.kind, end.onset, end.onset_gains)]
    (found[-1].lead,) = evidence.fitted(its_end, [*others, whole.lead])


def _comes_along(fit: Amplitude, known: list[Amplitude]) -> bool:
    """Whether what begins with a fault that was found before is no more than a part of it.

    It may be owed to that fault's law, which holds only so well, or be a small effect that no signature
    tells of: a loose seal leaks, a stuck valve shifts the pressure in a sensor's line. Where a fault begins
    it is not over.
    """
    for n in known:
        if abs(n.onset - fit.onset) > TOGETHER_FRAMES:
            continue
        if fit.hypothesis.ends == n.hypothesis.fault:
            return True
        shared = set(n.hypothesis.columns) & set(fit.hypothesis.columns)
        if shared and fit.gain <= LAW_DOUBT**2 * n.gain:
            return True
        if abs(fit.active_amplitude) < LAW_DOUBT * abs(n.active_amplitude):
            return True
    return False


def _usual(fit: Amplitude) -> float:
    """How usual a fault of that size is, before a log is seen: neither next to nothing, nor beyond gross."""
    if fit.hypothesis.ends is not None:
        return 1.0
    if not fit.hypothesis.signed:
        return fit.hypothesis.prior_weight
    size = fit.active_amplitude
    return fit.hypothesis.prior_weight * size * float(np.exp(-0.5 * np.square(size / USUAL_SIZE)))


def _isolated(evidence: Evidence, seed: Amplitude, fits: list[Amplitude], score: float) -> Found:
    """Which faults explain what the best hypothesis saw."""
    alike = evidence.correlations(seed, [f.hypothesis for f in fits])
    candidates = [f for f, c in zip(fits, alike.tolist(), strict=True) if c > SAME_EFFECT and f.gain > 0.0]
    gains = np.array([f.gain for f in candidates])
    # What laws leave unexplained is no evidence for one fault against another.
    weight = np.exp((gains - gains.max()) / (seed.reduced_chi_square + LAW_DOUBT**2 * gains.max()))
    weight *= np.array([_usual(f) for f in candidates])
    weight /= weight.sum()
    shares: dict[str, float] = {}
    for f, w in zip(candidates, weight, strict=True):
        shares[f.hypothesis.fault] = shares.get(f.hypothesis.fault, 0.0) + float(w)
    fault = max(shares, key=lambda k: shares[k])
    lead = max(
        ((f, w) for f, w in zip(candidates, weight, strict=True) if f.hypothesis.fault == fault),
        key=lambda x: x[1],
    )[0]
    return Found(lead, score, shares)
