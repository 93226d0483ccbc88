"""Lives of known course: what is told of them, how often, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest
from lives import DAYS, alarmed, life

from fdd.diagnosis.findings import Diagnosis
from fdd.errors import InputError
from fdd.history.answers import Life, Trend
from fdd.history.compare import seen
from fdd.history.trend import given_limits, severity_one, trend_of
from fdd.history.view import trend_csv, trend_sheet
from fdd.report.page import render_sheet
from fdd.unit import Unit

REPEATS = 200
LIMITS = given_limits(["leakage=2.5"])


def told(answers: list[Diagnosis]) -> Life:
    return trend_of(answers, LIMITS)[0]


def leakage(answers: list[Diagnosis]) -> Trend:
    return next(t for t in told(answers).trends if t.quantity == "leakage")


def test_a_leakage_that_grows_is_told_with_its_slope_and_its_time_to_the_limit() -> None:
    """12 logs at temperatures that alone change leakage threefold; leakage doubles over the life."""
    slope = held = reached = 0
    for seed in range(REPEATS):
        found = leakage(life(seed, growth=1.0))
        assert found.direction == "rises" and found.slope_interval and found.until_limit_interval
        held += found.slope_interval[0] < 1.0 / DAYS < found.slope_interval[1]
        reached += found.until_limit_interval[0] < 0.5 * DAYS < found.until_limit_interval[1]
        slope += (found.slope or 0.0) * DAYS
    assert abs(held / REPEATS - 0.95) < 0.04 and abs(reached / REPEATS - 0.80) < 0.074
    assert slope / REPEATS == pytest.approx(1.0, abs=0.01)


def test_healthy_lives_show_no_trend_but_one_in_twenty() -> None:
    alarms = [any(t.direction for t in told(life(seed)).trends) for seed in range(REPEATS)]
    assert sum(alarms) / REPEATS < 0.05 + 0.04
    assert told(life(0)).headline.startswith("no trend that could be told")
    assert all(t.until_limit is None for t in told(life(0)).trends)


def test_where_the_viscosity_law_is_wrong_the_logs_own_regression_is_taken() -> None:
    """Oil whose leakage goes with the root of what the profile's law says: chosen by likelihood, and told."""
    own = [leakage(life(seed, leaks_by=lambda warm: float(np.exp(-0.5 * warm)))) for seed in range(40)]
    assert sum(t.temperature == "regression" for t in own) >= 38
    assert all((t.likelihood_gain or 0.0) > 0.0 for t in own)
    held = sum(t.slope_interval[0] < 0.0 < t.slope_interval[1] for t in own if t.slope_interval)
    assert held >= 35
    lawful = [leakage(life(seed)) for seed in range(40)]
    assert sum(t.temperature == "viscosity law" for t in lawful) >= 36


def test_logs_stand_by_their_dates_else_by_their_names_and_it_is_said() -> None:
    answers = life(1, growth=1.0)
    answers[3].log, answers[9].log = "z.mcap", "a.mcap"
    shuffled = [answers[k] for k in np.random.default_rng(0).permutation(12)]
    assert told(shuffled) == told(answers)
    assert [x.log for x in told(shuffled).logs] == [a.log for a in answers]
    answers[0].started_at = None
    undated = told(answers)
    assert undated.order == "name" and undated.per == "log" and "names" in undated.notes[0]
    assert [x.log for x in undated.logs] == sorted(a.log for a in answers)
    assert [x.at for x in undated.logs] == list(range(12))


def test_what_cannot_be_read_or_has_a_failed_sensor_does_not_count() -> None:
    answers = life(2, growth=1.0)
    bad = [*answers, Diagnosis.unreadable("bad.csv", "bad.csv: the file is empty", {})]
    assert told(bad).trends == told(answers).trends and told(bad).logs[-1].left_out is not None
    answers[4] = alarmed(answers[4], "internal_leakage", "leakage")
    assert len(leakage(answers).points) == 12
    answers[4] = alarmed(answers[4], "sensor_dropout", "sensor")
    assert len(leakage(answers).points) == 11
    assert "sensor" in (told(answers).logs[4].left_out or "")
    assert trend_csv(told(bad)).count("\r\n") == 14


