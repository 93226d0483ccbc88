"""The tracker on simulated axes, whose plant shares no code with it."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.eha import model as eha
from fdd import Samples, Unit
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.residuals.tracked import Tracked
from fdd.residuals.tracking import METHODS, Tracking, channels_of, estimates, observability

LEAK = {"fault": "internal_leakage", "severity": 0.5, "onset": 6.0}
# The filters' L_T is a coefficient of laminar leakage. An orifice's has no such coefficient: its secant,
# which the truth gives, grows without bound as the pressure passes zero.
LAMINAR = {"internal_leakage_orifice_share": 0.0}
WORN = {"dropped": 0.05, "late": 0.02, "nan_bursts_per_minute": 60.0}


@cache
def unit() -> Unit:
    return Unit.load("axis_a")


@cache
def axis(recording: str = "usual", *, leaks: bool = False, duration: float = 20.0) -> Simulation:
    """Axis A moving to and fro against a spring, which loads both chambers."""
    return simulate(unit(), Scenario(
        duration=duration, duty={"name": "sines"}, load={"name": "spring"}, faults=[LEAK] if leaks else [],
        fault_scales=LAMINAR, recording=Recording(**{"usual": {}, "worn": WORN}[recording]),
    ))  # fmt: skip


@cache
def tracked(samples: Samples) -> Tracked:
    """Both filters over all samples, once for the tests of either."""
    both = Tracked(unit(), keep=True)
    both.push(samples)
    return both


def errors(run: Simulation, method: str, start: float) -> dict[str, list[np.ndarray]]:
    """Relative errors of leakage and bulk modulus from `start` on, where observable, and their own std."""
    both = tracked(run.samples)
    records = both.records()[method]
    values, stds = estimates(records, unit(), both.model)
    visible = observability(values, stds)
    found = {}
    for name in ("leakage", "bulk_modulus"):
        truth = np.interp(records["time"], run.truth.time, run.truth[name])
        columns = (np.abs(values[name] / truth - 1.0), visible[name], stds[name] / truth)
        found[name] = [column[records["time"] > start] for column in columns]
    return found


@pytest.mark.parametrize("method", METHODS)
def test_healthy_axis_is_tracked_within_five_percent(method: str) -> None:
    found = errors(axis(), method, start=5.0)
    error, visible, _ = found["bulk_modulus"]
    assert visible.mean() > 0.9
    assert np.quantile(error[visible], 0.95) < 0.05
    error, visible, _ = found["leakage"]  # not always observable at such loads; where it is, it is right
    assert (error[visible] < 0.05).all()
    assert np.quantile(error, 0.9) < 0.15


@pytest.mark.parametrize("method", METHODS)
def test_a_leak_is_followed_to_within_its_standard_deviation(method: str) -> None:
    """A spring makes the pressure's rate of change proportional to velocity: gain and compliance look alike,
    and partly like leakage, of which the filter itself claims no more than 4 to 5 % here."""
    run = axis(leaks=True)
    leakage = run.truth["leakage"]
    assert leakage[-1] > 1.8 * leakage[0]
    for name, (error, visible, share) in errors(run, method, start=12.0).items():
        assert visible.mean() > 0.9, name
        assert np.quantile((error / share)[visible], 0.95) < 2.5, name
        assert np.quantile(error[visible], 0.95) < {"leakage": 0.08, "bulk_modulus": 0.05}[name], name


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("load", ["spring", "none"])
def test_noise_of_an_lvdt_is_no_air(load: str, method: str) -> None:
    """40 µm instead of an encoder's one: a velocity from two samples is then mostly noise."""
    lvdt = unit().model_copy(deep=True)
    lvdt.sensors["position"] = unit().sensor("position").model_copy(update={"noise": 4e-5})
    run = simulate(lvdt, Scenario(duration=30.0, duty={"name": "sines"}, load={"name": load}, seed=3))
    both = Tracked(lvdt, keep=True)
    both.push(run.samples)
    records = both.records()[method]
    late = records["time"] > 15.0
    values, _ = estimates(records[late], lvdt, both.model)
    for name, bound in (("leakage", 0.05), ("bulk_modulus", 0.10)):
        assert np.abs(np.median(values[name]) / np.median(run.truth[name]) - 1.0) < bound, name


@pytest.mark.parametrize("method", ["ekf", "svsf"])
def test_late_stamps_dropped_rows_and_holes_do_little(method: str) -> None:
    run = axis("worn", leaks=True)
    assert np.isnan(run.samples["pump_angle"]).any()
    assert len(run.samples) < 19_500
    records = tracked(run.samples).records()[method]
    assert layout.finite(records).all()
    for name, (error, visible, _) in errors(run, method, start=14.0).items():
        assert visible.mean() > 0.5, name
        assert np.quantile(error[visible], 0.95) < 0.10, name


@pytest.mark.parametrize("method", METHODS)
def test_a_measured_difference_does_for_chamber_pressures(method: str) -> None:
    """It does not tell the chambers apart: what would be theirs alone stays as it was, and certain."""
    run = axis(leaks=True)
    kept = ("position", "pump_angle", "pressure_difference", "pressure_accumulator")
    both = tracked(Samples(run.samples.time, {n: run.samples[n] for n in kept}))
    records = both.records()[method]
    leakage = estimates(records, unit(), both.model)[0]["leakage"][records["time"] > 14.0]
    assert np.median(np.abs(leakage / run.truth["leakage"][-1] - 1.0)) < 0.10
    # Nothing is wrong with the axis, and the SVSF does not think so either.
    assert records["outside"].max() == 0.0
    for state in (eha.SPLIT, eha.ZERO):
        assert not records["state"][:, state].any() and not records["variance"][:, state].any()


@settings(max_examples=15)
@given(st.lists(st.integers(0, 6000), max_size=12))
def test_any_cut_into_blocks_gives_the_same_bits_also_over_restarts(cuts: list[int]) -> None:
    samples = axis("worn", duration=6.0).samples
    whole, cut = Tracked(unit(), keep=True), Tracked(unit(), keep=True)
    whole.push(samples)
    edges = [0, *sorted(min(c, len(samples)) for c in cuts), len(samples)]
    for a, b in pairwise(edges):
        state, before = cut.state(), cut
        cut = Tracked(unit(), keep=True)
        cut.restore(state)
        before.push(samples.rows(a, b))  # the state must be a copy that this leaves alone
        cut.push(samples.rows(a, b))
    assert not whole.lost
    for method in METHODS:
        one, other = (x.records()[method].view(np.float64) for x in (whole, cut))
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("method", METHODS)
def test_frozen_and_wild_channels_leave_it_finite(method: str) -> None:
    samples = axis(duration=6.0).samples
    tracking = Tracking(unit(), channels_of(samples), 1e-3)
    block, filter_ = tracking.block(samples), tracking.trackers[method]
    block[2000:2600, layout.POSITION] = block[2000, layout.POSITION]
    block[3000:3200, layout.PRESSURE_1] = np.nan
    block[3600:3605, layout.PRESSURE_2] = 6.9e6
    block[4000:4300] = np.where(np.arange(layout.COLUMNS) == layout.TIME, block[4000:4300], np.nan)
    records = filter_.push(block)
    assert layout.finite(records).all()
    P, spread = filter_.P, np.sqrt(np.diag(filter_.P))
    assert np.isfinite(P).all() and (spread > 0.0).all()
    np.testing.assert_allclose(P, P.T, rtol=1e-12)
    assert np.linalg.eigvalsh(P / np.outer(spread, spread)).min() > 0.0, "as correlations"
