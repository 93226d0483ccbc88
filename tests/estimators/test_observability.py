"""What the last seconds told, which estimates may be used, and that rest teaches nothing."""

from functools import cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.observability import Drift, Observability, Observed
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.residuals.tracking import OBSERVABLE, Tracking, channels_of, estimates, new_watch, watched
from fdd.unit import Unit

PARTS = ("valid", "information_std", "held", "held_std", "age")
LIMITS = {"a": (0.05, 0.07), "b": (0.2, 0.2)}


def records(seed: int, n: int = 400, *, jumps: bool = False) -> tuple[np.ndarray, dict, dict, dict]:
    """Estimates whose standard deviations wander through the limits, at uneven times, some missing."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.exponential(0.1, n))
    values = {name: rng.normal(3.0, 0.2, n) for name in LIMITS}
    walk = np.cumsum(rng.normal(0.0, 0.05, n))
    stds = {
        "a": 0.18 * np.exp(np.sin(walk)),
        "b": np.where(rng.random(n) < 0.05, np.nan, 0.6 + 0.1 * np.sin(walk)),
    }
    if jumps:
        for std in stds.values():
            std[rng.random(n) < 0.05] *= 4.0
    scale = 1.0 + 0.1 * rng.random(n)
    walks = {"a": Drift(rate=1e-3 * rng.random(n), ceiling=np.full(n, 0.3), scale=scale)}
    return time, values, stds, walks


@given(st.lists(st.integers(0, 400), max_size=12), st.integers(0, 20))
def test_any_cut_into_blocks_gives_the_same_bits_also_over_restarts(cuts: list[int], seed: int) -> None:
    time, values, stds, walks = records(seed, jumps=True)
    whole = Observability(LIMITS).push(time, values, stds, walks)
    parts: dict[str, list[Observed]] = {name: [] for name in LIMITS}
    watch = Observability(LIMITS)
    for a, b in pairwise([0, *sorted(cuts), 400]):
        block = {name: v[a:b] for name, v in values.items()}, {name: v[a:b] for name, v in stds.items()}
        d = walks["a"]
        walk = {"a": Drift(d.rate[a:b], d.ceiling[a:b], d.scale[a:b])}
        state = watch.state()
        watch = Observability(LIMITS)
        watch.restore(state)
        for name, seen in watch.push(time[a:b], *block, walk).items():
            parts[name].append(seen)
    for name, part in product(LIMITS, PARTS):
        joined = np.concatenate([getattr(seen, part) for seen in parts[name]])
        np.testing.assert_array_equal(joined, getattr(whole[name], part), err_msg=f"{name} {part}")
        np.testing.assert_array_equal(getattr(watch.latest()[name], part), joined[-1:])


@given(st.integers(0, 1000))
def test_flag_and_held_value_are_those_of_a_plain_loop(seed: int) -> None:
    time, values, stds, _ = records(seed)
    found = Observability(LIMITS).push(time, values, stds)
    for name, (low, high) in LIMITS.items():
        valid, held, since, rows = False, np.nan, np.nan, []
        for k in range(time.size):
            share = stds[name][k] / abs(values[name][k])
            if share < low:
                valid = True
            elif not share <= high:  # also where it is unknown
                valid = False
            if valid:
                held, since = values[name][k], time[k]
            rows.append((valid, held, time[k] - since))
        seen = found[name]
        np.testing.assert_array_equal(np.column_stack([seen.valid, seen.held, seen.age]), rows)


def observed(
    time: np.ndarray, value: np.ndarray, std: np.ndarray, walk: Drift | None = None, **options: Any
) -> Observed:
    """What is seen of one estimate, all at once."""
    watch = Observability({"x": options.pop("limits", (0.1, 0.2))}, **options)
    return watch.push(time, {"x": value}, {"x": std}, *([{"x": walk}] if walk else []))["x"]


def scalar_filter(q: float, R: np.ndarray, ceiling: float, dt: float) -> np.ndarray:
    """Variances of a scalar Kalman filter on a parameter that walks; R infinite: no measurement."""
    P, out = 4.0, []
    for r in R:
        P = P + q * dt * max(0.0, 1.0 - P / ceiling)
        P = P if np.isinf(r) else P * r / (P + r)
        out.append(P)
    return np.array(out)


@pytest.mark.parametrize("q", [0.0, 1e-4, 0.3])
def test_information_of_a_scalar_filter_is_that_of_its_measurements(q: float) -> None:
    """Whatever the walk and the prior: each measurement brings 1/R, and counts while in the window."""
    rng = np.random.default_rng(1)
    dt, window, n = 0.05, 2.5, 600
    R = rng.uniform(0.5, 4.0, n)
    R[rng.random(n) < 0.3] = np.inf
    R[400:] = np.inf
    time = dt * np.arange(n)
    std = np.sqrt(scalar_filter(q, R, np.inf, dt))
    seen = observed(time, np.ones(n), std, Drift(rate=q), window=window)
    # The window moves on in tenths of itself.
    part = np.floor(time / (window / 10) + 1e-9)
    inside = (part[None, :] > part[:, None] - 10) & (time[None, :] <= time[:, None])
    inside[:, 0] = False  # what came before the first record cannot be told from what was known before
    expected = inside @ (1.0 / R)
    np.testing.assert_allclose(seen.information_std[5:] ** -2.0, expected[5:], rtol=1e-6, atol=1e-9)
    assert seen.information_std[395] < 1.0 and seen.information_std[-1] > 1e6


def test_the_walk_takes_the_held_value_no_further_than_the_ceiling() -> None:
    n, q, ceiling = 3000, 0.5, 2.0
    P = scalar_filter(q, np.where(np.arange(n) < 200, 0.1, np.inf), ceiling, 0.01)
    seen = observed(0.01 * np.arange(n), np.ones(n), np.sqrt(P), Drift(q, ceiling), limits=(0.2, 0.3))
    assert seen.valid[199] and not seen.valid[-1]
    # dP/dt = q (1 - P/c) from the last measurement on
    t = 0.01 * (np.arange(n) - 199.0)[200:]
    law = ceiling - (ceiling - P[199]) * np.exp(-q * t / ceiling)
    np.testing.assert_allclose(seen.held_std[200:], np.sqrt(law), rtol=2e-3)
    assert seen.age[-1] == pytest.approx(0.01 * (n - 1 - np.flatnonzero(seen.valid)[-1]))


def test_a_change_of_scale_or_a_jump_is_no_information() -> None:
    scale, time = np.linspace(1.0, 0.2, 50), np.arange(50.0)
    seen = observed(time, scale, 0.5 * scale, Drift(scale=scale))
    assert (1.0 / seen.information_std < 1e-6).all()
    assert observed(time, scale, 0.5 * scale).information_std[-1] < 1.0, "else this shows nothing"
    jump = observed(time, np.ones(50), np.repeat([0.1, 0.5], 25))
    assert np.isinf(jump.information_std).all()


def test_what_a_filter_believed_just_before_it_was_set_free_is_not_held() -> None:
    time = 0.01 * np.arange(1000)
    value, std = np.ones(1000), np.full(1000, 0.03)
    value[600:630] = np.linspace(1.0, 4.0, 30)  # misled for 0.3 s
    value[630:], std[630:] = 2.0, 1.0
    seen = observed(time, value, std, limits=(0.05, 0.07))
    assert seen.valid[629] and not seen.valid[630:].any()
    assert (seen.held[630:] == 1.0).all() and (seen.held_std[630:] == 1.0).all()
    assert 0.5 <= seen.age[630] <= 1.02
    # Where it only grows less certain, the very last value counts.
    std = 0.03 * np.exp(time / 5.0)
    slow = observed(time, 1.0 + 0.01 * time, std, Drift(rate=1e-3), limits=(0.05, 0.07))
    last = np.flatnonzero(slow.valid)[-1]
    assert slow.held[-1] == 1.0 + 0.01 * time[last] and last < 999


def test_what_makes_no_sense_is_refused_and_nothing_is_taken() -> None:
    one = {"x": np.ones(3)}
    for limits in ((0.2, 0.1), (0.0, 0.1), (np.nan, 0.1)):
        with pytest.raises(ValueError, match="limits of x"):
            Observability({"x": limits})
    with pytest.raises(ValueError, match="window is 0 s"):
        Observability({"x": (0.1, 0.2)}, window=0.0)
    watch = Observability({"x": (0.1, 0.2)})
    watch.push([5.0], {"x": [1.0]}, {"x": [0.05]})
    before = watch.state()
    bad: list[tuple[tuple[Any, ...], str]] = [
        (([6.0, 5.5, 7.0], one, one), "backwards"),
        (([6.0, 7.0, 8.0], one, {"x": -np.ones(3)}), "negative"),
        (([6.0, 7.0, 8.0], one, one, {"x": Drift(rate=-1.0)}), "drift"),
    ]
    for arguments, said in bad:
        with pytest.raises(ValueError, match=said):
            watch.push(*arguments)
    with pytest.raises(ValueError, match="carried"):
        watch.restore(Observability(LIMITS).state())
    for name, value in before.items():
        np.testing.assert_array_equal(watch.state()[name], value)


# On the EHA

PERFECT = Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
MOVES = [
    (0, 0.0), (3, 0.03), (5, -0.03), (7, 0.03), (9, -0.02), (11, 0.04), (13, -0.04), (15, 0.02), (17, 0.01),
]  # fmt: skip


@cache
def unit() -> Unit:
    return Unit.load("axis_a")


def run(duration: float, moves: list[tuple[float, float]], seed: int = 5, **more: Any) -> Simulation:
    duty = {"name": "levels", "points": [list(m) for m in moves]}
    return simulate(unit(), Scenario(duration=duration, duty=duty, recording=PERFECT, seed=seed, **more))


class Followed:
    """One filter on an axis, with what it shows."""

    def __init__(self, simulation: Simulation, method: str = "ekf") -> None:
        self.tracking = Tracking(unit(), channels_of(simulation.samples), 1e-3)
        self.tracker, self.watch = self.tracking.trackers[method], new_watch()
        self.push(self.tracking.block(simulation.samples))

    def push(self, block: np.ndarray) -> None:
        records = self.tracker.push(block)
        self.time = records["time"]
        self.values, self.stds = estimates(records, unit(), self.tracking.model)
        self.seen = watched(self.watch, records, unit(), self.tracking.model, self.tracker.noise)


def test_motion_informs_rest_does_not_and_motion_makes_valid_again() -> None:
    moves = [*MOVES, *((t + 60.0, x) for t, x in MOVES)]
    for load in ({"name": "spring"}, {"name": "constant", "level": 1500.0}):
        simulation = run(80.0, moves, load=load)
        f = Followed(simulation)
        started, moved, rested, again = np.searchsorted(f.time, (2.0, 17.0, 59.5, 79.0))
        for name in ("bulk_modulus", "coulomb_friction"):
            seen, std = f.seen[name], f.stds[name]
            assert seen.valid[moved] and not seen.valid[rested] and seen.valid[again], (load, name)
            assert seen.information_std[moved] < 1.5 * std[moved]
            assert seen.information_std[rested] > 10.0 * std[rested]  # not a hundredth of what is known
            assert 15.0 < seen.age[rested] < 43.0
            # While invalid the value before is kept.
            last = int(np.argmin(np.abs(f.time - (f.time[rested] - seen.age[rested]))))
            assert seen.held[rested] == f.values[name][last]
            assert seen.held_std[rested] >= std[rested] > std[last]
            assert abs(seen.held[rested] - simulation.truth[name][-1]) < 2.0 * seen.held_std[rested]
        assert load["name"] != "spring" or not f.seen["leakage"].valid[started:].all()


def test_leakage_is_not_called_valid_while_a_valves_leakage_could_be_it() -> None:
    """Under one load direction the sum alone shows: a stuck check valve must not make a sure leakage."""
    fault = {"fault": "check_valve_stuck_open", "severity": 0.4, "onset": 8.0, "side": 1}
    simulation = run(24.0, MOVES, 1, load={"name": "constant", "level": 1500.0}, faults=[fault])
    f = Followed(simulation)
    seen, std = f.seen["leakage"], f.stds["leakage"]
    truth = np.interp(f.time, simulation.truth.time, simulation.truth["leakage"])
    wrong = np.abs(f.values["leakage"] - truth) > 3.0 * std
    assert seen.valid[(f.time > 5.0) & (f.time < 8.0)].mean() > 0.8
    assert not seen.valid[(f.time > 9.0) & (f.time < 14.0)].any()
    assert (wrong & seen.valid & (f.time > 5.0)).mean() < 0.01
    before, after = np.searchsorted(f.time, (7.9, 10.0))
    assert seen.held[after] == pytest.approx(truth[after], rel=0.1)
    assert seen.held_std[after] > std[before]


def standstill_blocks(simulation: Simulation, noise: np.ndarray, until: float) -> Any:
    """The last 20 s over and over, without seams, each time with fresh noise of the sensors."""
    truth, rng = simulation.truth, np.random.default_rng(8)
    n, start = 20_000, simulation.samples.time[-1]
    columns = {
        layout.POSITION: "position", layout.ANGLE: "pump_angle", layout.PRESSURE_1: "pressure_1",
        layout.PRESSURE_2: "pressure_2", layout.DIFFERENCE: "pressure_difference",
        layout.ACCUMULATOR: "pressure_accumulator",
    }  # fmt: skip
    for k in range(round((until - start) / 20.0)):
        block = np.full((n, layout.COLUMNS), np.nan)
        block[:, layout.TIME] = start + 20.0 * k + 1e-3 * np.arange(1, n + 1)
        block[:, layout.VISCOSITY] = noise[-1, layout.VISCOSITY]
        for column, name in columns.items():
            last = truth[name][-n:]
            step = last[-1] - truth[name][-n - 1]  # over the 20 s
            # The pump goes on turning against the leakage.
            turned = k if name == "pump_angle" else -np.arange(1, n + 1) / n
            sensor = unit().sensor(name)
            rough = last + step * (turned + 1.0) + sensor.noise * rng.normal(size=n)
            if sensor.resolution:
                rough = np.round(rough / sensor.resolution) * sensor.resolution
            block[:, column] = rough
        yield block


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "load", "until"),
    [("ekf", {"name": "constant", "level": 1500.0}, 3600.0), ("svsf", {"name": "none"}, 300.0)],
)
def test_an_hour_at_standstill_moves_no_estimate_by_more_than_one_std(method, load, until):
    simulation = run(60.0, MOVES, load=load)
    f = Followed(simulation, method)
    rest = int(np.searchsorted(f.time, 20.0))
    settled = {name: value[rest] for name, value in f.values.items()}
    held = {name: f.watch.latest()[name].held[0] for name in OBSERVABLE}
    invalid = [name for name in OBSERVABLE if not f.watch.latest()[name].valid[0]]
    assert "bulk_modulus" in invalid and "coulomb_friction" in invalid
    most = dict.fromkeys(OBSERVABLE, 0.0)
    for block in standstill_blocks(simulation, f.tracking.block(simulation.samples), until):
        f.push(block)
        for name, value in f.values.items():
            most[name] = max(most[name], float((np.abs(value - settled[name]) / f.stds[name]).max()))
    assert f.time[-1] == pytest.approx(until, abs=0.1)
    assert max(most.values()) < 1.0, most
    for name in ("bulk_modulus", "coulomb_friction"):
        seen = f.watch.latest()[name]
        assert not seen.valid[0]
        assert seen.held[0] == held[name]
        assert seen.age[0] > until - 60.0
        assert seen.information_std[0] > 100.0 * f.stds[name][-1]
