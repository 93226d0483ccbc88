"""What ``python -m reports estimators`` says: verdicts follow the figures; a tiny run makes a report."""

import numpy as np
import pytest

from reports.estimators.measure import Measured, Plan, measure
from reports.estimators.report import draw_pictures, report_lines
from reports.estimators.runs import CHECKS, GRID, Outcome, StepOutcome, StillOutcome
from reports.estimators.speed import Speed, SpeedTable
from reports.estimators.summary import accuracy, coverage, goals

NAME = "steps, none, all"


def outcome(rng, error=1.0, nees=4.0, nis=1.0, fitted=3.0, flagged=True) -> Outcome:
    """A run with errors of `error` times a bound of 2 % (4 N·s/m)."""
    truth = np.array([6e-12, 2e8, 150.0, 60.0])[:, None] * np.ones(CHECKS)
    bound = truth * 0.02
    bound[3] = 4.0
    errors = error * bound * rng.standard_normal((2, 4, CHECKS))
    return Outcome(
        truth, errors, np.tile(bound, (2, 1, 1)), np.full((2, 4, CHECKS), flagged), bound,
        fitted * bound[:2] * rng.standard_normal((2, CHECKS)), np.full(2, nees), np.zeros((2, 4)),
        np.tile([nis, 0.98, 1.02], (2, 1)),
    )  # fmt: skip


def many(**settings) -> Measured:
    rng = np.random.default_rng(1)
    steps = [StepOutcome(np.array([t, t]), np.zeros((2, GRID.size))) for t in np.linspace(0.1, 2.1, 21)]
    still = StillOutcome("standstill, none, all", 0.4 * np.ones((2, 4)), np.ones((2, 4)))
    found = Measured(Plan(runs=200, cases=(NAME,)))
    found.runs["plant", NAME] = [outcome(rng, **settings) for _ in range(200)]
    found.steps["plant", "leakage"] = steps
    found.still["plant", still.case] = [still]
    return found


def test_figures_are_those_of_the_draw():
    found = many(error=1.3)
    a = accuracy(found.runs["plant", NAME], 0, 0)
    assert a.counted and a.flagged == 1.0
    assert a.over_bound == pytest.approx(1.3, rel=0.1) and a.bound == pytest.approx(2.0)
    assert a.rmse == pytest.approx(np.hypot(a.bias, a.spread))
    assert accuracy(found.runs["plant", NAME], 1, 3).bound == pytest.approx(4.0)  # N·s/m, not percent
    c = coverage(found.runs["plant", NAME], 0)
    assert (c.nees, c.nis, c.lost) == (1.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("settings", "short"),
    [
        ({}, None),
        ({"error": 1.8}, "bound"),
        ({"error": 1.4, "fitted": 1.0}, "least squares"),
        ({"nees": 12.0}, "NEES"),
        ({"nees": np.nan}, "NEES"),
        ({"nis": 1.1}, "NIS"),
    ],
)
def test_a_goal_is_short_where_its_figure_is(settings, short):
    for goal in goals(many(**settings), "plant"):
        assert goal.total > 0
        missed = short is not None and short in goal.name
        assert (goal.met < goal.total) == missed, goal.name
        assert bool(goal.short) == missed


def test_a_slow_step_and_a_restless_hour_are_short():
    found = many()
    found.steps["plant", "leakage"] = [StepOutcome(np.array([0.5, 2.5]), np.zeros((2, GRID.size)))] * 3
    found.still["plant", "standstill, none, all"][0].moved[1, 2] = 1.2
    short = [text for goal in goals(found, "plant") for text in goal.short]
    assert short == [
        "leakage, SVSF: 2.50 s", "standstill, none, all, SVSF, coulomb friction: 1.2 standard deviations",
    ]  # fmt: skip


@pytest.mark.slow
def test_a_tiny_run_makes_the_whole_report(tmp_path):
    plan = Plan(
        runs=2, still=1, peers=0, duration=3.0, still_duration=35.0, cases=(NAME,), stepped=("leakage",)
    )
    told: list[float] = []
    found = measure(plan, 1, told.append)
    assert told[-1] == 1.0 and told == sorted(told)
    text = "\n".join(report_lines(found))
    for part in (
        "## Goals",
        "## Matched world",
        "## Plant world",
        "## A sudden change",
        "## An hour at standstill",
    ):
        assert part in text
    assert text.count(f"| {NAME} |") == 4 and "## Speed" not in text
    draw_pictures(found, tmp_path)
    assert {p.name: p.read_bytes()[:4] for p in tmp_path.iterdir()} == dict.fromkeys(
        ("bound.png", "coverage.png", "steps.png"), b"\x89PNG"
    )
    again = measure(Plan(runs=2, still=0, peers=0, duration=3.0, cases=(NAME,), stepped=()))
    np.testing.assert_array_equal(again.runs["plant", NAME][1].errors, found.runs["plant", NAME][1].errors)


def test_speed_is_told_with_its_verdicts():
    rows = (
        Speed("EKF", 1.5, 1.4, 1.0, "ours"), Speed("SVSF", 2.5, 2.4, 1.7, "ours"),
        Speed("C++ EKF", 1.0, 0.9, 0.7, ""), Speed("C++ SVSF", np.nan, np.nan, np.nan, "no compiler"),
        Speed("filterpy EKF", 60.0, 55.0, 40.0, "peer"),
    )  # fmt: skip
    lines = report_lines(Measured(Plan(), speed=SpeedTable(rows, 60_000, "g++ -O3")))
    for told in (
        "- EKF within 2 µs a sample: **met**, 1.50 µs", "- SVSF within 2 µs a sample: **short**, 2.50 µs",
        "- EKF within 2 times C++: **met**, 1.50 times", "- 25 times filterpy's speed: **met**, 40.00 times",
        "| C++ SVSF |  |  |  | no compiler |",
    ):  # fmt: skip
        assert told in lines
    assert not any("SVSF within 2 times" in line for line in lines)
