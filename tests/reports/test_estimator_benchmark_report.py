"""What ``python -m reports estimators`` says: verdicts follow the figures; a tiny run makes a report."""

import numpy as np
import pandas as pd
import pytest

from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES
from reports.estimators.report import accuracy, coverage, draw_pictures, goals, report_text
from reports.estimators.runs import CHECKS, GRID, Measured, Plan, measure, measure_speed

NAME = "steps, none, all"
TRUTH = np.array([6e-12, 2e8, 150.0, 60.0])


def many(error=1.0, nees=4.0, halves=np.linspace(0.1, 2.1, 21)) -> Measured:
    """Runs with errors of `error` times a bound of 2 % (4 N·s/m)."""
    rng, runs = np.random.default_rng(1), 200
    at = pd.MultiIndex.from_product([range(runs), METHODS, QUANTITIES, range(CHECKS)])
    errors = at.to_frame(index=False, name=["run", "method", "quantity", "check"])
    errors["truth"] = errors["quantity"].map(dict(zip(QUANTITIES, TRUTH, strict=True)))
    errors["bound"] = np.where(errors["quantity"] == QUANTITIES[3], 4.0, 0.02 * errors["truth"])
    errors["error"] = error * errors["bound"] * rng.standard_normal(len(errors))
    consistency = pd.DataFrame([
        {"run": run, "method": m, "nees": nees, **dict.fromkeys(QUANTITIES, 0.0)}
        for run in range(runs) for m in METHODS
    ])  # fmt: skip
    steps = pd.DataFrame([
        {"run": run, "method": m, "half": t, "response": np.zeros(GRID.size), "case": "leakage"}
        for run, t in enumerate(halves) for m in METHODS
    ])  # fmt: skip
    return {
        "errors": errors.assign(std=errors["bound"], flag=True, world="plant", case=NAME),
        "consistency": consistency.assign(world="plant", case=NAME),
        "steps": steps.assign(world="plant"),
    }


def test_figures_are_those_of_the_draw():
    found = many(error=1.3)
    each = accuracy(found["errors"]).loc["plant", NAME]
    a = each.loc["leakage", "ekf"]
    assert a["counted"] and a["flagged"] == 1.0
    assert a["rmse"] / a["bound"] == pytest.approx(1.3, rel=0.1) and a["bound"] == pytest.approx(2.0)
    assert a["rmse"] == pytest.approx(np.hypot(a["bias"], a["spread"]))
    assert each.loc["viscous_friction", "svsf"]["bound"] == pytest.approx(4.0)  # N·s/m, not percent
    c = coverage(found["consistency"]).loc["plant", NAME, "ekf"]
    assert (c["nees"], c["lost"]) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("settings", "short"),
    [
        ({}, None),
        ({"error": 1.8}, "bound"),
        ({"nees": 12.0}, "NEES"),
        ({"nees": np.nan}, "NEES"),
        ({"halves": (0.5, 2.5)}, "change"),
    ],
)
def test_a_goal_is_short_where_its_figure_is(settings, short):
    for goal in goals(many(**settings), "plant"):
        assert goal.total > 0
        missed = short is not None and short in goal.name
        assert (goal.met < goal.total) == missed, goal.name
        assert bool(goal.short) == missed
    if short == "change":
        assert goal.short == ("leakage, EKF: 2.50 s", "leakage, SVSF: 2.50 s")


@pytest.mark.slow
def test_a_tiny_run_makes_the_whole_report(tmp_path):
    plan = Plan(runs=2, peers=0, duration=3.0, cases=(NAME,), stepped=("leakage",))
    told: list[float] = []
    found = measure(plan, 1, told.append)
    assert told[-1] == 1.0 and told == sorted(told)
    text = report_text(plan, found)
    for part in ("## Goals", "## Matched world", "## Plant world", "## A sudden change"):
        assert part in text
    assert text.count(f"| {NAME} |") == 4 and "## Speed" not in text
    draw_pictures(found, tmp_path)
    assert {p.name: p.read_bytes()[:4] for p in tmp_path.iterdir()} == dict.fromkeys(
        ("coverage.png", "steps.png"), b"\x89PNG"
    )
    again = measure(Plan(runs=2, peers=0, duration=3.0, cases=(NAME,), stepped=()))
    pd.testing.assert_frame_equal(again["errors"], found["errors"])


@pytest.mark.slow
def test_speed_is_measured_and_told_with_its_verdicts():
    timed = measure_speed(2.0, repeats=1, peer_samples=200)
    assert timed.loc["filterpy EKF", "median"] > 10.0 * timed.loc["EKF", "median"]
    timed["median"] = [1.5, 2.5, 60.0]
    lines = report_text(Plan(), {"speed": timed}).splitlines()
    for said in (
        "- EKF within 2 µs a sample: **met**, 1.50 µs", "- SVSF within 2 µs a sample: **short**, 2.50 µs",
        "- 25 times filterpy's speed: **met**, 40.00 times",
    ):  # fmt: skip
        assert said in lines
