"""Evaluations one after another: how many an alarm takes, which faults are active, and their end."""

import math

import pytest
from made_up_evidence import drawn, hypothesis

from fdd.diagnosis.answering import Span
from fdd.diagnosis.decision import decide
from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.model import Model
from fdd.diagnosis.sequential_detector import ActiveFaults, Evaluation, SequentialDetector
from tests.made_up import finding

INNER = hypothesis("internal_leakage", [1.0, 0.0, 0.0])
AIR = hypothesis("aeration", [0.0, 1.0, 0.2])
STEP = drawn(1, [(INNER, 0.6, 40)])
SCORE = decide(STEP, [INNER, AIR], 0.0)[0][0].score


def span(end: float, frames: int = 80, start: float | None = None) -> Span:
    first = end - 0.5 * frames if start is None else start
    return Span([first + 0.5 * k for k in range(frames)], end)


def families(found: list[FaultFinding]) -> list[str]:
    return [f.family for f in found]


@pytest.mark.parametrize(("above", "looks"), [(0.2, 3), (1.4, 3), (1.6, 1)])
def test_an_alarm_takes_three_looks_or_one_that_is_much_surer(tiny_model, above, looks):
    """By 1.5 of the log likelihood: the odds that a peak of chance alone would have."""
    detector = SequentialDetector([INNER, AIR], SCORE - above, tiny_model)
    for k in range(1, 4):
        evaluation = detector.evaluate(STEP, span(40.0 + 5.0 * k), 0.0)
        fresh, _ = detector.take(evaluation, 0.0)
        assert families(fresh) == ["leakage"] * (k == looks), k
        assert families(evaluation.findings) == ["leakage"] * (k >= looks)
        assert detector.at == 40.0 + 5.0 * k
    assert evaluation.stands == pytest.approx(SCORE)


def test_a_look_without_evidence_between_begins_to_count_anew(tiny_model: Model) -> None:
    detector, healthy = SequentialDetector([INNER, AIR], SCORE - 0.2, tiny_model), drawn(1)
    for k, evidence in enumerate([STEP, STEP, healthy, STEP, STEP, STEP]):
        fresh, _ = detector.take(detector.evaluate(evidence, span(40.0 + 5.0 * k), 0.0), 0.0)
        assert families(fresh) == ["leakage"] * (k == 5), k


def test_a_finding_is_as_sure_as_what_stood_and_no_surer(tiny_model: Model) -> None:
    """Of three looks the least, where the last one alone does not say more."""
    detector, weaker = SequentialDetector([INNER, AIR], 4.0, tiny_model), drawn(1, [(INNER, 0.2, 40)])
    least = decide(weaker, [INNER, AIR], 4.0)[0][0].score
    assert 4.0 < least < SCORE - 1.5
    for k, evidence in enumerate([weaker, STEP, STEP]):
        evaluation = detector.evaluate(evidence, span(40.0 + 5.0 * k), 0.0)
        detector.take(evaluation, 0.0)
    assert evaluation.stands == pytest.approx(SCORE - 1.5)
    [found] = evaluation.findings
    assert found.confidence == pytest.approx(tiny_model.calibration.probability(SCORE - 1.5), abs=1e-3)


def test_a_second_look_at_the_same_end_counts_once(tiny_model: Model) -> None:
    """As `finish` looks again where the last scan looked."""
    detector = SequentialDetector([INNER, AIR], SCORE - 0.2, tiny_model)
    for end in (45.0, 50.0):
        detector.take(detector.evaluate(STEP, span(end), 0.0), 0.0)
        for _ in range(3):
            assert detector.evaluate(STEP, span(end), 0.0).findings == []
    assert families(detector.evaluate(STEP, span(55.0), 0.0).findings) == ["leakage"]
    assert detector.active.findings() == [], "only a look that is taken counts"
    detector.take(detector.evaluate(STEP, span(55.0), 0.0), 0.0)
    assert families(detector.evaluate(STEP, span(55.0), 0.0).findings) == ["leakage"], (
        "two others stand behind it"
    )


def test_an_onset_is_not_before_the_first_sample_and_stays_once_its_frames_are_gone(tiny_model):
    detector = SequentialDetector([INNER], 1.0, tiny_model)
    [found] = detector.evaluate(STEP, span(40.0), 20.3).findings
    assert found.onset_s == 20.3, "in the middle of the frame that it falls in"
    detector.take(detector.evaluate(STEP, span(40.0), 0.0), 0.0)
    assert detector.active.findings()[0].onset_s == 20.0
    always = drawn(1, [(INNER, 1.5, 0)])
    [late] = detector.evaluate(always, span(90.0), 0.0).findings
    assert late.onset_s == 20.0, "the first of the frames kept is not when it began"
    fresh = SequentialDetector([INNER], 1.0, tiny_model)
    assert fresh.evaluate(always, span(90.0), 0.0).findings[0].onset_s == 50.0


