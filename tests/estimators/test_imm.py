"""The bank: filterpy's IMM to rounding, Bayes' rule where it is exact, and its transitions."""

from __future__ import annotations

import copy

import filterpy.kalman
import numpy as np
import pytest
import scipy.linalg
import scipy.special
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import IMM, SVSF, ExtendedKalmanFilter, transition_matrix
from estimators.modes import mixing_weights, update_modes

problem = {
    "seed": st.integers(0, 2**32 - 1), "r": st.integers(2, 4), "n": st.integers(1, 4), "m": st.integers(1, 3),
}  # fmt: skip
# Attributes that mean the same in filterpy after an update.
SHARED = ("x", "P", "x_post", "P_post", "mu", "cbar", "omega")


def covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    A = rng.normal(size=(size, size))
    return A @ A.T / size + 0.3 * np.eye(size)


def chain(rng: np.random.Generator, r: int) -> np.ndarray:
    """Transition probabilities without a pattern."""
    M = rng.random((r, r)) + r * np.eye(r)
    return M / M.sum(axis=1, keepdims=True)


def models(rng: np.random.Generator, r: int, n: int, m: int) -> dict[str, np.ndarray]:
    """Random stable linear modes with one input."""
    F = rng.normal(size=(r, n, n))
    F /= 1.1 * np.abs(np.linalg.eigvals(F)).max(axis=1)[:, None, None]
    return {
        "F": F,
        "B": rng.normal(size=(r, n, 1)),
        "H": rng.normal(size=(r, m, n)),
        "Q": np.stack([covariance(rng, n) for _ in range(r)]),
        "R": np.stack([covariance(rng, m) for _ in range(r)]),
    }


def bank_of(kind, mode: dict[str, np.ndarray], seed: int = 0, **options) -> list:
    """A filter of ``kind`` for each mode, all with different states at the start."""
    rng = np.random.default_rng(seed)
    r, m, n = mode["H"].shape
    filters = []
    for j in range(r):
        f = kind(n, m, dim_u=1, **options)
        f.x, f.P = rng.normal(size=(n, 1)), covariance(rng, n)
        for name, value in mode.items():
            setattr(f, name, value[j].copy())
        filters.append(f)
    return filters


def close(one, other, names=SHARED, rtol=1e-10) -> None:
    """Equal to ``rtol`` of the largest element."""
    for name in names:
        expected = getattr(other, name)
        np.testing.assert_allclose(
            getattr(one, name), expected, 0.0, rtol * np.abs(expected).max(), err_msg=name
        )


@settings(max_examples=40, deadline=None)
@given(**problem, peers=st.booleans())
def test_equals_filterpys_imm_at_every_step(seed, r, n, m, peers) -> None:
    """With our filters in ours, and with filterpy's filters in ours."""
    rng = np.random.default_rng(seed)
    mode, M, mu = models(rng, r, n, m), chain(rng, r), rng.random(r) + 0.1
    kind = filterpy.kalman.KalmanFilter if peers else ExtendedKalmanFilter
    ours = IMM(bank_of(kind, mode), mu, M)
    peer = filterpy.kalman.IMMEstimator(bank_of(filterpy.kalman.KalmanFilter, mode), mu, M)
    close(ours, peer)
    for _ in range(20):
        u = rng.normal(size=(1, 1))
        weights = peer.cbar.copy()
        ours.predict(u)
        peer.predict(u)
        close(ours, peer, ("cbar", "omega"))
        np.testing.assert_allclose(ours.mu, weights, rtol=1e-9)
        prior = sum(w * f.x for w, f in zip(weights, peer.filters, strict=True))
        np.testing.assert_allclose(ours.x_prior, prior, rtol=1e-9, atol=1e-11)
        # Moderate, as filterpy's own products of likelihoods underflow.
        z = (peer.filters[0].H @ peer.filters[0].x) + rng.normal(size=(m, 1))
        ours.update(z)
        peer.update(z)
        close(ours, peer)
        # filterpy's is never below the smallest float.
        possible = peer.likelihood > 1e-300
        np.testing.assert_allclose(ours.likelihood[possible], peer.likelihood[possible], rtol=1e-8)
        assert ours.log_likelihood == pytest.approx(np.log(weights @ peer.likelihood), abs=1e-8)


