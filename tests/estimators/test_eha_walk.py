"""Walks, valves that stay closed, and jumps: against closed forms, Monte Carlo, and an axis as believed."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from consistent_axis import ACCUMULATOR, VISCOUS, WALKS, model, quiet_noise, simulate, typical_state
from scipy.stats import norm

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.noise import Noise
from estimators.eha.tracker import EhaTracker
from estimators.eha.walk import (
    SCORE_WINDOW,
    walk_parameters,
    walk_rates,
)

VALVES = (eha.VALVE1, eha.VALVE2)


def walked(
    x: eha.Array, P: eha.Array, seconds: float, noise: Noise | None = None, h: float = 1.0
) -> tuple[eha.Array, eha.Array]:
    """State and covariance after steps of `h` ms without any measurement."""
    x, P, diag = x.copy(), P.copy(), np.empty(eha.STATES)
    c = (noise or Noise()).numbers()
    rates = walk_rates(c)
    for _ in range(round(1e3 * seconds / h)):
        walk_parameters(x, P, h, 1.0, c, rates, diag)
        P[np.diag_indices(eha.STATES)] += diag
    return x, P


# Walks


@pytest.mark.parametrize(("state", "name", "factor"), [(state, *walk) for state, walk in WALKS.items()])
def test_a_walk_saturates_at_the_initial_variance(state: int, name: str, factor: float) -> None:
    """dP/dt = q² (1 - P/P₀) from P = 0: P₀ (1 - exp(-q² t/P₀))."""
    noise = Noise()
    rate, initial = getattr(noise, name) * factor, getattr(noise, f"initial_{name}") * factor
    constant = (initial / rate) ** 2
    for seconds in (0.05 * constant, constant, 5.0 * constant):
        P = walked(typical_state(), np.zeros((eha.STATES, eha.STATES)), seconds, h=1e3 * constant / 2000.0)[1]
        assert P[state, state] == pytest.approx(initial**2 * -np.expm1(-seconds / constant), rel=2e-3)
    # The free walk at first: its rate is a standard deviation per √s.
    P = walked(typical_state(), np.zeros((eha.STATES, eha.STATES)), 0.01)[1]
    assert P[state, state] == pytest.approx(rate**2 * 0.01, rel=0.01)


@pytest.mark.parametrize("gap", [2.0, 60.0, 3600.0])
def test_a_gap_in_one_step_is_the_gap_in_milliseconds(gap: float) -> None:
    """A log with a hole, or a monitor that was off for an hour: one call, not a million."""
    x = typical_state(VALVE1=0.02, VALVE2=0.002)
    noise, P = Noise(), np.zeros((eha.STATES, eha.STATES))
    for state, (name, factor) in WALKS.items():
        P[state, state] = (0.3 * getattr(noise, f"initial_{name}") * factor) ** 2
    P[VALVES, VALVES] = (0.3 * noise.initial_valve) ** 2
    at_once, slowly = walked(x, P, gap, h=1e3 * gap), walked(x, P, gap, h=gap)
    # The valve's pull changes a little while it closes; one step takes it as it was.
    np.testing.assert_allclose(at_once[0], slowly[0], atol=2e-3)
    spread = np.sqrt(np.diag(slowly[1]) + 1e-12)
    for state in (*WALKS, *VALVES):
        assert np.sqrt(at_once[1][state, state]) == pytest.approx(spread[state], rel=0.06), state
    for state, (name, factor) in WALKS.items():
        most = getattr(noise, f"initial_{name}") * factor
        assert np.sqrt(at_once[1][state, state]) <= most * (1.0 + 1e-9)


def test_valves_need_a_spread() -> None:
    c = Noise(initial_valve=0.0).numbers()
    with pytest.raises(ValueError, match="initial_valve"):
        walk_rates(c)


# Valves


def paths(start: float, seconds: float, count: int, step: float = 5e-3) -> np.ndarray:
    """Ends of ``dx = -x/(τ o) dt + q √o dW``, ``o = 1 + (x/3σ₀)²``, ``τ = 2 σ₀²/q²``; Euler and Maruyama."""
    noise, rng = Noise(), np.random.default_rng(3)
    q, sigma = noise.valve, noise.initial_valve
    x = np.full(count, start)
    for _ in range(round(seconds / step)):
        o = 1.0 + (x / (3.0 * sigma)) ** 2
        x += -x / (2.0 * sigma**2 / q**2 * o) * step + q * np.sqrt(o * step) * rng.standard_normal(count)
    return x


def test_a_valve_near_closed_stays_as_uncertain_as_at_the_start() -> None:
    """From certainty and from ignorance alike; Monte Carlo of the same equation has that spread too."""
    noise = Noise()
    sigma = noise.initial_valve
    settled = 20.0 * 2.0 * (sigma / noise.valve) ** 2
    for start in (0.0, 1.0):
        P = np.zeros((eha.STATES, eha.STATES))
        P[VALVES, VALVES] = start
        x, P = walked(typical_state(), P, settled, h=5.0)
        np.testing.assert_array_equal(x, typical_state())
        np.testing.assert_allclose(np.sqrt(P[VALVES, VALVES]), sigma, rtol=2e-3)
    # Its stationary density is exp(4.5/o)/o: half of it within 0.674 × 1.08 σ₀ (the tails are those of 1/x²).
    ends = paths(0.0, settled / 5.0, 8000)
    width = np.diff(np.quantile(ends, [0.25, 0.75]))[0] / (2.0 * norm.ppf(0.75))
    assert width == pytest.approx(1.09 * sigma, rel=0.06)


@pytest.mark.parametrize(
    ("start", "seconds", "kept"), [(1.0, 2.0, 0.99), (10.0, 1.5, 0.999), (0.03, 9.0, 0.2)]
)
def test_an_open_valve_stays_open_and_a_doubtful_one_closes(
    start: float, seconds: float, kept: float
) -> None:
    """Mean and spread of the filter are those of Monte Carlo, as far as linearising goes."""
    x, P = walked(typical_state(VALVE1=start), np.zeros((eha.STATES, eha.STATES)), seconds)
    spread = np.sqrt(P[eha.VALVE1, eha.VALVE1])
    ends = paths(start, seconds, 4000)
    assert (x[eha.VALVE1] > kept * start) if start >= 1.0 else (x[eha.VALVE1] < kept * start)
    centre, width = np.median(ends), np.diff(np.quantile(ends, norm.cdf([-1.0, 1.0])))[0] / 2.0
    assert abs(x[eha.VALVE1] - centre) < 0.2 * spread
    assert spread == pytest.approx(width, rel=0.15)


# Jumps


def tracked(
    block: eha.Array, start: eha.Array, noise: Noise, decimation: int, valve_spread: float | None = None
) -> eha.Array:
    """Records of the EKF, begun at `start`."""
    filter_ = EhaTracker(model(), noise, difference=False, viscous_friction=VISCOUS, decimation=decimation)
    filter_.x[:] = start
    if valve_spread is not None:
        filter_.P[VALVES, VALVES] = valve_spread**2
    return filter_.push(block)


SETTLES = 2.0


@cache
def healthy_scores() -> np.ndarray:
    """(windows, 5) scores while parameters walk as the filter believes; valves are open, away from bounds."""
    noise = quiet_noise(valve=0.004)
    rates = {
        eha.LEAK: noise.leakage, eha.AIR: noise.air * 1e3, eha.SPLIT: noise.air_split * 1e3,
        eha.GAIN: noise.gain, **dict.fromkeys(VALVES, noise.valve),
    }  # fmt: skip
    spreads = {
        eha.LEAK: noise.initial_leakage, eha.AIR: noise.initial_air * 1e3,
        eha.SPLIT: noise.initial_air_split * 1e3, eha.GAIN: noise.initial_gain, **dict.fromkeys(VALVES, 0.05),
    }  # fmt: skip
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        believed = typical_state(VALVE1=0.5, VALVE2=0.5)
        start = believed.copy()
        for state, spread in spreads.items():
            start[state] += spread * rng.standard_normal()
        block, _ = simulate(start, noise, 20.0, rng, walks=rates)
        records = tracked(block, believed, noise, round(SCORE_WINDOW), valve_spread=0.05)
        settled = records["time"] > SETTLES
        found.append(records["score"][settled])
    return np.concatenate(found)


def test_scores_of_a_consistent_axis_are_standard_normal() -> None:
    scores = healthy_scores()
    count = len(scores)
    assert scores.shape == (8 * 72, layout.FLOW_PARAMETERS)
    # Spreads of that many draws of N(0, 1) are within this 99.9 times in 100.
    np.testing.assert_allclose(scores.std(axis=0), 1.0, atol=3.3 / np.sqrt(2 * count))
    # Means too, but for what linearising leaves: leakage and valve 1, which share a flow, drift apart by
    # 0.05 of a score per window over 60 other runs.
    np.testing.assert_allclose(scores.mean(axis=0), 0.0, atol=0.05 + 3.3 / np.sqrt(count))
    # Beyond 2 and 3 standard deviations as often as a normal variable.
    for limit in (2.0, 3.0):
        expected = 2.0 * norm.sf(limit) * scores.size
        assert np.count_nonzero(np.abs(scores) > limit) == pytest.approx(
            expected, abs=4.0 * np.sqrt(expected)
        )
    # From one window to the next they know nothing of each other.
    for column in scores.T:
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 3.3 / np.sqrt(count)


CHANGES = {
    "leakage": {eha.LEAK: 0.5},
    "less leakage": {eha.LEAK: -0.4},
    "valve 1": {eha.VALVE1: 1.0},
    "valve 2": {eha.VALVE2: 15.0},
    "air": {eha.AIR: 5.0},
    "much air": {eha.AIR: 25.0},
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_step_is_noticed_and_the_new_value_found(change: str) -> None:
    """Under a load of 2 kN and the drive's noise; a step at 10 s."""
    noise, flow = quiet_noise(), [eha.LEAK, *VALVES, eha.AIR, eha.SPLIT]
    start = typical_state(LOAD=2000.0, P1=ACCUMULATOR + 0.7, P2=ACCUMULATOR - 0.6)
    scaled, missed = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        block, truth = simulate(start, noise, 18.0, rng, jump=CHANGES[change], at=10.0)
        records = tracked(block, start, noise, decimation=10)
        time = records["time"]
        leak_variance = records["variance"][:, eha.LEAK]
        widened = time[1:][np.diff(leak_variance) > 0.5 * noise.jump_leakage**2]
        assert widened.size and 10.0 < widened[0] < 10.75, "fires, and not before"
        x = records["state"]
        std = np.sqrt(records["variance"])
        error = x - truth[9::10]
        late = np.searchsorted(time, [13.0, 15.5, 17.9])
        scaled.append(error[late][:, flow] / std[late][:, flow])
        ((state, size),) = CHANGES[change].items()
        missed.append(abs(error[-1, state] / size))
    assert np.abs(scaled).max() < 3.5
    assert np.sqrt(np.mean(np.square(scaled))) < 1.5
    # One run in four hardly tells leakage from the valves; its standard deviations say so (above).
    assert np.median(missed) < 0.3


