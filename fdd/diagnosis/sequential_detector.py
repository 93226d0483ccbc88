"""Sequential detection: the evidence is evaluated again and again on one time scale. Alarms have an on-delay;
faults are raised, confirmed or missed at each evaluation, and over in the end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from fdd.diagnosis.answering import Span, fault_finding
from fdd.diagnosis.decision import Found, decide
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.model import Model
from fdd.faults import fault
from fdd.restorable import Restorable

EVALUATIONS = 3
"""Consecutive evaluations above the threshold that raise a fault: an on-delay of ten seconds (ISA-18.2)
against transients. As many below it clear the fault."""
RECOVERED_S = 60.0
"""s for which a fault has to be gone before it is over: one that returns within a minute stays active."""
SINGLE_MARGIN = 1.5
"""Extra score for an alarm on a single evaluation."""
RECOVERED_SHARE = 0.5
"""Share of a fault's amplitude that has to be gone before it is over."""


@dataclass(frozen=True)
class Evaluation:
    """Result of one evaluation of the evidence.

    Attributes
    ----------
    now : s, its time. found, findings : active ones. scores : largest of each of the last evaluations, this
        one last. stands : the score that counts, see `SequentialDetector.evaluate`. labels : family to the
        leading hypothesis. over : family whose fault seems to have ended, to when (s).
    """

    now: float
    evidence: Evidence
    found: list[Found]
    findings: list[FaultFinding]
    scores: list[float]
    stands: float
    labels: dict[str, str]
    over: dict[str, float]


@dataclass
class ActiveFaults:
    """Active fault families of one axis, from evaluation to evaluation.

    Attributes
    ----------
    alarms : first finding of each family that was ever active. now : active families with their finding, and
        the number of evaluations in a row that have missed it. labels : of their leading hypotheses.
    fault_intervals : s, onset and end of faults that were active before. recovered : families of which a
        fault ended by the evidence, not by missing it.
    """

    alarms: dict[str, FaultFinding] = field(default_factory=dict)
    now: dict[str, tuple[FaultFinding, int]] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    fault_intervals: list[tuple[float, float]] = field(default_factory=list)
    recovered: set[str] = field(default_factory=set)

    def findings(self) -> list[FaultFinding]:
        """Of the active faults."""
        return [finding for finding, _ in self.now.values()]

    def intervals(self) -> list[tuple[float, float]]:
        """Onset and end (s) of each fault, active ones included; their end is inf."""
        return [*self.fault_intervals, *((finding.onset_s, math.inf) for finding in self.findings())]

    def take(
        self, evaluation: Evaluation, oldest: float
    ) -> tuple[list[FaultFinding], list[tuple[float, float]]]:
        """Update by an evaluation; `oldest` (s) of the evidence that is kept.

        Returns new findings, and intervals (s) of faults that have ended, whose frames must be dropped: to
        the reference they would look like another fault.
        """
        seen = {f.family: f for f in reversed(evaluation.findings)}
        over = []
        for family, since in evaluation.over.items():
            again = family in seen and seen[family].onset_s > since  # else it would be raised anew each look
            if evaluation.now - since >= RECOVERED_S and family in self.now and not again:
                finding, _ = self.now.pop(family)
                over.append((finding.onset_s, since))
                self.recovered.add(family)
                seen.pop(family, None)
        fresh = [f for family, f in seen.items() if family not in self.now]
        missed = {k: (f, n + 1) for k, (f, n) in self.now.items() if k not in seen}
        gone = [(f.onset_s, evaluation.now) for f, n in missed.values() if n >= EVALUATIONS]
        self.fault_intervals = [*(s for s in self.fault_intervals if s[1] > oldest), *over, *gone]
        self.now = {k: (f, 0) for k, f in seen.items()}
        self.now |= {k: v for k, v in missed.items() if v[1] < EVALUATIONS}
        self.labels = {k: v for k, v in (self.labels | evaluation.labels).items() if k in self.now}
        self.alarms = {f.family: f for f in fresh} | self.alarms
        return fresh, over

    def past(self, seen: set[str], start: float) -> list[FaultFinding]:
        """Alarms of families not seen now that nothing has refuted: ended, or begun before `start` (s)."""
        alarms = ((k, f) for k, f in self.alarms.items() if k not in seen)
        return [f for k, f in alarms if f.onset_s < start or k in self.recovered]


