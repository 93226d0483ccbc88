"""Zero of the pressure difference sensor against the chambers' own."""

from __future__ import annotations

import numpy as np
import pytest
from consistent_axis import VISCOUS, model, quiet_noise, simulate, typical_state
from hypothesis import given
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.noise import Noise
from estimators.eha.redundancy import PAIRS, compare_sensors
from estimators.eha.tracker import EhaTracker

PRIOR = 4e-4  # MPa²: 20 kPa
VARIANCE = 2.0 * 0.003**2 + 0.007**2


def compared(gaps: np.ndarray) -> tuple[eha.Array, eha.Array]:
    """State and covariance after these differences, MPa."""
    x, P, memory = np.zeros(eha.STATES), np.full((eha.STATES, eha.STATES), 0.5), np.zeros(1, layout.MEMORY)[0]
    P[eha.ZERO, :] = P[:, eha.ZERO] = 0.0
    P[eha.ZERO, eha.ZERO] = PRIOR
    for gap in gaps:
        compare_sensors(x, P, float(gap), VARIANCE, memory)
    return x, P


@given(st.integers(0, 2**32 - 1), st.floats(-0.05, 0.05), st.integers(1, 40))
def test_the_zero_is_the_weighted_mean_of_prior_and_data(seed: int, zero: float, updates: int) -> None:
    """Of n white differences: precision 1/P₀ + n/r, mean their sum over r by that (Bayes, in closed form)."""
    n = updates * PAIRS
    gaps = zero + np.sqrt(VARIANCE) * np.random.default_rng(seed).standard_normal(n)
    x, P = compared(gaps)
    precision = 1.0 / PRIOR + n / VARIANCE
    assert P[eha.ZERO, eha.ZERO] == pytest.approx(1.0 / precision, rel=1e-9)
    assert x[eha.ZERO] == pytest.approx(gaps.sum() / VARIANCE / precision, rel=1e-9, abs=1e-12)


def test_an_outlier_moves_it_by_no_more_than_its_share() -> None:
    """A short circuit of 3 MPa for 20 samples, after half a second of good data."""
    rng = np.random.default_rng(4)
    good = 0.01 + np.sqrt(VARIANCE) * rng.standard_normal(25 * PAIRS)
    before, P_before = compared(good)
    after, P_after = compared(np.concatenate([good, np.full(PAIRS, 3.0)]))
    # Huber at five standard deviations of the innovation: 5 √s K, with s = P + r, K = P/s.
    prior, noise = P_before[eha.ZERO, eha.ZERO], VARIANCE / PAIRS
    most = 5.0 * prior / np.sqrt(prior + noise)
    assert 0.0 < after[eha.ZERO] - before[eha.ZERO] <= most * (1.0 + 1e-9)
    assert 0.99 * prior < P_after[eha.ZERO, eha.ZERO] <= prior


@pytest.mark.parametrize("method", ["ekf", "svsf"])
def test_a_bias_of_the_difference_is_followed_and_touches_nothing_else(method: str) -> None:
    """In the tracker: the sensor jumps by 40 kPa at 4 s; chambers, leakage and air stay to the bit."""
    noise, rng = quiet_noise(), np.random.default_rng(6)
    block, truth = simulate(typical_state(LOAD=1000.0), noise, 8.0, rng)
    block[:, layout.DIFFERENCE] = 1e6 * (truth[:, eha.P1] - truth[:, eha.P2]) + 7e3 * rng.standard_normal(
        8000
    )
    biased = block.copy()
    biased[4000:, layout.DIFFERENCE] += 40e3
    records = {}
    for name, rows in (("sound", block), ("biased", biased)):
        filter_ = EhaTracker(model(), noise, method, viscous_friction=VISCOUS)  # type: ignore[arg-type]
        records[name] = filter_.push(rows)
    found = records["biased"]["state"][:, eha.ZERO] * 1e6
    spread = np.sqrt(records["biased"]["variance"][:, eha.ZERO]) * 1e6
    assert np.abs(found[350:399]).max() < 4.0 * spread[390]
    # A walk of 300 Pa/√s would take long; what it follows in four seconds is what its variance allows.
    for of_zero in (r[name][:, eha.ZERO] for r in records.values() for name in ("state", "variance")):
        of_zero[:] = 0.0
    for name in layout.RECORD.names or ():
        np.testing.assert_array_equal(records["biased"][name], records["sound"][name], name)
    gain = Noise().zero / np.sqrt((7e3**2 + 2.0 * noise.pressure**2) * 1e-3)  # per second, stationary
    assert found[-1] == pytest.approx(40e3 * -np.expm1(-4.0 * gain), rel=0.15)
