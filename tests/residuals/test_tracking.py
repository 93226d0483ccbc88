"""What the filters take from a profile; the tracker of a package: fed, believed and ended as it should be."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from estimators.eha.layout import Noise
from fdd.packages import TRACKERS, Addition
from fdd.residuals import added_tracker
from fdd.residuals.added_tracker import AddedTracker, Tracker
from fdd.residuals.bins import BIN_S, COLUMNS, FRAME_BINS
from fdd.residuals.tracking import gain_spread, noise_of
from fdd.unit import Unit
from tests.refusal import refused


def test_noise_that_a_profile_sets_goes_before_what_is_argued() -> None:
    plain = Unit.load("axis_a")
    assert plain.estimation is None and "estimation" not in plain.to_yaml()
    own = Unit.from_yaml(plain.to_yaml() + "estimation: {flow: 3.0e-7}\n")
    again = Unit.from_yaml(own.to_yaml())
    assert noise_of(plain).flow == Noise().flow
    assert noise_of(own).flow == noise_of(again).flow == pytest.approx(3.0e-7)
    assert noise_of(own).leakage == noise_of(plain).leakage


def test_what_a_count_rounds_to_is_noise_of_its_own() -> None:
    unit, rng = Unit.load("axis_a"), np.random.default_rng(1)
    for channel, noise in (("position", 2e-5), ("pump_angle", 0.004)):
        step, true = 4.0 * noise, rng.uniform(0.0, 1000.0 * noise, 100_000)
        coarse = {"noise": noise, "resolution": step}
        unit.sensors[channel] = unit.sensor(channel).model_copy(update=coarse)
        seen = np.round((true + noise * rng.normal(size=true.size)) / step) * step
        found = getattr(noise_of(unit), channel.removeprefix("pump_"))
        assert found == pytest.approx(np.std(seen - true), rel=0.02)


def test_a_sensor_without_noise_has_the_usual_one() -> None:
    """A filter that believes a sensor wholly divides by nothing."""
    unit, usual = Unit.load("axis_a"), Noise()
    for channel in ("pressure_1", "pressure_2", "pressure_difference", "position", "pump_angle"):
        still = {"noise": 0.0, "resolution": 0.0}
        unit.sensors[channel] = unit.sensor(channel).model_copy(update=still)
    found = noise_of(unit)
    for name in ("pressure", "pressure_difference", "position", "angle"):
        assert getattr(found, name) == getattr(usual, name) > 0.0, name
    unit.sensors["pressure_1"] = unit.sensor("pressure_1").model_copy(update={"noise": 3e3})
    assert noise_of(unit).pressure == 3e3, "the worse of the two"
    assert noise_of(unit).relief_pressure < unit.accumulator.relief_pressure


def test_a_pumps_gain_is_as_sure_as_its_profile_says() -> None:
    """Relative, and never surer than thirty kelvin let it be: metals grow by some 2e-5 a kelvin."""
    plain = Unit.load("axis_a")
    assert gain_spread(plain) == noise_of(plain).initial_gain == Noise().initial_gain
    known = plain.pump.provenance["displacement"]
    for share, least, most in ((0.01, 0.01, 0.0101), (1e-6, 3e-4, 1e-3)):
        std = share * plain.pump.displacement
        plain.pump.provenance["displacement"] = known.model_copy(update={"std": std})
        assert least <= gain_spread(plain) <= most


UNIT = Unit.load("axis_a")
LEAK = 7e-12


def rows_of(frames: int) -> np.ndarray:
    """Rows of a piston that stands under pressure while the pump makes up for a leak."""
    rng = np.random.default_rng(3)
    rows = np.full((frames * FRAME_BINS, len(COLUMNS)), np.nan)
    drop = 1e6 * (1.0 + 0.3 * np.sin(np.arange(len(rows)) * 0.05))
    rows[:, COLUMNS["position"]] = 0.0
    rows[:, COLUMNS["pressure_difference"]] = drop
    rows[:, COLUMNS["pump_speed"]] = (LEAK * drop + 2e-7 * rng.standard_normal(len(rows))) / 5.57e-7
    return rows


class Recorder:
    """A filter of one state that notes what it is given."""

    def __init__(self, fails_at: int = -1) -> None:
        self.x, self.P = np.array([3.0]), np.array([[4.0]])
        self.inputs: list[Any] = []
        self.measured: list[Any] = []
        self.fails_at = fails_at

    def predict(self, u: Any = None) -> None:
        self.inputs.append(u)

    def update(self, z: Any) -> None:
        self.measured.append(z)
        if len(self.measured) == self.fails_at:
            self.x = np.array([np.nan])


def running(monkeypatch: pytest.MonkeyPatch, make: Any, name: str = "own") -> AddedTracker:
    """The tracker of a package whose factory is `make`."""
    point = SimpleNamespace(load=lambda: make, group=TRACKERS, value="made_up:make")
    monkeypatch.setattr(added_tracker, "additions", lambda group: [Addition(name, "made-up 1.0", point)])
    return AddedTracker(name, UNIT)


def kalman(unit: Unit, channels: tuple[str, ...], period: float) -> Tracker:
    """filterpy's own filter: flow of the pump over pressure drop, by recursion, is the leakage."""

    class Ratio(KalmanFilter):
        """Its measurement matrix is the drop, which is its second measurement."""

        def update(self, z: Any) -> None:
            if z is None:
                return
            drop, speed = z
            super().update(speed * unit.pump.displacement / 2e-7, H=np.array([[drop * 1e-12 / 2e-7]]))

    kf = Ratio(1, 1)
    kf.x, kf.P, kf.F, kf.Q, kf.R = np.array([[0.0]]), np.eye(1) * 100, np.eye(1), np.zeros((1, 1)), np.eye(1)
    return Tracker(kf, ("pressure_difference", "pump_speed"), {"leakage": lambda x: 1e-12 * x[0]})


