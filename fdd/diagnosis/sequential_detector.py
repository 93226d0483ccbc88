"""Sequential detection: the evidence is evaluated again and again on one time scale, with an on-delay for
alarms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fdd.diagnosis.active_faults import EVALUATIONS, ActiveFaults, Evaluation
from fdd.diagnosis.answering import Span, fault_finding
from fdd.diagnosis.decision import Found, decide
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.model import Model
from fdd.faults import fault

SINGLE_MARGIN = 1.5
"""Extra score for an alarm on a single evaluation."""
RECOVERED_SHARE = 0.5
"""Share of a fault's amplitude that has to be gone before it is over."""


class SequentialDetector:
    """Detects faults on one time scale (the window of frames, or the epochs of an axis's life).

    Parameters
    ----------
    hypotheses : faults considered. threshold : score of an alarm. model : learnt layer.
    unknown : a change that the catalogue explains less than half of is reported as an unknown fault. Over
        weeks too much else changes for that.

    Attributes
    ----------
    active : faults. at : s, end of the data at the last evaluation that was taken; 0 before it.
    """

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
            span.end, evidence, findings, scores, stands,
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

    def state(self) -> dict[str, Any]:
        """All of it, as JSON takes it."""
        return {"active": self.active.state(), "at": self.at, "scores": self._scores}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.active, self.at = ActiveFaults.of(state["active"]), float(state["at"])
        self._scores = [float(s) for s in state["scores"]]


def _family(found: Found) -> str:
    return fault(found.group[0]).family
