"""Walks, jumps and bounds of the EHA tracker's parameters, and the model step as its loop calls it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.bounds import HIGHEST, LOWEST, keep_in_bounds
from estimators.eha.noise import Noise
from estimators.eha.update import COUPLED, MOVING
from estimators.eha.walk import JUMP_SIGMAS, LONG_WINDOWS, walk_parameters, walk_rates, watch_jumps

N = eha.STATES
# Rate and initial spread of each walk in the model's units, written down from the noise's fields.
UNITS = {
    "leakage": (eha.LEAK, 1.0), "air": (eha.AIR, 1e3), "air_split": (eha.SPLIT, 1e3), "gain": (eha.GAIN, 1.0),
    "friction": (eha.FRIC, 1.0), "viscous_friction": (eha.VISC, 1.0), "viscous_skew": (eha.SKEW, 1.0),
    "stiffness": (eha.STIF, 1e-3), "throttle": (eha.THROT, 1.0), "inertia": (eha.INERT, 1.0),
    "zero": (eha.ZERO, 1e-6),
}  # fmt: skip
WALKS = {
    state: (getattr(Noise(), name) * unit, getattr(Noise(), f"initial_{name}") * unit)
    for name, (state, unit) in UNITS.items()
}


def estimate(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A state, and a covariance in two blocks around the size of the initial one."""
    x, P = rng.uniform(0.0, 5.0, N), np.zeros((N, N))
    for block in (slice(0, COUPLED), slice(COUPLED, N)):
        size = len(range(N)[block])
        root = rng.standard_normal((size, size))
        P[block, block] = root @ root.T
    spread = np.ones(N)
    for state, (_, initial) in WALKS.items():
        spread[state] = 0.3 * initial
    P *= np.outer(spread, spread)
    return x, 0.5 * (P + P.T)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 4.0), st.floats(0.01, 100.0))
def test_walks_are_those_of_the_equations(seed: int, h: float, unrest: float) -> None:
    """``q² (1 − P/P₀²)`` for each, leakage and air in proportion to their size, valves drawn back."""
    x, P = estimate(np.random.default_rng(seed))
    noise, seconds = Noise(), 1e-3 * h
    walked, widened, diag = x.copy(), P.copy(), np.empty(N)
    c = noise.numbers()
    walk_parameters(walked, widened, h, unrest, c, walk_rates(c), diag)

    expected, pull = np.zeros(N), np.eye(N)
    for state, (rate, initial) in WALKS.items():
        if state == eha.LEAK:
            rate, initial = rate * max(1.0, x[state]), initial * max(1.0, x[state])
        if state == eha.AIR:
            initial *= max(1.0, 0.3 * x[state])
        expected[state] = rate**2 * seconds * max(1.0 - P[state, state] / initial**2, 0.0)
    expected[eha.LOAD] = noise.load**2 * seconds * unrest
    for state in (eha.VALVE1, eha.VALVE2):
        openness = 1.0 + (x[state] / (3.0 * noise.initial_valve)) ** 2
        settling = 2.0 * noise.initial_valve**2 / noise.valve**2  # s, while it is closed
        pull[state, state] = 1.0 - seconds / settling / openness
        expected[state] = noise.valve**2 * seconds * openness
    np.testing.assert_allclose(diag, expected, rtol=1e-10, atol=1e-25)
    np.testing.assert_allclose(walked, pull @ x, rtol=1e-13)
    np.testing.assert_array_equal(widened, widened.T)
    np.testing.assert_allclose(widened, pull @ P @ pull, rtol=1e-12)


