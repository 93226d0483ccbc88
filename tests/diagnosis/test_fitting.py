"""Pieces of the fit beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import log_ndtr

from fdd.diagnosis.fitting import log_normal


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
