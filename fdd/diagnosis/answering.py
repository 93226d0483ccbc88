"""From what was found to the words, figures and probabilities of the answer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import fdd
from fdd.diagnosis.decision import USUAL_SIZE, Found
from fdd.diagnosis.evidence import Z80, Evidence, there_before
from fdd.diagnosis.findings import Diagnosis, FaultFinding, Invisible, present
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.model import Model
from fdd.faults import ADDED_BY, CATALOGUE, FAMILIES, fault
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import BLOCK_FRAMES, FRAME_S
from fdd.residuals.compiled import Array
from fdd.sensors.finding import SensorFinding

LEAST_SHOWN = 2.0
"""Severity beyond which a fault counts as invisible: twice the gross one."""
MOST_SPREAD = 3.0
"""Upper bound of a severity's std of the logarithm, beyond which nothing is known of it."""
COMES_AND_GOES = 0.7
"""Ratio of mean to active amplitude below which a fault is reported as intermittent."""


@dataclass(frozen=True)
class Span:
    """The frames of evidence in time.

    Attributes
    ----------
    starts : s, when each began. end : s, of the last. stretch : words for the stretches that the
        overdispersion is estimated on. whole : s, length of a frame; None where they differ, and none is
        ever left out.
    """

    starts: Sequence[float]
    end: float
    stretch: str = f"stretches of {BLOCK_FRAMES * FRAME_S:.0f} s"
    whole: float | None = FRAME_S

    def until(self, k: int) -> float:
        """s, end of a frame."""
        return self.starts[k] + self.whole if self.whole else [*self.starts, self.end][k + 1]

    def lost(self, k: int) -> bool:
        """Whether the frame before was dropped."""
        return k == 0 or (self.whole is not None and self.starts[k] - self.until(k - 1) > 0.5 * self.whole)


def fault_finding(found: Found, model: Model, *, onset: float, span: Span) -> FaultFinding:
    """One finding as the answer carries it, with its onset (s), detected at the end of its evidence."""
    lead, h = found.lead, found.lead.hypothesis
    earliest, latest = lead.onset_quantiles(0.1, 0.9)
    began = (round(min(onset, span.starts[earliest]), 2), round(max(onset, span.until(latest)), 2))
    # Nobody knows for how long it was there before the log.
    interval = None if there_before(lead.shape, lead.onset) else began
    times: dict[str, Any] = {
        "onset_s": round(onset, 2), "detected_s": round(span.end, 2), "onset_interval": interval,
    }  # fmt: skip
    titles = " and ".join(BALANCES[name].title for name in h.columns)
    beside, curve = found.second_evidence, model.calibration
    sure = curve.probability(found.score) if beside is None else curve.second(*beside)
    if not found.known:
        return FaultFinding(
            fault="unknown", family="unknown", ambiguity=["unknown"], confidence=round(min(sure, 0.9999), 4),
            score=round(found.score, 2), **times, evidence=[
                f"The balance of {titles} does not close from {onset:.1f} s on, and no fault of the "
                f"catalogue explains it: the nearest, {fault(h.fault).title}, no more than "
                f"{100 * found.explained:.0f} % of what changed."
            ],
            next_check=fault("unknown").next_check,
        )  # fmt: skip
    size = abs(lead.active_amplitude)
    # A size of which a law, or its scale, is wrong is so many times too large: log-normal.
    own = math.log1p(lead.variance / max(size, 1e-9) ** 2)
    spread = math.sqrt(own + model.calibration.severity_doubt**2)
    low, high = (round(size * math.exp(sign * Z80 * min(spread, MOST_SPREAD)), 3) for sign in (-1.0, 1.0))
    group = found.group
    share = sum(found.shares.get(f, 0.0) for f in group)
    grows = f"growing over {lead.shape.frames * span.whole:.0f} s from" if span.whole else "growing from"
    words = {"step": "from", "ramp": grows, "drift": "drifting from"}[lead.shape.kind]
    stretch = span.stretch.replace("stretches", "stretch") if round(lead.blocks) == 1 else span.stretch
    sentences = [
        f"The balance of {titles} does not close {words} {onset:.1f} s on; "
        f"{fault(h.fault).title} of severity {size:.2f} ({low:.2f} to {high:.2f}) explains it "
        f"(log likelihood ratio {found.score:.1f}, from {lead.blocks:.0f} {stretch})."
    ]
    if abs(lead.size) < COMES_AND_GOES * size:
        sentences.append(f"It comes and goes: on average {100 * abs(lead.size) / size:.0f} % of that.")
    sentences += [
        f"The model has not learnt from logs with {fault(f).title} (package {ADDED_BY[f]}): "
        "how sure this is, it takes from other faults of the same score."
        for f in group
        if f in ADDED_BY and not model.knows(f)
    ]
    alike = {f: round(found.shares[f] / share, 4) for f in group} if len(group) > 1 else {}
    if alike:
        names = ", ".join(fault(f).title for f in group)
        parts = ", ".join(f"{fault(f).title} {100 * part:.0f} %" for f, part in alike.items())
        sentences.append(f"In this log {names} would look alike: {parts}.")
    return FaultFinding(
        fault=h.fault, family=fault(h.fault).family, ambiguity=group, shares=alike,
        confidence=round(min(sure * share, 0.9999), 4), score=round(found.score, 2), **times,
        severity=round(size, 3), severity_interval=(low, high), evidence=sentences,
        side=h.side, variant=h.variant, channel=h.channel, next_check=fault(h.fault).next_check,
    )  # fmt: skip


