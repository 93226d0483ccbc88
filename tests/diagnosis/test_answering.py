"""The answer's figures: intervals that cover, probabilities that follow Bayes, what a log could not show."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from made_up_evidence import drawn, hypothesis

from fdd.diagnosis.answering import Span, fault_finding, hidden_share, invisible, probabilities_of
from fdd.diagnosis.decision import Found, decide
from fdd.diagnosis.findings import FaultFinding, Invisible
from fdd.diagnosis.model import Calibration, Model

FRAMES = 80
SPAN = Span([100.0 + 0.5 * k for k in range(FRAMES)], 140.0)
INNER = hypothesis("internal_leakage", [1.0, 0.0, 0.0])
AIR = hypothesis("aeration", [0.0, 1.0, 0.2])
EVERY = [INNER, AIR]


def said(found: Found, model: Model, span: Span = SPAN) -> FaultFinding:
    return fault_finding(found, model, onset=span.starts[found.lead.onset], span=span)


@pytest.fixture(scope="module")
def sure(tiny_model: Model) -> Model:
    """Severities as sure as the log itself makes them."""
    return tiny_model.model_copy(
        update={"calibration": Calibration(midpoint=3.0, slope=1.0, severity_doubt=0.0)}
    )


def test_four_of_five_intervals_hold_the_truth(sure: Model) -> None:
    """Of severity, and of an onset that is not known to a frame: a small step's."""
    held = []
    for seed in range(120):
        found, _ = decide(drawn(seed, [(INNER, 0.25, 40)]), EVERY, 4.0)
        if found and found[0].known:
            answer = said(found[0], sure)
            assert answer.severity_interval is not None and answer.onset_interval is not None
            (low, high), (early, late) = answer.severity_interval, answer.onset_interval
            assert low <= answer.severity <= high and early <= answer.onset_s <= late
            held.append((low <= 0.25 <= high, early <= 120.0 <= late))
    inside = np.mean(held, axis=0)
    assert len(held) > 60
    assert 0.7 <= inside[0] <= 0.9, "80 % of severity's"
    assert inside[1] >= 0.8, "frames are whole: an onset's is no narrower than 80 %"


def test_what_no_column_knows_widens_a_severitys_interval(sure: Model, tiny_model: Model) -> None:
    """Independent errors of the logarithm: variances add up, and no severity is below none."""
    (found,), _ = decide(drawn(1, [(INNER, 0.8, 40)]), EVERY, 4.0)
    wide, narrow = (said(found, m).severity_interval for m in (tiny_model, sure))
    assert wide is not None and narrow is not None
    spreads = [0.5 * math.log(x[1] / x[0]) / 1.2816 for x in (wide, narrow)]
    assert spreads[0] == pytest.approx(math.hypot(spreads[1], 0.15), rel=0.02)
    assert math.sqrt(wide[0] * wide[1]) == pytest.approx(abs(found.lead.active_amplitude), rel=0.01)
    doubtful = tiny_model.model_copy(
        update={"calibration": Calibration(midpoint=3.0, slope=1.0, severity_doubt=3.0)}
    )
    interval = said(found, doubtful).severity_interval
    assert interval is not None and 0.0 < interval[0] < 0.05


def test_a_fault_beside_a_surer_one_is_said_with_the_odds_of_a_second(sure: Model) -> None:
    """By Bayes: its odds alone, times the learnt ones of a second finding."""
    one, two = decide(drawn(2, [(INNER, 0.7, 25), (AIR, 0.6, 55)]), EVERY, 6.0)[0]
    assert (one.second, two.second) == (False, True) and one.score > two.score
    alone = said(replace(two, second=False), sure).confidence
    odds = said(two, sure).confidence / (1.0 - said(two, sure).confidence)
    assert odds == pytest.approx(math.exp(-sure.calibration.second) * alone / (1.0 - alone), rel=0.02)


def finding(fault: str, family: str, confidence: float, **shares: float) -> FaultFinding:
    return FaultFinding(
        fault=fault, family=family, ambiguity=[fault], confidence=confidence, onset_s=0.0, detected_s=1.0,
        shares=shares,
    )  # fmt: skip