def test_a_fault_that_heals_is_over_and_its_end_no_fault(tiny_model: Model) -> None:
    detector = SequentialDetector([INNER, AIR], 5.0, tiny_model)
    detector.take(detector.evaluate(drawn(1, [(INNER, 0.8, 25)]), span(40.0), 0.0), 0.0)
    recovered = drawn(1, [(INNER, 0.8, 25), (INNER, -0.8, 45)])
    evaluation = detector.evaluate(recovered, span(40.0), 0.0)
    assert families(evaluation.findings) == ["leakage"]
    assert evaluation.over == {"leakage": pytest.approx(22.5, abs=0.5)}
    assert evaluation.labels == {"leakage": "internal_leakage"}
    lessened = drawn(1, [(INNER, 1.6, 25), (INNER, -0.5, 45)])
    assert detector.evaluate(lessened, span(40.0), 0.0).over == {}, "most of it is still there"


def test_a_detector_of_known_kinds_alone_tells_the_nearest(tiny_model: Model) -> None:
    strange = drawn(1, [(hypothesis("other", [0.2, 0.8, 0.0]), 1.0, 40)])
    for unknown, family in ((True, "unknown"), (False, "leakage")):
        detector = SequentialDetector([INNER], 4.0, tiny_model, unknown=unknown)
        evaluation = detector.evaluate(strange, span(40.0), 0.0)
        assert families(evaluation.findings)[0] == family and family in evaluation.labels


LEAK = finding("internal_leakage", 10.0)


def evaluation(now: float, *findings: FaultFinding, over: dict[str, float] | None = None) -> Evaluation:
    labels = {f.family: f"label of {f.family}" for f in findings}
    return Evaluation(now, drawn(1, frames=5), [], list(findings), [9.0], 9.0, labels, over or {})


def test_a_fault_is_new_once_and_gone_when_three_looks_running_missed_it() -> None:
    active = ActiveFaults()
    assert families(active.take(evaluation(20.0, LEAK), 0.0)[0]) == ["leakage"]
    for now, seen, stands in (
        (25.0, False, True), (30.0, False, True), (35.0, True, True),  # seen again: counted anew
        (40.0, False, True), (45.0, False, True), (50.0, False, False),
    ):  # fmt: skip
        fresh, over = active.take(evaluation(now, *[LEAK] * seen), 0.0)
        assert not fresh and not over
        assert families(active.findings()) == ["leakage"] * stands, now
    assert active.intervals() == [(10.0, 50.0)], "it may have been there until it was gone"
    assert active.labels == {}
    assert families(active.take(evaluation(55.0, finding("internal_leakage", 52.0)), 0.0)[0]) == ["leakage"]
    assert active.alarms["leakage"].onset_s == 10.0, "the first of its family"
    assert active.intervals() == [(10.0, 50.0), (52.0, math.inf)]


def test_of_two_findings_of_a_family_the_surer_one_stands() -> None:
    active = ActiveFaults()
    weaker = finding("internal_leakage", 15.0, confidence=0.6)
    active.take(evaluation(20.0, LEAK, weaker), 0.0)
    assert [f.onset_s for f in active.findings()] == [10.0]


def test_a_fault_is_over_once_it_has_been_gone_for_a_minute() -> None:
    """Less, and it may be one that comes and goes."""
    active = ActiveFaults()
    active.take(evaluation(70.0, LEAK), 0.0)
    for now in (95.0, 159.0):
        assert active.take(evaluation(now, LEAK, over={"leakage": 100.0}), 0.0) == ([], [])
        assert families(active.findings()) == ["leakage"]
    fresh, over = active.take(evaluation(160.0, LEAK, over={"leakage": 100.0, "aeration": 20.0}), 0.0)
    assert not fresh and over == [(10.0, 100.0)], "only what stood can be over, and is not raised again by it"
    assert active.findings() == [] and active.intervals() == [(10.0, 100.0)]
    assert families(active.past(set(), 0.0)) == ["leakage"], "what was is told"
    assert active.past({"leakage"}, 0.0) == [], "but not twice"


def test_a_fault_that_began_again_after_an_end_of_its_family_is_not_over() -> None:
    """Nor raised anew, however long ago the end was."""
    active, later = ActiveFaults(), finding("internal_leakage", 60.0)
    raised = [
        active.take(evaluation(now, later, over={"leakage": 40.0}), 0.0) for now in (90.0, 101.0, 106.0)
    ]
    assert [families(fresh) for fresh, _ in raised] == [["leakage"], [], []]
    assert not any(over for _, over in raised)


def test_an_alarm_that_the_evidence_at_hand_refutes_is_not_told() -> None:
    """Gone though its onset is still in sight: it was none. Older than that: nothing speaks against it."""
    active = ActiveFaults()
    active.take(evaluation(20.0, LEAK), 0.0)
    for now in (25.0, 30.0, 35.0):
        active.take(evaluation(now), 0.0)
    assert active.past(set(), 5.0) == []
    assert families(active.past(set(), 11.0)) == ["leakage"]
