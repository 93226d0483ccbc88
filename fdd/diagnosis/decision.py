"""From evidence to findings: is something wrong, which of the faults that would explain it, and is there a
second one.

Detection goes by the robust score of the best hypothesis. Which fault it is goes by likelihood among those
whose columns are alike
in this log, over the scatter that the best one leaves. Where two faults' columns agree to `SAME`, no
likelihood tells them apart, as
what is left between them is model error: they are one ambiguity group, and what parts are commonest leads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdd.diagnosis.evidence import Amplitude, Evidence
from fdd.diagnosis.hypotheses import Hypothesis

ALIKE = 0.5
"""Correlation of columns from which two hypotheses explain the same thing."""
SAME = 0.97
"""Correlation from which nothing in this log tells them apart."""
GROUP_SHARE = 0.05
"""Share of the posterior from which a fault belongs to the answer's ambiguity group."""
MOST_FAULTS = 3


@dataclass
class Found:
    """One finding: its leading hypothesis, and the share of each fault that would explain it as well."""

    lead: Amplitude
    score: float
    shares: dict[str, float]

    @property
    def group(self) -> list[str]:
        """Faults of the ambiguity group, the leading one first."""
        lead = self.lead.hypothesis.fault
        others = [
            f for f, s in sorted(self.shares.items(), key=lambda x: -x[1]) if s >= GROUP_SHARE and f != lead
        ]
        return [lead, *others]


def decide(
    evidence: Evidence, hypotheses: Sequence[Hypothesis], threshold: float
) -> tuple[list[Found], float]:
    """Findings above a threshold, the surest first, and the largest score that is left."""
    found: list[Found] = []
    known: list[Amplitude] = []
    while True:
        fits = [f for f in (_fit(evidence, h, known) for h in hypotheses) if f is not None]
        if not fits:
            return found, 0.0
        seed = max(fits, key=lambda f: f.score)
        if seed.score < threshold or len(found) == MOST_FAULTS:
            return found, seed.score
        found.append(_isolated(evidence, seed, fits))
        known.append(found[-1].lead)


def _fit(evidence: Evidence, h: Hypothesis, known: list[Amplitude]) -> Amplitude | None:
    fit = evidence.best(h, known)
    if fit is None or fit.gain < 3.0 * fit.kappa or fit.kappa < 2.0 or "step" not in h.courses:
        return fit
    on_off = evidence.intermittent(fit, known)
    return on_off if on_off.score > fit.score + 3.0 else fit


def _isolated(evidence: Evidence, seed: Amplitude, fits: list[Amplitude]) -> Found:
    """Which faults explain what the best hypothesis saw."""
    alike = [(f, evidence.correlation(seed, f.hypothesis)) for f in fits]
    candidates = [(f, c) for f, c in alike if c > ALIKE and f.gain > 0.0]
    gains = np.array([f.gain / seed.kappa for f, _ in candidates])
    top = candidates[int(np.argmax(gains))][0]
    same = np.array([evidence.correlation(top, f.hypothesis) for f, _ in candidates]) > SAME
    gains = np.where(same & (gains > 0.5 * gains.max()), gains.max(), gains)
    weight = np.exp(gains - gains.max()) * np.array([f.hypothesis.commonness for f, _ in candidates])
    weight /= weight.sum()
    shares: dict[str, float] = {}
    for (f, _), w in zip(candidates, weight, strict=True):
        shares[f.hypothesis.fault] = shares.get(f.hypothesis.fault, 0.0) + float(w)
    fault = max(shares, key=lambda k: shares[k])
    lead = max(
        ((f, w) for (f, _), w in zip(candidates, weight, strict=True) if f.hypothesis.fault == fault),
        key=lambda x: x[1],
    )[0]
    return Found(lead, seed.score, shares)
