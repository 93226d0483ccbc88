"""What stands from look to look: raised once, missed three times running before it is gone, over for good."""

from __future__ import annotations

import json
import math

from made_up_evidence import drawn

from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.standing import Look, Standing

EVIDENCE = drawn(1, frames=5)


def finding(family: str, onset: float = 10.0, confidence: float = 0.9) -> FaultFinding:
    return FaultFinding(
        fault=f"{family}_fault", family=family, ambiguity=[f"{family}_fault"], confidence=confidence,
        onset_s=onset, detected_s=onset + 10.0, severity=0.5,
    )  # fmt: skip


def look(now: float, *findings: FaultFinding, over: dict[str, float] | None = None) -> Look:
    labels = {f.family: f"label of {f.family}" for f in findings}
    return Look(now, EVIDENCE, list(findings), [9.0], 9.0, labels, over or {})


def families(found: list[FaultFinding]) -> list[str]:
    return [f.family for f in found]


def test_a_fault_is_new_once_and_gone_when_three_looks_running_missed_it() -> None:
    standing, leak = Standing(), finding("leakage")
    assert families(standing.take(look(20.0, leak), 0.0)[0]) == ["leakage"]
    for now, seen, stands in (
        (25.0, False, True), (30.0, False, True), (35.0, True, True),  # seen again: counted anew
        (40.0, False, True), (45.0, False, True), (50.0, False, False),
    ):  # fmt: skip
        fresh, over = standing.take(look(now, *[leak] * seen), 0.0)
        assert not fresh and not over
        assert families(standing.findings()) == ["leakage"] * stands, now
    assert standing.spans() == [(10.0, 50.0)], "it may have been there until it was gone"
    assert standing.labels == {}
    assert families(standing.take(look(55.0, finding("leakage", 52.0)), 0.0)[0]) == ["leakage"]
    assert standing.alarms["leakage"].onset_s == 10.0, "the first of its family"
    assert standing.spans() == [(10.0, 50.0), (52.0, math.inf)]


def test_one_fault_comes_while_another_stands() -> None:
    standing = Standing()
    standing.take(look(20.0, finding("leakage")), 0.0)
    fresh, _ = standing.take(look(25.0, finding("leakage"), finding("aeration", 14.0)), 0.0)
    assert families(fresh) == ["aeration"] and standing.now.keys() == {"leakage", "aeration"}
    standing.take(look(30.0, finding("aeration", 14.0)), 0.0)
    assert standing.labels == {f: f"label of {f}" for f in ("leakage", "aeration")}
    for now in (35.0, 40.0):
        standing.take(look(now, finding("aeration", 14.0)), 0.0)
    assert standing.labels == {"aeration": "label of aeration"}
    assert standing.spans() == [(10.0, 40.0), (14.0, math.inf)]


def test_of_two_findings_of_a_family_the_surer_one_stands() -> None:
    standing = Standing()
    standing.take(look(20.0, finding("leakage", 10.0), finding("leakage", 15.0, 0.6)), 0.0)
    assert [f.onset_s for f in standing.findings()] == [10.0]


def test_a_fault_is_over_once_it_has_been_gone_for_a_minute() -> None:
    """Less, and it may be one that comes and goes."""
    standing, leak = Standing(), finding("leakage")
    standing.take(look(70.0, leak), 0.0)
    for now in (95.0, 159.0):
        assert standing.take(look(now, leak, over={"leakage": 100.0}), 0.0) == ([], [])
        assert families(standing.findings()) == ["leakage"]
    fresh, over = standing.take(look(160.0, leak, over={"leakage": 100.0, "aeration": 20.0}), 0.0)
    assert not fresh and over == [(10.0, 100.0)], "only what stood can be over, and is not raised again by it"
    assert standing.findings() == [] and standing.spans() == [(10.0, 100.0)]
    assert families(standing.past(set(), 0.0)) == ["leakage"], "what was is told"
    assert standing.past({"leakage"}, 0.0) == [], "but not twice"


def test_an_alarm_that_the_evidence_at_hand_refutes_is_not_told() -> None:
    """Gone though its onset is still in sight: it was none. Older than that: nothing speaks against it."""
    standing = Standing()
    standing.take(look(20.0, finding("leakage")), 0.0)
    for now in (25.0, 30.0, 35.0):
        standing.take(look(now), 0.0)
    assert standing.past(set(), 5.0) == []
    assert families(standing.past(set(), 11.0)) == ["leakage"]


def test_what_ended_before_the_oldest_evidence_is_forgotten() -> None:
    standing = Standing(sick=[(1.0, 40.0), (60.0, 80.0)])
    standing.take(look(100.0), 50.0)
    assert standing.spans() == [(60.0, 80.0)]


def test_its_state_is_json_and_goes_on_as_it_was() -> None:
    standing = Standing()
    standing.take(look(20.0, finding("leakage"), finding("aeration")), 0.0)
    standing.take(look(100.0, finding("aeration"), over={"leakage": 30.0}), 0.0)
    standing.take(look(105.0), 0.0)
    again = Standing.of(json.loads(json.dumps(standing.state())))
    assert again == standing
    assert again.healed == {"leakage"} and again.now["aeration"][1] == 1