@pytest.mark.parametrize("kind", [ExtendedKalmanFilter, SVSF])
def test_a_bank_of_one_is_the_filter_itself(kind) -> None:
    rng = np.random.default_rng(2)
    options = {} if kind is ExtendedKalmanFilter else {"psi": 1.0}
    mode = models(rng, 1, 3, 2)
    alone = bank_of(kind, mode, **options)[0]
    bank = IMM(bank_of(kind, mode, **options), None, [[1.0]])
    for _ in range(100):
        u, z = rng.normal(size=1), np.where(rng.random(2) < 0.2, np.nan, rng.normal(size=2))
        for f in (alone, bank):
            f.predict(u)
            f.update(z)
        for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "log_likelihood"):
            np.testing.assert_array_equal(getattr(bank, name), getattr(alone, name), err_msg=name)
    assert bank.mu.tolist() == [1.0]
    assert bank.mode == 0


def test_without_transitions_it_is_bayes_rule_over_whole_logs() -> None:
    """Static modes never mix, so mode probabilities and the log-likelihood of the log are exact."""
    rng = np.random.default_rng(6)
    mode, mu = models(rng, 3, 2, 2), np.array([0.2, 0.5, 0.3])
    bank, alone = IMM(bank_of(ExtendedKalmanFilter, mode), mu, np.eye(3)), bank_of(ExtendedKalmanFilter, mode)
    evidence, total = np.zeros(3), 0.0
    for _ in range(40):
        z = rng.normal(size=2)
        bank.predict()
        bank.update(z)
        total += bank.log_likelihood
        for j, f in enumerate(alone):
            f.predict()
            f.update(z)
            evidence[j] += f.log_likelihood
    assert total == pytest.approx(np.logaddexp.reduce(np.log(mu) + evidence), rel=1e-12)
    np.testing.assert_allclose(bank.mu, scipy.special.softmax(np.log(mu) + evidence), rtol=1e-9)


def test_gaps_move_the_modes_on_and_leave_the_filters_alone() -> None:
    rng = np.random.default_rng(9)
    M = transition_matrix([2.0, 1.0], 0.01)
    for gap in (None, [np.nan, np.nan]):
        for kind in (ExtendedKalmanFilter, filterpy.kalman.KalmanFilter):
            bank = IMM(bank_of(kind, models(rng, 2, 2, 2)), [0.9, 0.1], M)
            bank.predict()
            bank.update(rng.normal(size=(2, 1)))
            before = bank.mu
            bank.predict()
            states = [f.x.copy() for f in bank.filters]
            bank.update(gap)
            np.testing.assert_allclose(bank.mu, before @ M, rtol=1e-12)
            for f, x in zip(bank.filters, states, strict=True):
                np.testing.assert_array_equal(f.x, x)
            assert bank.log_likelihood == pytest.approx(0.0, abs=1e-15)
            for _ in range(1000):
                bank.predict()
            np.testing.assert_allclose(bank.mu, [2.0 / 3.0, 1.0 / 3.0], rtol=1e-6)


def test_uneven_steps_reach_model_and_transitions() -> None:
    """A step of 0.3 s is three of 0.1 s, for the modes and for the states, when nothing is measured."""

    def drifting(rate):
        f = ExtendedKalmanFilter(1, 1, f=lambda x, u, dt: x + rate * dt, F_jacobian=lambda x, u, dt: [[1.0]])
        f.x, f.H, f.Q = np.zeros(1), [[1.0]], 0.0
        return f

    def bank():
        return IMM([drifting(1.0), drifting(1.0)], [1.0, 0.0], lambda dt: transition_matrix([1.0, 2.0], dt))

    one, three = bank(), bank()
    one.predict(dt=0.3)
    for _ in range(3):
        three.predict(dt=0.1)
    np.testing.assert_allclose(one.mu, three.mu, rtol=1e-12)
    np.testing.assert_allclose([one.x, three.x], 0.3, rtol=1e-12)
    with pytest.raises(ValueError, match="give dt"):
        one.predict()


def test_a_refused_call_changes_nothing() -> None:
    """The second filter refuses after the first has moved."""
    calm = ExtendedKalmanFilter(1, 1, f=lambda x, u, dt: x + 1.0, h=lambda x: x)
    touchy = ExtendedKalmanFilter(
        1, 1, f=lambda x, u, dt: x / (u - 1.0) if u != 1.0 else x * np.nan,
        h=lambda x: x, H_jacobian=lambda x: [[np.nan if x[0] > 3.0 else 1.0]],
    )  # fmt: skip
    bank = IMM([calm, touchy], None, transition_matrix([1.0, 1.0], 0.1))
    calm.x = touchy.x = np.array([5.0])
    before = copy.deepcopy(bank)
    for call in (lambda: bank.predict(1.0), lambda: bank.update(2.0)):
        with pytest.raises(ValueError, match=r"^filter 1: ") as error:
            call()
        assert "\n" not in str(error.value)
    for z in ([1.0, 2.0], np.inf):
        with pytest.raises(ValueError):
            bank.update(z)
    for one, other in ((bank, before), *zip(bank.filters, before.filters, strict=True)):
        close(one, other, ("x", "P", "x_prior", "x_post"), rtol=0.0)
    np.testing.assert_array_equal(bank.mu, before.mu)


