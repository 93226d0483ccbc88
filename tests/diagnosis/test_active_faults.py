"""Active faults from evaluation to evaluation: raised once, missed three times running before it is gone,
over for good."""

from __future__ import annotations

import math

from made_up_evidence import drawn

from fdd.diagnosis.active_faults import ActiveFaults, Evaluation
from fdd.diagnosis.findings import FaultFinding

EVIDENCE = drawn(1, frames=5)


def finding(family: str, onset: float = 10.0, confidence: float = 0.9) -> FaultFinding:
    return FaultFinding(
        fault=f"{family}_fault", family=family, ambiguity=[f"{family}_fault"], confidence=confidence,
        onset_s=onset, detected_s=onset + 10.0, severity=0.5,
    )  # fmt: skip


def evaluation(now: float, *findings: FaultFinding, over: dict[str, float] | None = None) -> Evaluation:
    labels = {f.family: f"label of {f.family}" for f in findings}
    return Evaluation(now, EVIDENCE, list(findings), [9.0], 9.0, labels, over or {})


def families(found: list[FaultFinding]) -> list[str]:
    return [f.family for f in found]


def test_a_fault_is_new_once_and_gone_when_three_looks_running_missed_it() -> None:
    active, leak = ActiveFaults(), finding("leakage")
    assert families(active.take(evaluation(20.0, leak), 0.0)[0]) == ["leakage"]
    for now, seen, stands in (
        (25.0, False, True), (30.0, False, True), (35.0, True, True),  # seen again: counted anew
        (40.0, False, True), (45.0, False, True), (50.0, False, False),
    ):  # fmt: skip
        fresh, over = active.take(evaluation(now, *[leak] * seen), 0.0)
        assert not fresh and not over
        assert families(active.findings()) == ["leakage"] * stands, now
    assert active.intervals() == [(10.0, 50.0)], "it may have been there until it was gone"
    assert active.labels == {}
    assert families(active.take(evaluation(55.0, finding("leakage", 52.0)), 0.0)[0]) == ["leakage"]
    assert active.alarms["leakage"].onset_s == 10.0, "the first of its family"
    assert active.intervals() == [(10.0, 50.0), (52.0, math.inf)]


def test_of_two_findings_of_a_family_the_surer_one_stands() -> None:
    active = ActiveFaults()
    active.take(evaluation(20.0, finding("leakage", 10.0), finding("leakage", 15.0, 0.6)), 0.0)
    assert [f.onset_s for f in active.findings()] == [10.0]


def test_a_fault_is_over_once_it_has_been_gone_for_a_minute() -> None:
    """Less, and it may be one that comes and goes."""
    active, leak = ActiveFaults(), finding("leakage")
    active.take(evaluation(70.0, leak), 0.0)
    for now in (95.0, 159.0):
        assert active.take(evaluation(now, leak, over={"leakage": 100.0}), 0.0) == ([], [])
        assert families(active.findings()) == ["leakage"]
    fresh, over = active.take(evaluation(160.0, leak, over={"leakage": 100.0, "aeration": 20.0}), 0.0)
    assert not fresh and over == [(10.0, 100.0)], "only what stood can be over, and is not raised again by it"
    assert active.findings() == [] and active.intervals() == [(10.0, 100.0)]
    assert families(active.past(set(), 0.0)) == ["leakage"], "what was is told"
    assert active.past({"leakage"}, 0.0) == [], "but not twice"


def test_an_alarm_that_the_evidence_at_hand_refutes_is_not_told() -> None:
    """Gone though its onset is still in sight: it was none. Older than that: nothing speaks against it."""
    active = ActiveFaults()
    active.take(evaluation(20.0, finding("leakage")), 0.0)
    for now in (25.0, 30.0, 35.0):
        active.take(evaluation(now), 0.0)
    assert active.past(set(), 5.0) == []
    assert families(active.past(set(), 11.0)) == ["leakage"]
