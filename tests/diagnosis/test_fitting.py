"""Pieces of the fit beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import log_ndtr

from fdd.diagnosis.fitting import STRETCH_FREEDOM, _better, _heard, log_normal


@pytest.mark.parametrize("z", [-1e4, -200.0, -30.01, -30.0, -29.99, -8.0, -1.0, -0.0, 0.0, 0.5, 3.0, 7.0])
def test_the_normal_distribution_function_is_scipys(z: float) -> None:
    assert log_normal(z) == pytest.approx(float(log_ndtr(z)), rel=1e-12)


def test_the_fading_filter_is_scipys() -> None:
    from scipy.signal import lfilter

    from fdd.diagnosis.baseline import effects_of
    from fdd.residuals.account import LOAD_S
    from fdd.residuals.ledger import Ledger
    from fdd.residuals.rows import ROW_S
    from fdd.unit import Unit

    unit = Unit.load("axis_a")
    account = next(a for a in Ledger(unit, effects_of(unit)).accounts.values() if a.balance.cell > 1)
    rows = np.random.default_rng(1).normal(size=(30, account.level.shape[1]))
    decay = 1.0 - account.balance.cell * ROW_S / LOAD_S
    wanted, _ = lfilter([1.0, -1.0], [1.0, -decay], rows, axis=0, zi=-rows[:1])
    found = np.concatenate([account._passed(part) for part in (rows[:10], rows[10:10], rows[10:])])
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("scatter", "better"), [(0.5, True), (20.0, False)])
def test_what_a_fault_explains_well_says_how_much_chance_there_is(scatter: float, better: bool) -> None:
    """Test: 20 stretches beside a fault of four standard deviations, of which healthy time told nothing.

    Expected: their own mean square with the prior's two, or what was known before where it says more.
    """
    w = np.ones((1, 20))
    u = np.sqrt(scatter) * np.where(np.arange(20) % 2, 1.0, -1.0)[None]
    one = np.ones(1)
    kappa, freedom = _better(one, 2.0 * one, one, u, w, 16.0 * one)
    wanted = ((2.0 + 19.0 * scatter) / 21.0, 21.0) if better else (1.0, 2.0)
    assert (kappa[0], freedom[0]) == pytest.approx(wanted)


def test_one_loud_stretch_counts_as_students_t_allows_and_many_as_they_are() -> None:
    """Test: one stretch of thirty standard deviations among quiet ones, and twenty of twenty.

    Expected: the share that leaves the log likelihood ratio of Student's t of `STRETCH_FREEDOM`; all.
    """
    w = np.full((1, 20), 1e-6)
    w[0, 0] = 900.0
    one = _heard(np.zeros((1, 20)), w, np.ones(1))
    ratio = 0.5 * (STRETCH_FREEDOM + 1.0) * np.log1p(900.0 / STRETCH_FREEDOM)
    assert one[0] ** 2 * 450.0 == pytest.approx(ratio, rel=1e-3)
    assert _heard(np.zeros((1, 20)), np.full((1, 20), 400.0), np.ones(1))[0] == pytest.approx(1.0)
