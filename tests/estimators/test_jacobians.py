"""check_jacobian against derivatives known in closed form, and against the mistakes people make."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import check_jacobian


def pendulum(x, u, dt):
    return [x[0] + dt * x[1], x[1] + dt * (u - 9.81 * np.sin(x[0]))]


def pendulum_jacobian(x, u, dt):
    return [[1.0, dt], [-dt * 9.81 * np.cos(x[0]), 1.0]]


def drag(x):
    """Quadratic friction, and a steep sign."""
    return [np.abs(x[0]) * x[0], np.tanh(x[1] / 0.01)]


def drag_jacobian(x):
    return [[2.0 * np.abs(x[0]), 0.0], [0.0, 100.0 / np.cosh(x[1] / 0.01) ** 2]]


def hydraulics(x):
    """SI: leakage of 5e-12 times pressure of 5e6, over a stiffness of 1e9."""
    return [x[0] * x[1] - 1e-5, x[1] / x[2]]


def hydraulics_jacobian(x):
    return [[x[1], x[0], 0.0], [0.0, 1.0 / x[2], -x[1] / x[2] ** 2]]


def by_hand(x):
    return math.hypot(x[0], x[1])


CASES = {
    "pendulum": (pendulum, pendulum_jacobian, [0.7, -0.2], (0.3, 0.01)),
    "drag": (drag, drag_jacobian, [-1.5, 0.004], ()),
    "SI": (hydraulics, hydraulics_jacobian, [4.8e-12, 5e6, 1.1e9], ()),
    "math": (
        by_hand,
        lambda x: [x[0] / math.hypot(*x), x[1] / math.hypot(*x)],
        [3.0, 4.0],
        (),
    ),
}
each = pytest.mark.parametrize("name", CASES)


@each
def test_a_right_jacobian_passes(name: str) -> None:
    function, derivative, x, args = CASES[name]
    check = check_jacobian(function, derivative, x, *args)
    assert check.correct, str(check)
    exact = np.reshape(derivative(np.array(x), *args), check.expected.shape)
    np.testing.assert_allclose(check.expected, exact, rtol=1e-8, atol=1e-300)
    check.require()


@each
def test_every_single_wrong_entry_is_named(name: str) -> None:
    function, derivative, x, args = CASES[name]
    exact = np.atleast_2d(np.array(derivative(np.array(x), *args), float))
    for row, column in np.argwhere(exact != 0.0):
        for factor in (-1.0, 0.0, 1.0 + 1e-5):  # sign, forgotten, a wrong digit
            wrong = exact.copy()
            wrong[row, column] *= factor
            check = check_jacobian(function, lambda *_, J=wrong: J, x, *args)
            assert np.argwhere(check.wrong).tolist() == [[row, column]], (row, column, factor)
            assert check.worst == (row, column)
            assert f"[{row}, {column}]" in str(check)
            with pytest.raises(ValueError, match="Jacobian is off in 1 of"):
                check.require()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4), m=st.integers(1, 4))
def test_random_smooth_functions_in_random_units(seed: int, n: int, m: int) -> None:
    """Right in any units of x and of the values; a transposed sign found in any, too."""
    rng = np.random.default_rng(seed)
    A, B = rng.uniform(0.5, 2.0, (m, n)) * rng.choice([-1.0, 1.0], (m, n)), rng.normal(size=(m, n))
    units, out = 10.0 ** rng.uniform(-12, 12, n), 10.0 ** rng.uniform(-12, 12, m)
    x = rng.normal(size=n) * units

    def function(v):
        w = v / units
        return out * (A @ w + np.sin(B @ w))

    exact = out[:, None] * (A + np.cos(B @ (x / units))[:, None] * B) / units
    check = check_jacobian(function, lambda v: exact, x, scale=units)
    assert check.correct, str(check)
    row, column = rng.integers(m), rng.integers(n)
    wrong = exact.copy()
    wrong[row, column] += 0.01 * out[row] / units[column]
    check = check_jacobian(function, lambda v: wrong, x, scale=units)
    assert np.argwhere(check.wrong).tolist() == [[row, column]]


def test_nan_in_a_jacobian_is_wrong() -> None:
    check = check_jacobian(lambda x: [x[0]], lambda x: [[np.nan]], [1.0])
    assert not check.correct
    assert check.worst == (0, 0)


def test_a_function_that_changes_its_argument_does_no_harm() -> None:
    def careless(x):
        x *= 2.0
        return x

    x = np.array([1.0, 2.0])
    assert check_jacobian(careless, lambda x: 2.0 * np.eye(2), x).correct
    assert x.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: check_jacobian(pendulum, pendulum_jacobian, [0.0, 0.0], 0.0, np.nan), "the function gives"),
        (
            lambda: check_jacobian(drag, lambda x: np.eye(3), [1.0, 1.0]),
            r"shape \(3, 3\); expected is \(2, 2\)",
        ),
        (lambda: check_jacobian(drag, drag_jacobian, [1.0, 1.0], scale=[1.0, 0.0]), "give a positive size"),
    ],
)
def test_unusable_input_is_refused(call, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        call()
    assert "\n" not in str(error.value)
