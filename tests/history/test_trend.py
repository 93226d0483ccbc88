"""Lives of known course: what is told of them, how often; the line's statistics against closed forms."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest
from scipy.stats import linregress
from scipy.stats import t as student_t

from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Quality
from fdd.history import Life, Trend
from fdd.history.compare import seen
from fdd.history.line import fit_line, holm
from fdd.history.trend import given_limits, severity_one, trend_of
from fdd.history.view import trend_sheet
from fdd.report.page import render_sheet
from fdd.unit import Unit
from tests.refusal import refused

HEALTHY = {"leakage": 6.5e-12, "bulk_modulus": 2.1e8, "coulomb_friction": 130.0, "viscous_friction": 60.0}
SI = {"leakage": "m^3/(s*Pa)", "bulk_modulus": "Pa", "coulomb_friction": "N", "viscous_friction": "N*s/m"}
DAYS = 330.0


def made_up_answer(
    name: str, day: float | None, factors: dict[str, float], stds: dict[str, float], warm: float
) -> Diagnosis:
    """An answer whose healthy leakage is exp(`warm`) times that at the reference temperature; `factors` and
    `stds` are of the healthy value at the log's own temperature."""
    estimates = {}
    for n, usual in HEALTHY.items():
        base = usual * float(np.exp(warm)) if n == "leakage" else usual
        known = {"value": factors[n] * base, "std": stds[n] * base, "observable": True}
        estimates[n] = Estimate(unit=SI[n], baseline=base, **known)
    began = None if day is None else datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=day)
    return Diagnosis(
        log=name, axis="axis_a", unit="axis_a", duration_s=60.0, samples=60_000, verdict="healthy", faults=[],
        probabilities={"healthy": 1.0}, estimates=estimates, quality=Quality(),
        started_at=None if began is None else began.isoformat().replace("+00:00", "Z"),
    )  # fmt: skip


def life(
    seed: int, growth: float = 0.0, logs: int = 12, *, dated: bool = True,
    leaks_by: Callable[[float], float] = lambda warm: 1.0,
) -> list[Diagnosis]:  # fmt: skip
    """A life in which leakage grows by `growth` of the healthy one, straight, over `DAYS`.

    Every log errs by its own standard deviation, and by 2 % (friction 5 %) from log to log. `leaks_by` is how
    the leakage differs from the viscosity law, a factor by the log's warmth.
    """
    rng = np.random.default_rng(seed)
    days = np.sort(rng.uniform(0.0, DAYS, logs))
    days[0], days[-1] = 0.0, DAYS
    out = []
    for k, day in enumerate(days):
        warm = float(rng.normal(0.0, 0.4))
        stds = {name: float(rng.uniform(0.01, 0.04)) for name in HEALTHY}
        usual = {name: 0.05 if "friction" in name else 0.02 for name in HEALTHY}
        factors = {n: 1.0 + float(rng.normal(0.0, stds[n]) + rng.normal(0.0, usual[n])) for n in HEALTHY}
        factors["leakage"] = (factors["leakage"] + growth * day / DAYS) * leaks_by(warm)
        out.append(made_up_answer(f"run{k:02d}.mcap", float(day) if dated else None, factors, stds, warm))
    return out


def alarmed(answer: Diagnosis, fault: str, family: str) -> Diagnosis:
    """The same answer with a fault in it."""
    times = {"onset_s": 3.0, "detected_s": 4.0}
    finding = FaultFinding(fault=fault, family=family, ambiguity=[fault], confidence=0.9, **times)
    return answer.model_copy(update={"verdict": "faulty", "faults": [finding]})


REPEATS = 200
LIMITS = given_limits(["leakage=2.5"])


def told(answers: list[Diagnosis]) -> Life:
    return trend_of(answers, LIMITS)[0]


def leakage(answers: list[Diagnosis]) -> Trend:
    return next(t for t in told(answers).trends if t.quantity == "leakage")


@pytest.mark.slow
def test_a_leakage_that_grows_is_told_with_its_slope_and_its_time_to_the_limit():
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


