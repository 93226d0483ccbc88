"""The tracker's covariance step and updates: against dense algebra, extended precision and an exact layer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.corrections import PAIRS, compare_sensors
from estimators.eha.update import COUPLED, layers_exceeded, selected_update
from estimators.kernels import svsf_gain
from estimators.linalg import project

N = eha.STATES
# States measured by each channel, added and subtracted: position, angle, both pressures, their difference.
PLUS = np.array([eha.X, eha.TH, eha.P1, eha.P2, eha.P1])
MINUS = np.array([-1, -1, -1, -1, eha.P2])
M = PLUS.size


def outputs() -> np.ndarray:
    """The same as a matrix."""
    H = np.zeros((M, N))
    H[np.arange(M), PLUS] = 1.0
    H[4, eha.P2] = -1.0
    return H


def covariance(rng: np.random.Generator, decades: float = 3.0) -> np.ndarray:
    """Of two blocks, with the states' scales apart by up to twice `decades`."""
    P = np.zeros((N, N))
    for block in (slice(0, COUPLED), slice(COUPLED, N)):
        size = len(range(N)[block])
        root = rng.standard_normal((size, size)) * 10.0 ** rng.uniform(-decades, decades, (size, 1))
        P[block, block] = root @ root.T
    return 0.5 * (P + P.T)


@pytest.mark.parametrize("channel", range(M))
@pytest.mark.parametrize("decades", range(2, 31, 4))
def test_what_a_precise_channel_leaves_is_right_to_its_last_digits(channel: int, decades: int) -> None:
    """Noise far below the rounding of the prior: the variance left is its own, which P - k s k' loses."""
    P, h = covariance(np.random.default_rng(channel), 0.5), outputs()[channel]
    prior = float(h @ P @ h)
    r = prior * 10.0**-decades
    selected_update(P, PLUS[channel], MINUS[channel], r, np.empty(N))
    left = r * prior / (prior + r)
    # Both pressures keep their variance: it is their difference that has to be this small.
    within = 0.0 if MINUS[channel] < 0 else 4e-16 * P[eha.P1, eha.P1]
    assert h @ P @ h == pytest.approx(left, rel=1e-12, abs=within)
    np.testing.assert_array_equal(P, P.T)
    spread = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(spread, spread)).min() > -1e-14, "as correlations"


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=M, max_size=M), st.floats(0.5, 20.0))
def test_layers_are_those_of_the_svsf(seed: int, used: list[bool], layer: float) -> None:
    """Also with a difference beside both pressures, where H P H' is singular."""
    rng, mask = np.random.default_rng(seed), np.array(used)
    P, y, r = covariance(rng, 0.5), rng.standard_normal(M), 10.0 ** rng.uniform(-2.0, 0.0, M)
    e_post, psi_k = rng.standard_normal(M), np.empty(M)
    used_H, R = outputs()[mask], np.diag(r[mask])
    count = len(used_H)
    psi = layer * np.sqrt(np.einsum("ci,ij,cj->c", used_H, P, used_H) + r[mask])
    exceeded = layers_exceeded(P, y, PLUS, MINUS, r, mask, e_post, 0.1, layer, psi_k, np.empty((2 * M, M)))
    PHt, HPHt, expected = np.empty((N, count)), np.empty((count, count)), np.empty(count)
    project(P, used_H, PHt, HPHt)
    switched = svsf_gain(
        PHt, HPHt, R, y[mask], e_post[mask], 0.1, psi, True, np.empty((N, count)), expected,
        np.empty(count, np.bool_),
    )  # fmt: skip
    np.testing.assert_allclose(psi_k[mask], expected, rtol=1e-6)
    assert np.isnan(psi_k[~mask]).all()
    assert exceeded == (psi_k[mask] > psi).any()
    if np.abs(psi_k[mask] / psi - 1.0).min(initial=1.0) > 1e-5:
        assert exceeded == switched


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
