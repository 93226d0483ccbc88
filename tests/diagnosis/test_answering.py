"""The answer: intervals, probabilities, what a log could not show, estimates that may be believed."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_evidence import FRAMES, drawn, hypothesis

import fdd
from estimators.eha import layout
from estimators.observability import Observed
from fdd.diagnosis import decision
from fdd.diagnosis.answering import Span, fault_finding, hidden_share, invisible, probabilities_of
from fdd.diagnosis.decision import Found, decide
from fdd.diagnosis.estimates import believed
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding, Invisible
from fdd.diagnosis.model import Calibration, Model, root
from fdd.residuals.quantities import Scales
from fdd.unit import Unit
from tests.made_up import finding

SPAN = Span([100.0 + 0.5 * k for k in range(FRAMES)], 140.0)
INNER = hypothesis("internal_leakage", [1.0, 0.0, 0.0])
AIR = hypothesis("aeration", [0.0, 1.0, 0.2])
EVERY = [INNER, AIR]


def said(found: Found, model: Model) -> FaultFinding:
    return fault_finding(found, model, onset=SPAN.starts[found.lead.onset], span=SPAN)


def doubting(model: Model, doubt: float) -> Model:
    calibration = Calibration(midpoint=3.0, slope=1.0, severity_doubt=doubt)
    return model.model_copy(update={"calibration": calibration})


@pytest.fixture(scope="module")
def sure(tiny_model: Model) -> Model:
    """Severities as sure as the log itself makes them."""
    return doubting(tiny_model, 0.0)


def test_four_of_five_intervals_hold_the_truth(sure: Model) -> None:
    """Of severity, and of an onset that is not known to a frame: a small step's."""
    held = []
    for seed in range(120):
        found, _ = decide(drawn(seed, [(INNER, 0.25, 40)]), EVERY, 4.0)
        if found and found[0].known:
            answer = said(found[0], sure)
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
    spreads = [0.5 * math.log(x[1] / x[0]) / 1.2816 for x in (wide, narrow)]
    assert spreads[0] == pytest.approx(math.hypot(spreads[1], 0.15), rel=0.02)
    assert math.sqrt(wide[0] * wide[1]) == pytest.approx(abs(found.lead.active_amplitude), rel=0.01)
    assert 0.0 < said(found, doubting(tiny_model, 3.0)).severity_interval[0] < 0.05


def test_a_fault_beside_a_surer_one_is_said_as_second_ones_are(sure: Model) -> None:
    """By its own curve: what the first one's law leaves is explained by half, and small, at any score."""
    one, two = decide(drawn(2, [(INNER, 0.7, 25), (AIR, 0.6, 55)]), EVERY, 6.0)[0]
    assert one.gain_ratio is None and two.gain_ratio == pytest.approx(two.lead.gain / one.lead.gain)
    sure, two = sure.model_copy(deep=True), replace(two, explained=0.8)
    sure.calibration.second_gain, ratio = 0.5, math.log(two.gain_ratio)
    sure.calibration.second_midpoint = 0.8 * root(two.score) + 0.5 * ratio
    answer, share = said(two, sure), sum(two.shares[f] for f in two.group)
    assert answer.confidence == pytest.approx(0.5 * share, abs=1e-3) and answer.score == round(two.score, 2)
    assert said(replace(two, explained=0.5), sure).confidence < 0.45 * share
    assert said(replace(two, gain_ratio=0.1 * two.gain_ratio), sure).confidence < 0.45 * share
    assert said(replace(two, gain_ratio=None), sure).confidence > 0.9 * share
    assert said(replace(two, explained=0.1), sure).confidence > 0.5, "an unknown one explains nothing"


def test_what_was_there_before_the_log_has_no_interval_of_its_onset(sure: Model) -> None:
    for onset in (0, 25):
        (found,), _ = decide(drawn(1, [(INNER, 1.5, onset)]), [INNER], 2.0)
        assert (said(found, sure).onset_interval is None) == (onset == 0)


def test_a_finding_without_gain_explains_all_where_nothing_is_left(monkeypatch) -> None:
    """Refitted beside its own end it may have none: a share of nothing."""
    isolated = decision._isolated

    def without_gain(*given: object) -> Found:
        return replace(found := isolated(*given), lead=replace(found.lead, gain=0.0))

    monkeypatch.setattr(decision, "_isolated", without_gain)
    monkeypatch.setattr(Evidence, "unexplained", lambda *given: -1.0)
    assert decide(drawn(1, [(INNER, 0.8, 40)]), [INNER], 4.0)[0][0].explained == 1.0


