"""What healthy logs say of how a balance errs."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_evidence import EFFECTS
from numpy.typing import NDArray

from fdd.diagnosis.baseline import structural_variance

NOISE, ROWS, HOPS = 0.3, 50, 200


def sums(seed: int, common: float) -> tuple[NDArray[np.float64], ...]:
    """Hops as a ledger gives them: white noise, and an error that a hop's rows have in common.

    Parameters
    ----------
    common : std of each column's part of that error, over the rows' noise: of orthonormal columns.
    """
    rng = np.random.default_rng(seed)
    information, vector, variance = np.empty((HOPS, 3, 3)), np.empty((HOPS, 3)), np.empty(HOPS)
    for h in range(HOPS):
        x, _ = np.linalg.qr(rng.normal(size=(ROWS, 3)))
        x *= rng.uniform(1.0, 20.0)
        own = x / np.linalg.norm(x, axis=0) @ (NOISE * common * rng.normal(size=3))
        y = x @ EFFECTS.mean + NOISE * rng.normal(size=ROWS) + own
        rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        variance[h] = rest @ rest / (ROWS - 3)
        information[h], vector[h] = x.T @ x / variance[h], x.T @ y / variance[h]
    return information, vector, np.full(HOPS, float(ROWS)), variance


@pytest.mark.parametrize("common", [0.0, 3.0, 10.0])
def test_a_row_errs_by_what_its_hop_has_in_common(common: float) -> None:
    """A hop's own fit follows what its rows have in common, so its residual knows nothing of it."""
    logs = [sums(seed, common) for seed in range(3)]
    plain = float(np.mean(logs[0][3]))
    assert plain == pytest.approx(NOISE**2, rel=0.1)
    # The median of a mean of three squares is 0.79 of its mean (chi square of three degrees of freedom).
    right = 0.789 * NOISE**2 * (1.0 + common**2)
    assert structural_variance(logs, EFFECTS, plain) == pytest.approx(right, rel=0.12)