@pytest.mark.parametrize("leaked", [{eha.LEAK: 1.5}, {eha.VALVE1: 1.5}, {eha.LEAK: 0.5, eha.VALVE1: 1.0}])
def test_one_load_direction_tells_the_sum_of_leakage_and_valve_only(leaked: dict[int, float]) -> None:
    """Chamber 2 hangs on the accumulator: both flows leave chamber 1 in proportion to the same pressure."""
    noise = quiet_noise(refeed_margin=3e4)
    start = typical_state(LOAD=3000.0, STIF=10.0, P1=ACCUMULATOR + 3000.0 / 1520.0)
    block, _ = simulate(start, noise, 16.0, np.random.default_rng(0), jump=leaked, at=8.0, vented=True)
    records = tracked(block, start, noise, decimation=10)
    late = records[records["time"] > 10.0]
    x = late["state"]
    variance = late["variance"]
    covariance = late["leakage_valve"][:, 0]
    std = np.sqrt(variance)
    assert (std[:, [eha.LEAK, eha.VALVE1]] > 0.5).all(), "neither is known by itself, and it says so"
    assert (covariance < -0.99 * std[:, eha.LEAK] * std[:, eha.VALVE1]).all()
    total = x[:, eha.LEAK] + x[:, eha.VALVE1]
    spread = np.sqrt(variance[:, eha.LEAK] + variance[:, eha.VALVE1] + 2.0 * covariance)
    assert (spread < 0.06).all()  # the open valve walks on
    assert (np.abs(total - 2.5) < 3.5 * spread).all()
    for state, before in ((eha.LEAK, 1.0), (eha.VALVE1, 0.0)):
        assert (np.abs(x[:, state] - before - leaked.get(state, 0.0)) < 3.0 * std[:, state]).all()