class SequentialDetector(Restorable):
    """Detects faults on one time scale (the window of frames, or the epochs of an axis's life).

    Parameters
    ----------
    hypotheses : faults considered. threshold : score of an alarm. model : learnt layer.
    unknown : a change that the catalogue hardly explains is reported as an unknown fault. Over
        weeks too much else changes for that.

    Attributes
    ----------
    active : faults. at : s, end of the data at the last evaluation that was taken; 0 before it.
    """

    STATE = ("active", "at", "_scores")
    STATE_CLASSES = (ActiveFaults, FaultFinding)

    def __init__(
        self, hypotheses: Sequence[Hypothesis], threshold: float, model: Model, *, unknown: bool = True
    ) -> None:
        self.unknown = unknown
        self.hypotheses, self.threshold, self.model = hypotheses, threshold, model
        self.active = ActiveFaults()
        self.at = 0.0
        self._scores: list[float] = []

    def evaluate(
        self, evidence: Evidence, span: Span, first: float, *, even: float | None = None
    ) -> Evaluation:
        """Evaluate the evidence; the result counts once `take` has it.

        A score counts as far as the last `EVALUATIONS` all reached it, or the last one beat it by
        `SINGLE_MARGIN`.

        Parameters
        ----------
        span : its frames in time. first : s, of the first sample. even : score for a verdict on
            the whole log, without on-delay; None asks for alarms, with it.
        """
        labels = self.active.labels.values()
        least = self.threshold if even is None else even
        found, rest = decide(evidence, self.hypotheses, least, labels)
        before = self._scores[:-1] if self.at == span.end else self._scores
        scores = [*before[1 - EVALUATIONS :], max([rest, *(f.score for f in found)])]
        lasting = min(scores) if len(scores) == EVALUATIONS else 0.0
        stands = max(lasting, scores[-1] - SINGLE_MARGIN)
        stands = stands if even is None else max(stands, scores[-1])
        ends = [f.lead for f in found if f.lead.hypothesis.ends is not None and f.lead.size > RECOVERED_SHARE]
        found = [f for f in found if f.lead.hypothesis.ends is None and stands >= least]
        findings = []
        for f in found:
            f.score = min(f.score, stands)
            f.explained = f.explained if self.unknown else 1.0
            findings.append(fault_finding(f, self.model, onset=self._onset(f, span, first), span=span))
        return Evaluation(
            span.end, evidence, found, findings, scores, stands,
            labels={_family(f): f.lead.hypothesis.label for f in found},
            over={fault(str(e.hypothesis.ends)).family: span.starts[e.onset] for e in ends},
        )  # fmt: skip

    def _onset(self, found: Found, span: Span, first: float) -> float:
        """s; as reported before, where the frames before it are no longer kept."""
        (k,) = found.lead.onset_quantiles(0.5) if found.lead.onset else (0,)
        onset = max(span.starts[k], first)
        known, _ = self.active.now.get(_family(found), (None, 0))
        return min(onset, known.onset_s) if known is not None and span.lost(k) else onset

    def take(
        self, evaluation: Evaluation, oldest: float
    ) -> tuple[list[FaultFinding], list[tuple[float, float]]]:
        """Let an evaluation count; see `ActiveFaults.take`."""
        self.at, self._scores = evaluation.now, evaluation.scores
        return self.active.take(evaluation, oldest)


def _family(found: Found) -> str:
    return fault(found.group[0]).family