@pytest.mark.slow
def test_healthy_lives_show_no_trend_but_one_in_twenty():
    alarms = [any(t.direction for t in told(life(seed)).trends) for seed in range(REPEATS)]
    assert sum(alarms) / REPEATS < 0.05 + 0.04
    assert told(life(0)).headline.startswith("no trend that could be told")
    assert all(t.until_limit is None for t in told(life(0)).trends)


def test_where_the_viscosity_law_is_wrong_the_logs_own_regression_is_taken():
    """Oil whose leakage goes with the root of what the profile's law says: chosen by likelihood, and told."""
    own = [leakage(life(seed, leaks_by=lambda warm: float(np.exp(-0.5 * warm)))) for seed in range(40)]
    assert sum(t.temperature == "regression" for t in own) >= 38
    assert all((t.likelihood_gain or 0.0) > 0.0 for t in own)
    held = sum(t.slope_interval[0] < 0.0 < t.slope_interval[1] for t in own if t.slope_interval)
    assert held >= 35
    lawful = [leakage(life(seed)) for seed in range(40)]
    assert sum(t.temperature == "viscosity law" for t in lawful) >= 36


def test_logs_stand_by_their_dates_else_by_their_names_and_it_is_said():
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


def test_what_cannot_be_read_or_has_a_failed_sensor_does_not_count_and_faults_stand_first():
    answers = life(2, growth=1.0)
    bad = [*answers, Diagnosis.unreadable("bad.csv", "bad.csv: the file is empty", {})]
    assert told(bad).trends == told(answers).trends and told(bad).logs[-1].left_out is not None
    answers[4] = alarmed(answers[4], "internal_leakage", "leakage")
    assert len(leakage(answers).points) == 12
    answers[4] = alarmed(answers[4], "sensor_dropout", "sensor")
    assert len(leakage(answers).points) == 11
    assert "sensor" in (told(answers).logs[4].left_out or "")
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


def test_too_few_logs_or_none_of_another_time_give_no_line_and_several_units_are_refused():
    few, same = told(life(3, logs=3)), life(3)
    assert all(t.slope is None and "3 logs" in t.sentence for t in few.trends)
    for answer in same:
        answer.started_at = "2026-01-01T00:00:00Z"
    assert all(t.slope is None for t in told(same).trends)
    same[2].unit = "other"
    assert "axis_a, other" in refused(lambda: told(same))
    assert "no log" in refused(lambda: told([Diagnosis.unreadable("bad.csv", "bad.csv: empty", {})]))


def test_a_limit_that_is_passed_is_told_so_and_other_limits_come_from_the_catalogue():
    found = leakage(life(5, growth=3.0))
    assert found.until_limit == 0.0 and "past 2.5" in found.sentence
    limits = severity_one(Unit.load("axis_a"))
    assert limits["leakage"][1] == pytest.approx(1.0 + 12e-12 / 6.52e-12)
    # 1/β + 0.025 c(p), with c of thesis eq. 5.21 at 482 kPa gauge.
    p = 4.82e5 + 101325.0
    soft = 1.0 / 2.1e8 + 0.025 * (101325.0 / p) ** (1 / 1.4) / (1.4 * p)
    assert limits["bulk_modulus"][0] == pytest.approx(1.0 / soft / 2.1e8)
    for text in ("leakage", "leakage=x", "leakage=1", "leakage=-2", "leakage=nan", "speed=2"):
        assert "--limit" in refused(partial(given_limits, [text]))


def test_what_is_not_observable_at_the_end_is_taken_as_it_is_known_best():
    plain = life(6)[0].estimates["leakage"]
    assert seen(plain) == (plain.value, plain.std)
    held = {"observable": False, "value": 2.0, "std": 0.2, "held": 1.0, "held_std": 0.1}
    late = plain.model_copy(update=held)
    assert seen(late) == (1.0, 0.1)
    assert seen(late.model_copy(update={"held_std": 0.5})) == (2.0, 0.2)
    assert seen(late.model_copy(update={"held": None, "held_std": None})) is None
    assert seen(late.model_copy(update={"observable": True})) == (2.0, 0.2)


def test_the_page_marks_alarms_and_keeps_text_of_logs_text():
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


