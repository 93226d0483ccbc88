"""The tracker on an axis as it believes it: gaps, jumps, and the zero of its difference sensor."""

from __future__ import annotations

import numpy as np
import pytest
from consistent_axis import ACCUMULATOR, VISCOUS, WALKS, model, quiet_noise, simulate, typical_state

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.noise import Noise
from estimators.eha.redundancy import PAIRS, compare_sensors
from estimators.eha.tracker import EhaTracker
from estimators.eha.walk import (
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


# Valves


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
