"""Whole logs through a bank of linear modes: equal to the class and honest on its own model; transitions."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from test_imm import M2, chain, covariance, models, problem

import estimators
from estimators import IMM, ExtendedKalmanFilter, nees_band, run_bank, transition_matrix
from estimators.modes import mixing_weights, update_modes


def test_mode_probabilities_survive_any_likelihood() -> None:
    """Against logarithms throughout, over steps whose likelihoods no float can hold."""
    rng = np.random.default_rng(4)
    M = transition_matrix([5.0, 50.0, 1e9], 1e-3)
    mu, cbar, omega = np.full(3, 1.0 / 3.0), np.empty(3), np.empty((3, 3))
    log_mu = np.log(mu)
    for _ in range(6000):
        log_likelihood = rng.normal(size=3) * 10.0 ** rng.uniform(-2.0, 7.0)
        mixing_weights(mu, M, cbar, omega)
        gained = update_modes(cbar, log_likelihood, mu)
        log_cbar = np.logaddexp.reduce(log_mu[:, None] + np.log(M), axis=0)
        expected = np.logaddexp.reduce(log_cbar + log_likelihood)
        log_mu = log_cbar + log_likelihood - expected
        assert gained == pytest.approx(expected, rel=1e-11, abs=1e-9)
        assert abs(mu.sum() - 1.0) < 1e-12
        assert (mu > 0.0).all()
    np.testing.assert_allclose(mu, np.exp(log_mu), rtol=1e-8, atol=1e-290)


@settings(max_examples=25)
@given(**problem, correlated=st.booleans())
def test_compiled_log_equals_the_class(seed, r, n, m, correlated) -> None:
    rng = np.random.default_rng(seed)
    mode, M, mu = models(rng, r, n, m), chain(rng, r), rng.dirichlet(np.ones(r))
    if not correlated:
        mode["R"] = np.stack([np.diag(np.diag(R)) for R in mode["R"]])
    drift, bias = rng.normal(size=(r, n)), rng.normal(size=(r, m))
    z = np.where(rng.random((30, m)) < 0.3, np.nan, 2.0 * rng.normal(size=(30, m)))
    u = rng.normal(size=(30, 1))
    filters = [ExtendedKalmanFilter(n, m) for _ in range(r)]
    for j, f in enumerate(filters):
        f.x, f.P, f.Q, f.R = rng.normal(size=n), covariance(rng, n), mode["Q"][j], mode["R"][j]
        f.f = lambda x, u, dt, j=j: mode["F"][j] @ x + mode["B"][j] @ u + drift[j]
        f.F_jacobian = lambda x, u, dt, j=j: mode["F"][j]
        f.h = lambda x, j=j: mode["H"][j] @ x + bias[j]
        f.H_jacobian = lambda x, j=j: mode["H"][j]
    x, P = np.array([f.x for f in filters]), np.array([f.P for f in filters])
    found = run_bank(z, u, **mode, M=M, mu=mu, x=x, P=P, state_offset=drift, output_offset=bias)
    bank = IMM(filters, mu, M)
    for i in range(30):
        bank.predict(u[i])
        bank.update(z[i])
        np.testing.assert_allclose(found.mu[i], bank.mu, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.x[i], bank.x, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(found.std[i] ** 2, np.diag(bank.P), rtol=1e-8)
        assert found.log_likelihood[i] == pytest.approx(bank.log_likelihood, abs=1e-9)
    np.testing.assert_allclose(found.modes[0], [f.x for f in bank.filters], rtol=1e-8, atol=1e-10)


def test_probabilities_and_covariances_are_honest_on_the_model_itself() -> None:
    """The ends of 4000 logs drawn from the model: where it says mode 1 with 70 to 80 %, so it is."""
    rng, logs, steps = np.random.default_rng(8), 4000, 60
    M = transition_matrix([1.0, 1.0], 0.02)
    model = {"F": [[0.95]], "Q": [[[0.05]], [[0.6]]], "H": [[1.0]], "R": [[0.3]], "P": [[1.0]]}
    mode, x, z = rng.integers(0, 2, logs), rng.normal(size=logs), np.empty((steps, logs))
    for i in range(steps):
        mode = np.where(rng.random(logs) < M[0, 1], 1 - mode, mode)
        x = 0.95 * x + np.sqrt(np.where(mode == 0, 0.05, 0.6)) * rng.normal(size=logs)
        z[i] = x + np.sqrt(0.3) * rng.normal(size=logs)
    runs = [run_bank(log, **model, M=M) for log in z.T]
    said = np.array([run.mu[-1, 1] for run in runs])
    for low in np.arange(0.0, 1.0, 0.1):
        inside = (said >= low) & (said < low + 0.1)
        p = said[inside].mean()
        assert inside.sum() > 100
        assert abs(mode[inside].mean() - p) < 3.3 * np.sqrt(p * (1.0 - p) / inside.sum()), low
    low, high = nees_band(1, logs, probability=0.999)
    nees = [((run.x[-1, 0] - truth) / run.std[-1, 0]) ** 2 for run, truth in zip(runs, x, strict=True)]
    assert low < np.mean(nees) < high


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
    ("changed", "message"),
    [
        ({"z": [0.0, np.inf]}, "infinite at sample 1, channel 0"),
        ({"z": np.zeros((2, 1, 1))}, "one row per sample"),
        ({"F": np.eye(2)}, "H has shape"),
        ({"Q": [[[1.0]], [[1.0]], [[1.0]]]}, r"Q has shape \(3, 1, 1\); give \(2, 1, 1\)"),
        ({"R": [[-1.0]]}, "R of mode 0 has a negative variance at 0"),
        ({"H": [[np.nan]]}, "H has values that are not finite"),
        ({"u": [1.0, 1.0]}, "u and B come together"),
        ({"u": [1.0], "B": [[1.0]]}, "u has 1 rows for 2"),
        ({"x": [[0.0]], "start": (np.zeros((2, 1)), np.ones((2, 1, 1)), np.ones(2))}, "one or the other"),
    ],
)
def test_a_log_that_does_not_fit_its_models_is_refused(changed, message) -> None:
    one = [[1.0]]
    fitting = {"z": [0.0, 1.0], "F": one, "H": one, "Q": one, "R": one, "M": M2}
    assert run_bank(**fitting).mu.shape == (2, 2)
    with pytest.raises(ValueError, match=message) as error:
        run_bank(**{**fitting, **changed})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "arguments", [([0.0], 1.0), ([], 1.0), ([1.0], -1.0), ([1.0, 1.0], 1.0, [[0.0, -1.0], [1.0, 0.0]])]
)
def test_transition_times_that_mean_nothing_are_refused(arguments) -> None:
    with pytest.raises(ValueError, match="give"):
        transition_matrix(*arguments)


def test_the_guides_bank_does_what_the_guide_says() -> None:
    guide = Path(estimators.__file__).with_name("README.md").read_text(encoding="utf-8")
    compiled, stepwise = re.findall(r"```python\n(.*?)```", guide, flags=re.DOTALL)[-2:]
    shown: dict = {}
    exec(compile(compiled, "README.md", "exec"), shown)
    assert np.flatnonzero(shown["cracked"])[0] == 1008
    assert shown["cracked"][1008:].all()
    exec(compile(stepwise, "README.md", "exec"), shown)
    np.testing.assert_allclose(shown["bank"].mu, shown["found"].mu[-1], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(shown["bank"].x, shown["found"].x[-1], rtol=1e-8)
    assert shown["bank"].mode == 1