TIME = np.linspace(-1.0, 0.0, 12)
DESIGN = np.column_stack([np.ones(12), TIME])


def test_scatter_between_logs_is_the_closed_form_and_a_log_that_hardly_knows_counts_little():
    values = 1.0 + 0.5 * TIME + np.random.default_rng(1).normal(0.0, 0.1, 12)
    rest = values - DESIGN @ np.linalg.lstsq(DESIGN, values, rcond=None)[0]
    residual = float(rest @ rest) / 10.0
    std = 0.6 * np.sqrt(residual)
    line = fit_line(values, np.full(12, std), DESIGN)
    assert line.between == pytest.approx(np.sqrt(residual - std**2), rel=1e-3)
    assert fit_line(values, np.full(12, 3.0 * np.sqrt(residual)), DESIGN).between == 0.0
    values, stds = 1.0 + 0.5 * TIME + 0.01 * np.cos(9.0 * TIME), np.full(12, 0.01)
    wrong = values.copy()
    wrong[5] += 1.0
    stds[5] = 10.0
    good, spoilt = (fit_line(v, stds, DESIGN).coefficients for v in (values, wrong))
    assert np.abs(good - spoilt).max() < 1e-3
    values = 1.0 + np.random.default_rng(4).normal(0.0, 0.1, 12)
    assert fit_line(values, np.full(12, 0.1), DESIGN).crossing(5.0) is None


@pytest.mark.parametrize("std", [1e-3, 0.05, 1.0])
def test_equal_logs_give_ordinary_least_squares_and_its_t_interval(std):
    values = 1.0 + 0.5 * TIME + np.random.default_rng(2).normal(0.0, 0.1, 12)
    plain = linregress(TIME, values)
    line = fit_line(values, np.full(12, std), DESIGN)
    low, high = line.interval(1)
    half = student_t.ppf(0.975, 10) * plain.stderr
    assert (low, high) == pytest.approx((plain.slope - half, plain.slope + half), rel=1e-6)
    assert line.p_value(1) == pytest.approx(plain.pvalue, rel=1e-6)


@pytest.mark.parametrize(
    ("tau", "stds", "overstated"), [(0.05, 0.02, 1.0), (0.0, 0.02, 5.0), (0.1, 0.02, 1.0)]
)
def test_intervals_hold_the_truth_as_often_as_they_say(tau, stds, overstated):
    """Slope at 95 %, time to a level at 80 % (Fieller), whatever the scatter is made of."""
    held = crossed = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        own = stds * rng.uniform(0.5, 2.0, 12)
        values = 1.5 + TIME + rng.normal(0.0, tau, 12) + rng.normal(0.0, own)
        line = fit_line(values, overstated * own, DESIGN)
        low, high = line.interval(1)
        held += low < 1.0 < high
        found = line.crossing(2.5)
        assert found is not None
        crossed += found[1] < 1.0 < found[2]
    # Binomial, 2.6 standard deviations either side.
    assert abs(held / 300 - 0.95) < 0.033
    assert abs(crossed / 300 - 0.80) < 0.060


@pytest.mark.parametrize("n", [4, 6])
def test_few_logs_that_know_unequally_much_show_no_slope_but_one_in_twenty(n):
    """Where τ is found to be 0, the log that says it knows best bends the line."""
    design = np.column_stack([np.ones(n), np.linspace(-1.0, 0.0, n)])
    told = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        stds = 0.04 * np.exp(rng.standard_normal(n))
        values = 1.0 + rng.normal(0.0, 0.05, n) + rng.normal(0.0, stds)
        told += fit_line(values, stds, design, between=0.05).p_value(1) < 0.05
    # Binomial, 2.6 standard deviations; without the least τ it is 0.12.
    assert told / 400 < 0.05 + 0.028


def test_holms_rule_on_a_worked_example():
    """Five p values and what R's p.adjust(method="holm") makes of them."""
    assert holm([0.01, 0.02, 0.03, 0.04, 0.05]) == pytest.approx([0.05, 0.08, 0.09, 0.09, 0.09])
    assert holm([0.6, 0.001]) == pytest.approx([0.6, 0.002]) and holm([]) == []