M2 = np.array([[0.9, 0.1], [0.2, 0.8]])


@pytest.mark.parametrize(
    ("mu", "M", "message"),
    [
        ([1.0], M2, "mu has 1 values for 2"),
        ([0.0, 0.0], M2, "not all of them 0"),
        (None, M2.T, "each row sums to 1"),
        (None, [[np.nan, 1.0], [0.0, 1.0]], "each row sums to 1"),
    ],
)
def test_what_is_no_probability_is_refused(mu, M, message) -> None:
    with pytest.raises(ValueError, match=message):
        IMM([ExtendedKalmanFilter(1, 1), ExtendedKalmanFilter(1, 1)], mu, M)


def test_filters_that_do_not_go_together_are_refused() -> None:
    one, two = ExtendedKalmanFilter(1, 1), ExtendedKalmanFilter(2, 1)
    for filters, message in (([one, two], "filter 1 has 2 states"), ([one, one], "stands in the bank twice")):
        with pytest.raises(ValueError, match=message):
            IMM(filters, None, M2)
    with pytest.raises(ValueError, match="cannot drop channels"):
        IMM([filterpy.kalman.KalmanFilter(1, 2)], None, [[1.0]]).update([np.nan, 1.0])


def test_mode_probabilities_survive_any_likelihood() -> None:
    """Against logarithms throughout, over steps whose likelihoods no float can hold."""
    rng = np.random.default_rng(4)
    M = transition_matrix([5.0, 50.0, 1e9], 1e-3)
    mu = np.full(3, 1.0 / 3.0)
    log_mu = np.log(mu)
    for _ in range(6000):
        log_likelihood = rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 7.0)
        mu, gained = update_modes(mixing_weights(mu, M)[0], log_likelihood)
        log_cbar = np.logaddexp.reduce(log_mu[:, None] + np.log(M), axis=0)
        expected = np.logaddexp.reduce(log_cbar + log_likelihood)
        log_mu = log_cbar + log_likelihood - expected
        assert gained == pytest.approx(expected, rel=1e-11, abs=1e-9)
        assert abs(mu.sum() - 1.0) < 1e-12
        assert (mu > 0.0).all()
    np.testing.assert_allclose(mu, np.exp(log_mu), rtol=1e-8, atol=1e-290)


def test_ruled_out_modes_stay_out_and_an_impossible_measurement_decides_nothing() -> None:
    for cbar, log_likelihood, expected, total in (
        ([0.5, 0.5], [-np.inf, 1.0], [0.0, 1.0], np.log(0.5) + 1.0),
        ([0.0, 1.0], [1e9, 0.0], [0.0, 1.0], 0.0),
        ([0.3, 0.7], [-np.inf, -np.inf], [0.3, 0.7], -np.inf),
    ):
        mu, gained = update_modes(np.array(cbar), np.array(log_likelihood))
        np.testing.assert_allclose(mu, expected, atol=1e-299)
        assert gained == pytest.approx(total)


@settings(max_examples=60, deadline=None)
@given(seed=problem["seed"], r=st.integers(1, 5), dt=st.floats(0.0, 30.0), more=st.floats(0.0, 30.0))
def test_transitions_are_those_of_a_chain_in_continuous_time(seed, r, dt, more) -> None:
    rng = np.random.default_rng(seed)
    sojourn, share = 10.0 ** rng.uniform(-2.0, 4.0, r), rng.random((r, r))
    M = transition_matrix(sojourn, dt, share)
    rates = share * (1.0 - np.eye(r))
    rates = rates / np.maximum(rates.sum(axis=1, keepdims=True), 1e-300) / sojourn[:, None]
    rates -= np.diag(rates.sum(axis=1))
    np.testing.assert_allclose(M, scipy.linalg.expm(rates * dt), rtol=1e-7, atol=1e-9)
    in_two = M @ transition_matrix(sojourn, more, share)
    np.testing.assert_allclose(in_two, transition_matrix(sojourn, dt + more, share), rtol=1e-7, atol=1e-10)
    assert (M >= 0.0).all()
    np.testing.assert_allclose(M.sum(axis=1), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    "arguments", [([0.0], 1.0), ([], 1.0), ([1.0], -1.0), ([1.0, 1.0], 1.0, [[0.0, -1.0], [1.0, 0.0]])]
)
def test_transition_times_that_mean_nothing_are_refused(arguments) -> None:
    with pytest.raises(ValueError, match="give"):
        transition_matrix(*arguments)