def test_families_probabilities_are_those_of_the_surest_that_holds(tiny_model: Model) -> None:
    """A second finding is the matter as far as the first is not."""
    shares = {"internal_leakage": 0.75, "check_valve_stuck_open": 0.25}
    first = finding("internal_leakage", confidence=0.8, shares=shares)
    second = finding("aeration", confidence=0.5)
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


@pytest.mark.parametrize("threshold", [4.0, pytest.param(8.0, marks=pytest.mark.slow)])
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
    assert one.severity < other.severity
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


CHANNELS = ("position", "pump_angle", "pressure_1", "pressure_2", "oil_temperature")
DEMO = Unit.load(Path(fdd.__file__).parent / "demo" / "unit.yaml")


def seen(value: float, std: float) -> Observed:
    one = np.ones(2)
    return Observed(one > 0.0, std * one, value * one, std * one, 0.0 * one)


def judged(
    leakage: float, modulus: float = 1.0, faults: Sequence[FaultFinding] = (), unit: Unit = DEMO,
    channels: tuple[str, ...] = CHANNELS,
) -> tuple[dict[str, Observed], dict[str, str]]:  # fmt: skip
    """Records at 10 and 30 s; estimates over the profile's, each known to 2 %."""
    records = np.zeros(2, layout.RECORD)
    records["time"], records["viscosity"] = (10.0, 30.0), 1.0
    values = {"leakage": leakage * unit.pump.total_leakage, "bulk_modulus": modulus * unit.oil.bulk_modulus}
    found = {name: seen(value, 0.02 * value) for name, value in values.items()}
    return believed(found, records, unit, channels, faults)


KINDS = ("internal_leakage", "relief_valve_stuck_open", "aeration")
LEAK, VALVE, AERATED = ([finding(kind, 20.0, severity=0.5)] for kind in KINDS)
NEVER, BEFORE, AFTER, ALWAYS = [False, False], [True, False], [False, True], [True, True]
OWN = 1.0 + 0.5 * Scales.of(DEMO).fault_leakage / DEMO.pump.total_leakage


@pytest.mark.parametrize(
    ("leakage", "modulus", "found", "leakage_valid", "modulus_valid"),
    [
        (1.05, 0.9, [], ALWAYS, ALWAYS),
        (200.0, 0.1, [], NEVER, NEVER),
        (OWN, 1.0, LEAK, AFTER, ALWAYS),  # more by its own size, from its onset on
        (200.0, 1.0, LEAK, NEVER, ALWAYS),
        (0.5, 1.0, LEAK, NEVER, ALWAYS),
        (1.0, 1.0, VALVE, BEFORE, ALWAYS),  # a valve's oil does not cross the ports
        (1.0, 0.3, AERATED, ALWAYS, AFTER),
        (1.0, 3.0, AERATED, ALWAYS, NEVER),
    ],
)
def test_an_estimate_agrees_with_the_profile_or_with_what_was_found(
    leakage: float, modulus: float, found: list[FaultFinding], leakage_valid: list, modulus_valid: list
) -> None:
    """Before a fault at 20 s and after it; what agrees with neither is held at the profile, and why."""
    out, why = judged(leakage, modulus, found)
    healthy = {"leakage": DEMO.pump.total_leakage, "bulk_modulus": DEMO.oil.bulk_modulus}
    for name, valid in (("leakage", leakage_valid), ("bulk_modulus", modulus_valid)):
        assert out[name].valid.tolist() == valid, name
        if valid == NEVER and not found:
            assert out[name].held[-1] == pytest.approx(healthy[name]) and "agrees neither" in why[name]
    if leakage_valid == ALWAYS:
        assert out["leakage"].held[-1] == pytest.approx(leakage * healthy["leakage"])


def test_a_bulk_modulus_at_an_unknown_pressure_is_none() -> None:
    out, why = judged(1.0, channels=("position", "pump_speed", "pressure_difference"))
    assert not out["bulk_modulus"].valid.any() and "pressure" in why["bulk_modulus"]


def test_a_base_says_nothing_of_a_unit() -> None:
    out, why = judged(200.0, unit=Unit.load("axis_a"))
    assert out["leakage"].valid.all() and not why