def test_faults_stand_first_on_no_green_page_and_doubt_about_the_order_is_told() -> None:
    answers = life(2)
    answers[4] = alarmed(answers[4], "internal_leakage", "leakage")
    found, courses = trend_of(answers, LIMITS)
    assert found.headline.startswith("faults in 1 of 12 logs (internal leakage); no trend")
    assert trend_sheet(found, courses).kind == "faulty" and found.notes == []
    assert trend_sheet(*trend_of(life(2), LIMITS)).kind == "healthy"
    answers[1].duration_s = 1e9
    assert "had ended" in told(answers).notes[0]
    falling = life(8, growth=-1.2)
    assert all(float(c.line.min(initial=0.0)) >= 0.0 for c in trend_of(falling, LIMITS)[1])


def test_too_few_logs_or_none_of_another_time_give_no_line() -> None:
    few = told(life(3, logs=3))
    assert all(t.slope is None and "3 logs" in t.sentence for t in few.trends)
    same = life(3)
    for answer in same:
        answer.started_at = "2026-01-01T00:00:00Z"
    assert all(t.slope is None for t in told(same).trends)


def test_several_units_are_refused_and_so_is_nothing() -> None:
    answers = life(4)
    answers[2].unit = "other"
    with pytest.raises(InputError, match="axis_a, other"):
        told(answers)
    with pytest.raises(InputError, match="no log"):
        told([Diagnosis.unreadable("bad.csv", "bad.csv: empty", {})])


def test_a_limit_that_is_passed_is_told_so_and_other_limits_come_from_the_catalogue() -> None:
    found = leakage(life(5, growth=3.0))
    assert found.until_limit == 0.0 and "past 2.5" in found.sentence
    limits = severity_one(Unit.load("axis_a"))
    assert limits["leakage"][1] == pytest.approx(1.0 + 12e-12 / 6.52e-12)
    # 1/β + 0.025 c(p), with c of thesis eq. 5.21 at 482 kPa gauge.
    p = 4.82e5 + 101325.0
    soft = 1.0 / 2.1e8 + 0.025 * (101325.0 / p) ** (1 / 1.4) / (1.4 * p)
    assert limits["bulk_modulus"][0] == pytest.approx(1.0 / soft / 2.1e8)
    for text in ("leakage", "leakage=x", "leakage=1", "leakage=-2", "leakage=nan", "speed=2"):
        with pytest.raises(InputError, match="--limit"):
            given_limits([text])


def test_what_is_not_observable_at_the_end_is_taken_as_it_is_known_best() -> None:
    plain = life(6)[0].estimates["leakage"]
    assert seen(plain) == (plain.value, plain.std)
    late = plain.model_copy(
        update={"observable": False, "value": 2.0, "std": 0.2, "held": 1.0, "held_std": 0.1}
    )
    assert seen(late) == (1.0, 0.1)
    assert seen(late.model_copy(update={"held_std": 0.5})) == (2.0, 0.2)
    assert seen(late.model_copy(update={"held": None, "held_std": None})) is None
    assert seen(late.model_copy(update={"observable": True})) == (2.0, 0.2)


def test_the_page_marks_alarms_and_keeps_text_of_logs_text() -> None:
    answers = life(7, growth=1.0)
    answers[0].started_at = "2026-01-01T00:00:00.120000007Z"
    answers[5] = alarmed(answers[5], "internal_leakage", "leakage")
    answers[6].log = "<script>alert(1)</script>"
    found, courses = trend_of(answers, LIMITS)
    sheet = trend_sheet(found, courses)
    marked = next(d for d in sheet.sections[0].figures[0].data if d.get("name") == "log with an alarm")
    assert marked["text"] == ["run05.mcap"] and marked["x"][0][:10] == (answers[5].started_at or "")[:10]
    html = render_sheet(sheet)
    assert "<script>alert" not in html and html.count('class="plot"') == 4
    undated = life(7, dated=False)
    assert render_sheet(trend_sheet(*trend_of(undated, LIMITS)))