def test_families_probabilities_are_those_of_the_surest_that_holds(tiny_model: Model) -> None:
    """A second finding is the matter as far as the first is not."""
    first = finding("internal_leakage", "leakage", 0.8, internal_leakage=0.75, check_valve_stuck_open=0.25)
    second = finding("aeration", "aeration", 0.5)
    found = probabilities_of([first, second], tiny_model, 0.0, 0.0)
    expected = {"leakage": 0.6, "check_valve": 0.2, "aeration": 0.1, "healthy": 0.1}
    assert {k: v for k, v in found.items() if v} == pytest.approx(expected, abs=1e-3)
    for score, hidden in ((-5.0, 0.3), (3.0, 0.0), (5.0, 0.9)):
        none = probabilities_of([], tiny_model, score, hidden)
        assert none["unknown"] == pytest.approx(tiny_model.calibration.probability(score, hidden), abs=1e-3)
        assert none["healthy"] == pytest.approx(1.0 - none["unknown"], abs=1e-3)


def test_hidden_are_those_of_the_usual_severities_that_are_too_small() -> None:
    """By a draw of severities from Rayleigh's distribution, each kind as likely."""
    drawn_ = np.random.default_rng(1).rayleigh(0.5, 200_000)
    unseen = [Invisible(fault="a", severity=0.3), Invisible(fault="b", severity=None),
              Invisible(fault="c", severity=1.0)]  # fmt: skip
    share = np.mean([np.mean(drawn_ < 0.3), 1.0, np.mean(drawn_ < 1.0)])
    assert hidden_share(unseen) == pytest.approx(share, abs=5e-3)


@pytest.mark.parametrize("threshold", [4.0, 8.0])
def test_from_the_least_severity_that_a_log_shows_on_faults_are_found(threshold: float) -> None:
    """Had it begun a third into the log, give or take half of it."""
    (said_, *_) = invisible(drawn(1), [INNER], threshold)
    (least,) = drawn(1).least_visible([INNER], FRAMES // 3, threshold)
    assert said_.fault == "internal_leakage" and said_.severity == np.ceil(100.0 * least) / 100.0

    def found(severity: float) -> float:
        logs = [drawn(seed, [(INNER, severity, FRAMES // 3)]) for seed in range(100, 300)]
        return float(np.mean([bool(decide(x, [INNER], threshold)[0]) for x in logs]))

    # Said of nine in ten; of 200 logs that is within 0.85 to 0.95 in 98 % of draws, and a little more are
    # found, as the onset is chosen.
    assert 0.85 <= found(least) < 1.0
    assert found(0.4 * least) <= 0.2


def test_a_fault_shows_for_sure_where_the_hardest_of_its_ways_does() -> None:
    """On which side a valve clogs nobody knows; how many would be hidden is a mean over all ways."""
    plain, faint = (replace(hypothesis("check_valve_clogged", [c, 0.0, 0.0]), side=k + 1)
                    for k, c in enumerate((1.0, 0.4)))  # fmt: skip
    (one,), (other,), (both,) = (invisible(drawn(1), x, 6.0) for x in ([plain], [faint], [plain, faint]))
    assert one.severity is not None and one.severity < (other.severity or 0.0)
    assert both.severity == other.severity and (both.side, one.side) == (2, None)
    assert both.hidden == pytest.approx(0.5 * (one.hidden + other.hidden), abs=2e-3)
    never = replace(hypothesis("check_valve_clogged", [1e-3, 0.0, 0.0]), side=1)
    (half,) = invisible(drawn(1), [plain, never], 6.0)
    assert half.severity is None and half.side == 1
    assert half.hidden == pytest.approx(0.5 + 0.5 * one.hidden, abs=2e-3)
    rare = replace(never, prior_weight=0.25)
    assert invisible(drawn(1), [plain, rare], 6.0)[0].hidden == pytest.approx(
        0.2 + 0.8 * one.hidden, abs=2e-3
    )