def test_an_hour_of_walks_gets_no_less_certain_than_the_start() -> None:
    """From certainty: ``P = P₀² (1 − exp(−q² t / P₀²))``, and a closed valve's pull likewise."""
    noise, x, P, diag = Noise(), np.zeros(N), np.zeros((N, N)), np.empty(N)
    c = noise.numbers()
    c.initial_air_split = 0.0  # one that the sensors cannot tell
    rates, before = walk_rates(c), P.copy()
    for _ in range(72_000):
        walk_parameters(x, P, 50.0, 1.0, c, rates, diag)
        P[np.diag_indices(N)] += diag
        assert (np.diag(P) >= np.diag(before)).all()
        before[...] = P
    for state, (rate, initial) in WALKS.items():
        expected = 0.0 if state == eha.SPLIT else initial**2 * -np.expm1(-(rate**2) * 3600.0 / initial**2)
        assert P[state, state] == pytest.approx(expected, rel=1e-3)
    assert P[eha.VALVE1, eha.VALVE1] == pytest.approx(noise.initial_valve**2, rel=0.02)  # steps of 50 ms


def test_valves_need_a_spread() -> None:
    c = Noise(initial_valve=0.0).numbers()
    with pytest.raises(ValueError, match="initial_valve"):
        walk_rates(c)


