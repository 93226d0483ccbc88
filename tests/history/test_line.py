"""The line's statistics against closed forms, textbook values and counted coverage."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.history.line import fit_line, holm

TIME = np.linspace(-1.0, 0.0, 12)
DESIGN = np.column_stack([np.ones(12), TIME])


def test_scatter_between_logs_is_the_closed_form_where_all_logs_know_as_much() -> None:
    values = 1.0 + 0.5 * TIME + np.random.default_rng(1).normal(0.0, 0.1, 12)
    rest = values - DESIGN @ np.linalg.lstsq(DESIGN, values, rcond=None)[0]
    residual = float(rest @ rest) / 10.0
    std = 0.6 * np.sqrt(residual)
    line = fit_line(values, np.full(12, std), DESIGN)
    assert line.between == pytest.approx(np.sqrt(residual - std**2), rel=1e-3)
    assert fit_line(values, np.full(12, 3.0 * np.sqrt(residual)), DESIGN).between == 0.0


@pytest.mark.parametrize("std", [1e-3, 0.05, 1.0])
def test_equal_logs_give_ordinary_least_squares_and_its_t_interval(std: float) -> None:
    from scipy.stats import linregress, t

    values = 1.0 + 0.5 * TIME + np.random.default_rng(2).normal(0.0, 0.1, 12)
    plain = linregress(TIME, values)
    line = fit_line(values, np.full(12, std), DESIGN)
    low, high = line.interval(1)
    half = t.ppf(0.975, 10) * plain.stderr
    assert (low, high) == pytest.approx((plain.slope - half, plain.slope + half), rel=1e-6)
    assert line.p_value(1) == pytest.approx(plain.pvalue, rel=1e-6)


def test_a_log_that_hardly_knows_counts_little() -> None:
    values, stds = 1.0 + 0.5 * TIME + 0.01 * np.cos(9.0 * TIME), np.full(12, 0.01)
    wrong = values.copy()
    wrong[5] += 1.0
    stds[5] = 10.0
    good, spoilt = (fit_line(v, stds, DESIGN).coefficients for v in (values, wrong))
    assert np.abs(good - spoilt).max() < 1e-3


@pytest.mark.parametrize(
    ("tau", "stds", "overstated"), [(0.05, 0.02, 1.0), (0.0, 0.02, 5.0), (0.1, 0.02, 1.0)]
)
def test_intervals_hold_the_truth_as_often_as_they_say(tau: float, stds: float, overstated: float) -> None:
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
def test_few_logs_that_know_unequally_much_show_no_slope_but_one_in_twenty(n: int) -> None:
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


def test_a_slope_that_is_not_told_comes_to_no_level() -> None:
    values = 1.0 + np.random.default_rng(4).normal(0.0, 0.1, 12)
    assert fit_line(values, np.full(12, 0.1), DESIGN).crossing(5.0) is None


def test_holms_rule_on_a_worked_example() -> None:
    """Five p values and what R's p.adjust(method="holm") makes of them."""
    assert holm([0.01, 0.02, 0.03, 0.04, 0.05]) == pytest.approx([0.05, 0.08, 0.09, 0.09, 0.09])
    assert holm([0.6, 0.001]) == pytest.approx([0.6, 0.002]) and holm([]) == []
