"""Which faults are active: raised, confirmed or missed at each evaluation of the evidence, and over in the
end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding

EVALUATIONS = 3
"""Consecutive evaluations above the threshold that raise a fault: an on-delay of ten seconds (ISA-18.2)
against transients. As many below it clear the fault."""
RECOVERED_S = 60.0
"""s for which a fault has to be gone before it is over: an intermittent fault that returns within a minute
stays active."""


@dataclass(frozen=True)
class Evaluation:
    """Result of one evaluation of the evidence.

    Attributes
    ----------
    now : s, its time. findings : active ones. scores : largest of each of the last evaluations, this one
        last.
    stands : the score that counts, see `SequentialDetector.evaluate`. labels : family to the leading
        hypothesis.
    over : family whose fault seems to have ended, to when (s).
    """

    now: float
    evidence: Evidence
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
    alarms : first finding of each family that was ever active.
    now : active families with their finding, and the number of evaluations in a row that have missed it.
    labels : of their leading hypotheses. fault_intervals : s, onset and end of faults that were active
        before.
    recovered : families of which a fault ended by the evidence, not by missing it.

    Examples
    --------
    >>> ActiveFaults().intervals()
    []
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
        """Update by an evaluation.

        Parameters
        ----------
        oldest : s, of the evidence that is kept.

        Returns
        -------
        New findings, and intervals (s) of faults that have ended, whose frames must be dropped: to the
        reference they would look like another fault.
        """
        seen = {f.family: f for f in reversed(evaluation.findings)}
        over = []
        for family, since in evaluation.over.items():
            if evaluation.now - since >= RECOVERED_S and family in self.now:
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
        """Alarms of families not seen now that nothing has refuted: ended, or with an onset before `start`
        (s)."""
        return [
            f for k, f in self.alarms.items() if k not in seen and (f.onset_s < start or k in self.recovered)
        ]

    def state(self) -> dict[str, Any]:
        """All of it, as JSON takes it."""
        return {
            "alarms": {k: f.model_dump() for k, f in self.alarms.items()},
            "now": {k: (f.model_dump(), n) for k, (f, n) in self.now.items()},
            "labels": self.labels, "fault_intervals": self.fault_intervals,
            "recovered": sorted(self.recovered),
        }  # fmt: skip

    @classmethod
    def of(cls, state: dict[str, Any]) -> ActiveFaults:
        """What `state` gave."""
        return cls(
            alarms={k: FaultFinding.model_validate(f) for k, f in state["alarms"].items()},
            now={k: (FaultFinding.model_validate(f), int(n)) for k, (f, n) in state["now"].items()},
            labels=dict(state["labels"]),
            fault_intervals=[(float(a), float(b)) for a, b in state["fault_intervals"]],
            recovered=set(state["recovered"]),
        )
