"""Probabilities of modes that no likelihood breaks, a bank that is honest on its own model; transitions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from test_imm import problem

import estimators
from estimators import IMM, ExtendedKalmanFilter, nees_band, transition_matrix
from estimators.modes import mixing_weights, update_modes


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


def bank_of_scalars(M: np.ndarray, modes: list[dict[str, float]]) -> IMM:
    """A bank of scalar modes from their F, Q, H, R and P, with a bias of what is measured."""
    filters = []
    for mode in modes:
        f = ExtendedKalmanFilter(1, 1, h=lambda x, bias=mode.get("bias", 0.0): x + bias)
        f.x, f.H_jacobian = np.zeros(1), lambda x: [[1.0]]
        f.F, f.Q, f.R, f.P = [[mode["F"]]], mode["Q"], mode["R"], mode["P"]
        filters.append(f)
    return IMM(filters, None, M)


def test_a_mode_without_transitions_comes_back_when_the_data_say_so() -> None:
    """M = 1: the first 500 samples rule out mode 1 by more than a float can say, the next 2000 mode 0."""
    still = {"F": 0.0, "Q": 1.0, "R": 1.0, "P": 1.0}
    bank, mu = bank_of_scalars(np.eye(2), [still, still | {"bias": 5.0}]), []
    for z in np.r_[np.full(500, 0.0), np.full(2000, 5.0)]:
        bank.predict()
        bank.update(z)
        mu.append(bank.mu)
    assert mu[499][1] < 1e-200
    assert mu[-1][1] > 1.0 - 1e-12
    np.testing.assert_allclose(np.sum(mu, axis=1), 1.0, rtol=1e-14)


@pytest.mark.slow
def test_probabilities_and_covariances_are_honest_on_the_model_itself() -> None:
    """The ends of 4000 logs drawn from the model: where it says mode 1 with 70 to 80 %, so it is."""
    rng, logs, steps = np.random.default_rng(8), 4000, 60
    M = transition_matrix([1.0, 1.0], 0.02)
    calm = {"F": 0.95, "Q": 0.05, "R": 0.3, "P": 1.0}
    mode, x, z = rng.integers(0, 2, logs), rng.normal(size=logs), np.empty((steps, logs))
    for i in range(steps):
        mode = np.where(rng.random(logs) < M[0, 1], 1 - mode, mode)
        x = 0.95 * x + np.sqrt(np.where(mode == 0, 0.05, 0.6)) * rng.normal(size=logs)
        z[i] = x + np.sqrt(0.3) * rng.normal(size=logs)
    runs = [bank_of_scalars(M, [calm, calm | {"Q": 0.6}]) for _ in range(logs)]
    for run, log in zip(runs, z.T, strict=True):
        for measured in log:
            run.predict()
            run.update(measured)
    said = np.array([run.mu[1] for run in runs])
    for low in np.arange(0.0, 1.0, 0.1):
        inside = (said >= low) & (said < low + 0.1)
        p = said[inside].mean()
        assert inside.sum() > 100
        assert abs(mode[inside].mean() - p) < 3.3 * np.sqrt(p * (1.0 - p) / inside.sum()), low
    low, high = nees_band(1, logs, probability=0.999)
    nees = [(run.x[0] - truth) ** 2 / run.P[0, 0] for run, truth in zip(runs, x, strict=True)]
    assert low < np.mean(nees) < high


@pytest.mark.slow
def test_the_likelihood_of_logs_finds_the_sojourn_time() -> None:
    rng, M = np.random.default_rng(12), transition_matrix([1.0, 1.0], 0.02)
    mode = np.cumsum(rng.random(20_000) < M[0, 1]) % 2
    z = np.where(mode == 0, -0.5, 0.5) + rng.normal(size=mode.size)
    total = dict.fromkeys((0.1, 0.3, 1.0, 3.0, 10.0), 0.0)
    known = {"F": 0.0, "Q": 0.0, "R": 1.0, "P": 1.0}
    for tau in total:
        bank = bank_of_scalars(
            transition_matrix([tau, tau], 0.02), [known | {"bias": -0.5}, known | {"bias": 0.5}]
        )
        for measured in z:
            bank.predict()
            bank.update(measured)
            total[tau] += bank.log_likelihood
    assert max(total, key=total.__getitem__) == 1.0
    assert min(total[1.0] - total[tau] for tau in total if tau != 1.0) > 10.0


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


def test_the_guides_bank_does_what_the_guide_says() -> None:
    guide = Path(estimators.__file__).with_name("README.md").read_text(encoding="utf-8")
    shown: dict = {}
    exec(compile(re.findall(r"```python\n(.*?)```", guide, flags=re.DOTALL)[-1], "README.md", "exec"), shown)
    cracked = np.array(shown["mu"])[:, 1] > 0.99
    assert np.flatnonzero(cracked)[0] == 1008
    assert cracked[1008:].all()
    assert shown["bank"].mode == 1