def sensor_fault(found: SensorFinding) -> FaultFinding:
    """A sensor's failure as a finding."""
    return FaultFinding(
        fault=found.fault, family=fault(found.fault).family, ambiguity=[found.fault],
        confidence=found.confidence, onset_s=round(found.onset_s, 3), detected_s=round(found.detected_s, 3),
        evidence=[found.evidence], channel=found.channel, next_check=fault(found.fault).next_check,
    )  # fmt: skip


def probabilities_of(
    faults: Sequence[FaultFinding], model: Model, score: float, hidden: float
) -> dict[str, float]:
    """Probability of each fault family and of none; they add up to one.

    `faults` are the findings, the surest first; `score` is the largest that made none; see `hidden_share`.
    """
    out = dict.fromkeys(FAMILIES, 0.0)
    free = 1.0
    for finding in faults:
        for family, probability in finding.by_family.items():
            out[family] += free * probability
        free *= 1.0 - finding.confidence
    if not faults:
        doubt = model.calibration.probability(score, hidden)
        out["unknown"], free = doubt, 1.0 - doubt
    out["healthy"] = free
    total = sum(out.values())
    return {k: round(v / total, 4) for k, v in out.items()}


def probabilities_over(
    time: Array, statistic: Array, answer: Diagnosis, model: Model, hidden: float
) -> dict[str, Array]:
    """Probability over time (m,) that a fault of each family is there, or none.

    From its detection on a fault counts as the answer says; before, what the statistic (m,) says is shared as
    the answer shares it. What may be there and leave no trace is unknown.
    """
    said = {k: p for k, p in answer.probabilities.items() if k != "healthy"}
    sure = np.array([model.calibration.probability(float(s), hidden) for s in statistic])
    quiet = model.calibration.probability(0.0, hidden)
    shown = np.maximum(sure - quiet, 0.0) / (1.0 - quiet)
    out = {k: shown * (p / max(sum(said.values()), 1e-9)) for k, p in said.items()}
    out["unknown"] = out["unknown"] + sure - shown
    out["healthy"] = 1.0 - sure
    found = sorted(answer.faults, key=lambda f: f.detected_s)
    detected = np.searchsorted([f.detected_s for f in found], time, side="right")
    detected[-1:] = len(found)  # what the log as a whole shows is known at its end
    for k in range(1, len(found) + 1):
        by_then = sorted(found[:k], key=lambda f: -f.confidence)
        for family, p in present(probabilities_of(by_then, model, 0.0, hidden), by_then).items():
            out[family][detected == k] = p
    return {k: out[k] for k in FAMILIES}


def invisible(evidence: Evidence, hypotheses: Sequence[Hypothesis], threshold: float) -> list[Invisible]:
    """Faults with the smallest severity that this log would have shown, had they begun a third into it.

    It shows where its score (`fdd.diagnosis.departures`) passes the threshold in nine of ten logs. A fault
    acts in one of several ways, as on one side: the severity is that of the way that is hardest to see.
    """
    ways: dict[str, list[tuple[float, Hypothesis]]] = {}
    found = evidence.least_visible(hypotheses, evidence.frames // 3, threshold)
    for h, least in zip(hypotheses, np.where(found < LEAST_SHOWN, found, np.inf).tolist(), strict=True):
        ways.setdefault(h.fault, []).append((least, h))
    out = []
    for name in (n for n in CATALOGUE if n in ways):
        least, h = max(ways[name], key=lambda way: way[0])
        parts = [(_smaller(x), way.prior_weight) for x, way in ways[name]]
        way = {"side": h.side, "channel": h.channel, "variant": h.variant} if len(parts) > 1 else {}
        out.append(Invisible(
            fault=name, severity=math.ceil(100.0 * least) / 100.0 if math.isfinite(least) else None,
            hidden=round(sum(p * c for p, c in parts) / sum(c for _, c in parts), 3), **way,
        ))  # fmt: skip
    return out


def hidden_share(unseen: Sequence[Invisible]) -> float:
    """Share of faults that a log could not have shown, were all kinds as likely and severities as usual.

    Examples
    --------
    >>> round(hidden_share([Invisible(fault="aeration", severity=0.25)]), 2)
    0.12
    >>> hidden_share([])
    1.0
    """
    shares = [x.hidden if x.hidden is not None else _smaller(x.severity) for x in unseen]
    return float(np.mean(shares)) if shares else 1.0


def _smaller(severity: float | None) -> float:
    """Share of usual severities (Rayleigh's) that are smaller; all than None."""
    return 1.0 if severity is None else -math.expm1(-0.5 * (severity / USUAL_SIZE) ** 2)


def versions_of(trackers: Mapping[str, str]) -> dict[str, str]:
    """What an answer depends on besides its files: fdd, and packages of further faults and of `trackers` (by
    name).

    Examples
    --------
    >>> "fdd" in versions_of({}), versions_of({"ukf": "fdd-example 0.1.0"})["tracker ukf"]
    (True, 'fdd-example 0.1.0')
    """
    faults = ", ".join(sorted(set(ADDED_BY.values())))
    added = {f"tracker {name}": package for name, package in trackers.items()}
    return {"fdd": fdd.__version__, **({"faults": faults} if faults else {}), **added}
