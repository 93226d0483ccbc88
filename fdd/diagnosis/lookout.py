"""Looks at the evidence on one scale of time, one after another: what each says, and what stands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fdd.diagnosis.answering import Span, fault_finding
from fdd.diagnosis.decision import Found, decide
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.model import Model
from fdd.diagnosis.standing import LOOKS, Look, Standing
from fdd.faults import fault

LOOK_MARGIN = 1.5
"""By how much more one look alone must see it."""
HEALED = 0.5
"""Share of a fault that has to be gone before it is over."""


class Lookout:
    """What stands on one scale of time.

    Parameters
    ----------
    hypotheses : faults considered. threshold : score of an alarm. model : learnt layer.
    unknown : a change that the catalogue explains less than half of is told as an unknown fault. Over weeks
        much else changes, too.

    Attributes
    ----------
    standing : faults that stand. at : s, end of the data at the last look that was taken; 0 before it.
    """

    def __init__(
        self, hypotheses: Sequence[Hypothesis], threshold: float, model: Model, *, unknown: bool = True
    ) -> None:
        self.unknown = unknown
        self.hypotheses, self.threshold, self.model = hypotheses, threshold, model
        self.standing = Standing()
        self.at = 0.0
        self._scores: list[float] = []

    def look(self, evidence: Evidence, span: Span, first: float, *, even: float | None = None) -> Look:
        """What the evidence says now; it counts once `take` has it.

        Parameters
        ----------
        span : its frames in time. first : s, of the first sample. even : score of what is said of the log as
            a whole, whatever stood before; None asks for what stands, as an alarm does.
        """
        labels = self.standing.labels.values()
        least = self.threshold if even is None else even
        found, rest = decide(evidence, self.hypotheses, least, labels)
        before = self._scores[:-1] if self.at == span.end else self._scores
        scores = [*before[1 - LOOKS :], max([rest, *(f.score for f in found)])]
        stands = max(min(scores) if len(scores) == LOOKS else 0.0, scores[-1] - LOOK_MARGIN)
        stands = stands if even is None else max(stands, scores[-1])
        ends = [f.lead for f in found if f.lead.hypothesis.ends is not None and f.lead.size > HEALED]
        found = [f for f in found if f.lead.hypothesis.ends is None and stands >= least]
        findings = []
        for f in found:
            f.score = min(f.score, stands)
            f.explained = f.explained if self.unknown else 1.0
            findings.append(fault_finding(f, self.model, onset=self._onset(f, span, first), span=span))
        return Look(
            span.end, evidence, findings, scores, stands,
            labels={_family(f): f.lead.hypothesis.label for f in found},
            over={fault(str(e.hypothesis.ends)).family: span.starts[e.onset] for e in ends},
        )  # fmt: skip

    def _onset(self, found: Found, span: Span, first: float) -> float:
        """s; where the frames after it are no longer kept, as it was told before."""
        k = found.lead.onset
        onset = max(span.starts[k], first)
        known, _ = self.standing.now.get(_family(found), (None, 0))
        return min(onset, known.onset_s) if known is not None and span.lost(k) else onset

    def take(self, look: Look, oldest: float) -> tuple[list[FaultFinding], list[tuple[float, float]]]:
        """Let a look count; see `Standing.take`."""
        self.at, self._scores = look.now, look.scores
        return self.standing.take(look, oldest)

    def state(self) -> dict[str, Any]:
        """All of it, as JSON takes it."""
        return {"standing": self.standing.state(), "at": self.at, "scores": self._scores}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.standing, self.at = Standing.of(state["standing"]), float(state["at"])
        self._scores = [float(s) for s in state["scores"]]


def _family(found: Found) -> str:
    return fault(found.group[0]).family