def test_filterpys_filter_finds_the_leak_of_a_least_squares_fit(monkeypatch) -> None:
    rows = rows_of(20)
    tracker = running(monkeypatch, kalman)
    tracker.push(0, rows)
    value, std = tracker.last()["leakage"]
    drop, speed = (rows[:, COLUMNS[name]] for name in ("pressure_difference", "pump_speed"))
    flow = speed * UNIT.pump.displacement
    assert value == pytest.approx((drop @ flow) / (drop @ drop), rel=1e-4)
    assert std == pytest.approx(2e-7 / np.sqrt(drop @ drop), rel=1e-4)
    assert set(tracker.last()) == {"leakage"}


def test_it_says_the_same_however_the_rows_were_cut(monkeypatch) -> None:
    rows = rows_of(20)
    whole, parts = running(monkeypatch, kalman), running(monkeypatch, kalman)
    whole.push(4, rows)
    for frame in range(20):
        parts.push(4 + frame, rows[frame * FRAME_BINS : (frame + 1) * FRAME_BINS])
    assert whole.last() == parts.last()
    time = np.array([0.0, 2.005, 5.0, 13.0])
    for mine, other in zip(whole.over(time), parts.over(time), strict=True):
        np.testing.assert_array_equal(mine["leakage"], other["leakage"])
        assert np.isnan(mine["leakage"][[0, 3]]).all()  # before the first row, and after the last
        assert np.isfinite(mine["leakage"][[1, 2]]).all()


def test_one_that_fails_ends_alone_and_says_when(monkeypatch) -> None:
    made: list[Recorder] = []

    def make(unit: Unit, channels: tuple[str, ...], period: float) -> Tracker:
        assert (unit, period) == (UNIT, BIN_S)
        assert channels == ("pump_speed", "position", "pressure_difference")
        made.append(Recorder(31))
        quantities = {"bulk_modulus": lambda x: 1e8 * x[0] ** 2}
        return Tracker(made[-1], ("position", "pressure_difference"), quantities, ("pump_speed",))

    tracker = running(monkeypatch, make)
    tracker.push(0, rows_of(2))
    tracker.push(2, rows_of(1))
    assert tracker.problem == (
        "tracker own (made-up 1.0) stopped at 0.30 s (ArithmeticError: its state is no longer finite)"
    )
    assert tracker.last() == {} and len(made[0].measured) == 31
    np.testing.assert_array_equal(np.ravel(made[0].inputs), rows_of(2)[:31, COLUMNS["pump_speed"]])
    values, _ = tracker.over(np.array([0.1, 0.5]))
    assert np.isfinite(values["bulk_modulus"]).tolist() == [True, False]


def gives(measurements: tuple[str, ...], quantities: dict[str, Any]) -> Any:
    return lambda unit, channels, period: Tracker(Recorder(), measurements, quantities)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda unit, channels, period: None, "package made-up 1.0: fdd.trackers 'own': made a NoneType"),
        (lambda unit: None, "package made-up 1.0: fdd.trackers 'own': cannot be made (TypeError"),
        (gives(("pressure_1",), {"leakage": float}), "tracker own: needs pressure_1, which this log"),
    ],
)
def test_a_factory_that_gives_nothing_usable_is_refused(monkeypatch, make, problem) -> None:
    tracker = running(monkeypatch, make)
    assert refused(lambda: tracker.push(0, rows_of(1))).startswith(problem)


def test_names_that_are_not_there_or_ours_are_refused(monkeypatch) -> None:
    nobody = refused(lambda: AddedTracker("nobody", UNIT))
    assert nobody.startswith("no installed package has a tracker 'nobody'; ")
    assert "fdd's own" in refused(lambda: running(monkeypatch, kalman, "ekf"))