def windows(count: int, score: float, parameter: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariance and memory after windows in which one parameter moved by `score` sigmas."""
    c, P, memory = Noise().numbers(), np.eye(N), np.zeros(1, layout.MEMORY)[0]
    samples, gained = 250, 1e-6
    for _ in range(count * samples):
        x, before = np.zeros(N), np.zeros((2, layout.FLOW_PARAMETERS))
        before[1] = np.diag(P)[eha.LEAK : eha.LEAK + layout.FLOW_PARAMETERS] + gained
        x[eha.LEAK + parameter] = score * np.sqrt(samples * gained) / samples
        watch_jumps(x, P, before, 1.0, c, memory)
    return P, memory


@pytest.mark.parametrize("parameter", range(layout.FLOW_PARAMETERS))
def test_a_jump_sets_the_flow_parameters_free(parameter: int) -> None:
    noise = Noise()
    P, memory = windows(1, 1.01 * JUMP_SIGMAS, parameter)
    widened = np.diag(P) - 1.0
    expected = np.zeros(N)
    expected[[eha.LEAK, eha.VALVE1, eha.VALVE2]] = [noise.jump_leakage, noise.jump_valve, noise.jump_valve]
    expected[[eha.AIR, eha.SPLIT]] = 1e3 * noise.jump_air, 1e3 * noise.initial_air_split
    expected[eha.GAIN] = noise.initial_gain
    np.testing.assert_allclose(widened, expected**2)
    assert memory.score[parameter] == pytest.approx(1.01 * JUMP_SIGMAS)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_no_jump_below_the_limit_and_drifts_add_up(sign: float) -> None:
    """A window at 2 sigmas says nothing; eight of them on one side are 2 √8 = 5.7."""
    quiet, _ = windows(LONG_WINDOWS - 1, sign * 2.0, 0)
    np.testing.assert_array_equal(quiet, np.eye(N))
    drifted, _ = windows(LONG_WINDOWS, sign * 2.0, 0)
    assert drifted[eha.LEAK, eha.LEAK] > 1.0


def test_jumps_in_a_row_double_the_step() -> None:
    """A valve torn open is a hundred healthy leakages: each window without peace asks for twice as much."""
    P, _ = windows(3, 2.0 * JUMP_SIGMAS, 1)
    step = Noise().jump_valve
    assert P[eha.VALVE1, eha.VALVE1] == pytest.approx(1.0 + step**2 * (1.0 + 4.0 + 16.0))


def test_a_consistent_filter_rarely_jumps() -> None:
    """Updates whose variance is what the covariance loses: scores are standard normal."""
    rng, c = np.random.default_rng(5), Noise().numbers()
    P, memory, x = np.eye(N), np.zeros(1, layout.MEMORY)[0], np.zeros(N)
    scores = []
    for i in range(250 * 400):
        before, gained = np.zeros((2, layout.FLOW_PARAMETERS)), 1e-4 * (1.0 + np.sin(i))
        before[1] = 1.0 + gained
        x[eha.LEAK : eha.LEAK + layout.FLOW_PARAMETERS] = np.sqrt(gained) * rng.standard_normal(5)
        watch_jumps(x, P, before, 1.0, c, memory)
        if i % 250 == 249:
            scores.append(memory.score.copy())
    np.testing.assert_array_equal(P, np.eye(N))
    assert np.std(scores) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * np.size(scores)))


@given(st.integers(0, 2**32 - 1), st.integers(eha.LEAK, N - 1), st.floats(0.1, 3.0))
def test_bounds_move_to_the_likeliest_point(seed: int, state: int, beyond: float) -> None:
    """The point on the bound with the least ``d' P⁻¹ d``, by Lagrange; inside the bounds nothing moves."""
    rng = np.random.default_rng(seed)
    _, P = estimate(rng)
    P *= 1e-6  # neighbours stay away from their own bounds
    x = np.zeros(N)
    x[[eha.LEAK, eha.VALVE1, eha.VALVE2, eha.AIR, eha.FRIC]] = 2.0
    inside = x.copy()
    keep_in_bounds(x, P)
    np.testing.assert_array_equal(x, inside)
    if not np.isfinite(LOWEST[state]):
        return
    x[state] = LOWEST[state] - beyond * np.sqrt(P[state, state])
    h = np.eye(N)[state]
    multiplier = (LOWEST[state] - x[state]) / (h @ P @ h)
    expected = x + P @ h * multiplier
    expected[: eha.LEAK] = x[: eha.LEAK]  # motion is measured; it stays
    keep_in_bounds(x, P)
    np.testing.assert_allclose(x, expected, rtol=1e-12, atol=1e-15)
    assert LOWEST[state] <= x[state] <= HIGHEST[state]


def test_what_the_loop_calls_is_the_model_step() -> None:
    """`advance` into arrays that an earlier step has used, without the columns that the loop leaves out."""
    rng = np.random.default_rng(7)
    q = eha.parameters(
        area_1=1.5e-3, area_2=1.4e-3, volume_1=2e-4, volume_2=2.5e-4, moving_mass=20.0, displacement=5.57e-7,
        cross_port_leakage=5e-12, case_leakage=1e-12, bulk_modulus=2.1e8, air_fraction=0.003,
        polytropic_index=1.2, reference_pressure=1e6, friction_forward=(300.0, 500.0, 0.01, 1.0),
        friction_reverse=(320.0, 450.0, 0.02, 0.8), accumulator_pressure=4e5, position_compliance=1.3,
    )  # fmt: skip
    used_F, used_G, moved = np.full((N, N), 7.0), np.zeros((N, 4)), np.full(N, 7.0)
    for _ in range(20):
        x = rng.uniform(0.1, 2.0, N)
        x[[eha.V, eha.W]] = rng.uniform(-0.1, 0.1, 2)
        x[eha.GAIN] = 0.01
        F, G, out = np.empty((N, N)), np.empty((N, 4)), np.empty(N)
        eha.step(x, 1.0, 1.1, 0.4, 0.05, -0.03, q, out, F, G)
        friction = eha.friction_curve(x[eha.V], q)
        eha.advance(x, 1.0, 1.1, 0.4, 0.05, -0.03, q, friction, COUPLED, moved, used_F, used_G)
        np.testing.assert_array_equal(moved[:MOVING], out[:MOVING])
        np.testing.assert_array_equal(used_G, G)
        for row in (eha.X, eha.V, eha.P1, eha.P2):
            np.testing.assert_array_equal(used_F[row, :COUPLED], F[row, :COUPLED])
    np.testing.assert_array_equal(F[MOVING:], np.eye(N)[MOVING:])
    assert (moved[MOVING:] == 7.0).all() and (used_F[MOVING:] == 7.0).all()
