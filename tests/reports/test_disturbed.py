"""Disturbed logs: each is the same log but for what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.findings import Diagnosis, FaultFinding, Quality
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit
from reports import disturbed

RATE = 1000


@pytest.fixture(scope="module")
def log() -> Samples:
    """Twelve seconds of smooth motion and unlike pressures."""
    time = 3.0 + np.arange(12 * RATE) / RATE
    angle = 80.0 * np.sin(2.0 * time) + time
    columns = {
        "position": 2e-5 * angle, "pump_angle": angle, "pump_speed": 160.0 * np.cos(2.0 * time) + 1.0,
        "pressure_1": 1e6 + 2e5 * np.sin(3.0 * time), "pressure_2": 8e5 + 1e5 * np.cos(5.0 * time),
        "pressure_difference": 2e5 + 3e5 * np.sin(4.0 * time), "oil_temperature": 40.0 + 0.01 * time,
    }  # fmt: skip
    return Samples(time, columns)


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def rows_of(part: Samples, whole: Samples) -> np.ndarray:
    """Which rows of a log a part has, unchanged."""
    at = np.searchsorted(whole.time, part.time)
    np.testing.assert_array_equal(whole.time[at], part.time)
    for name in whole.channels:
        np.testing.assert_array_equal(part[name], whole[name][at])
    return at


def test_a_hole_is_fifty_milliseconds_inside_the_log(log: Samples) -> None:
    for seed in range(5):
        at = rows_of(disturbed.holed(log, np.random.default_rng(seed)), log)
        gone = np.setdiff1d(np.arange(len(log)), at)
        assert gone.size == pytest.approx(50, abs=1) and (np.diff(gone) == 1).all()
        assert gone[0] > 0 or gone[-1] < len(log) - 1


def test_other_units_of_measure_are_the_same_but_for_rounding(log: Samples) -> None:
    other = disturbed.converted(log, rng())
    np.testing.assert_allclose(other.time, log.time, rtol=1e-12)
    for name in log.channels:
        np.testing.assert_allclose(other[name], log[name], rtol=1e-12)  # of psi the reader has 13 digits
    assert any((other[name] != log[name]).any() for name in PRESSURES if name in log.channels)


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_at_another_rate_it_is_the_same_motion(log: Samples, rate: float) -> None:
    other = disturbed.at_rate(rate)(log, rng())
    assert other is not None
    step = max(1.0 / rate, 1e-3)  # the reader makes means of a faster log
    np.testing.assert_allclose(np.diff(other.time)[:-1], step, atol=1e-9)
    assert other.time[0] == pytest.approx(log.time[0], abs=step)
    assert other.time[-1] > log.time[-1] - 2.0 * step
    for name in ("position", "pressure_1", "oil_temperature"):
        right = np.interp(other.time, log.time, log[name])
        np.testing.assert_allclose(other[name], right, rtol=1e-6, atol=1e-6 * np.ptp(log[name]), err_msg=name)
    turned = np.cumsum(other["pump_speed"][1:] * np.diff(other.time))
    np.testing.assert_allclose(turned, other["pump_angle"][1:] - other["pump_angle"][0], atol=0.2)


def test_slow_pressures_alone_are_held(log: Samples) -> None:
    other = disturbed.slow_pressures(log, rng())
    assert other is not None and len(other) == len(log)
    np.testing.assert_allclose(other["position"], log["position"], rtol=1e-12)
    for name in ("pressure_1", "pressure_2", "pressure_difference"):
        known = np.flatnonzero(np.isfinite(other[name]))
        every = known[known % 5 == 0]
        assert every.size > 0.9 * len(log) / 5, "a new value each 5 ms"
        np.testing.assert_allclose(other[name][every], log[name][every], rtol=1e-12)
        fresh = np.setdiff1d(known, every)
        assert np.array_equal(other[name][fresh], other[name][fresh - fresh % 5]), "and none in between"
    coarse = Samples(log.time[::5], {n: log[n][::5] for n in log.channels})
    assert disturbed.slow_pressures(coarse, rng()) is None


def test_seen_from_the_other_end_motion_turns_and_chambers_swap(log: Samples) -> None:
    other = disturbed.mirrored(log)
    np.testing.assert_array_equal(other["pressure_1"], log["pressure_2"])
    np.testing.assert_array_equal(other["pressure_2"], log["pressure_1"])
    for name in ("position", "pump_angle", "pump_speed", "pressure_difference"):
        np.testing.assert_array_equal(other[name], -log[name])
    np.testing.assert_array_equal(other["oil_temperature"], log["oil_temperature"])
    back = disturbed.mirrored(other)
    assert all(np.array_equal(back[name], log[name]) for name in log.channels)
    bare = Samples(log.time, {"pressure_1": log["pressure_1"]})
    np.testing.assert_array_equal(disturbed.mirrored(bare)["pressure_1"], log["pressure_1"])


def answer(verdict: str, *faults: tuple[str, float, str]) -> Diagnosis:
    said = [
        FaultFinding(
            fault=f, family="leakage", ambiguity=[f, other], confidence=0.9, onset_s=onset, detected_s=9.0,
        )
        for f, onset, other in faults
    ]  # fmt: skip
    return Diagnosis(
        log="", axis="", unit="", duration_s=1.0, samples=1, verdict=verdict, faults=said, probabilities={},
        estimates={}, quality=Quality(),
    )  # fmt: skip


def test_answers_are_compared_by_verdict_leading_group_and_onset() -> None:
    leak, other = ("internal_leakage", 10.0, "pump_wear"), ("pump_wear", 10.9, "case")
    healthy, faulty = answer("healthy"), answer("faulty", leak)
    assert disturbed._same(healthy, healthy) == (True, True, True)
    assert disturbed._same(healthy, faulty) == disturbed._same(faulty, healthy) == (False, False, False)
    assert disturbed._same(faulty, answer("faulty", other)) == (True, True, True)
    assert disturbed._same(answer("faulty", other), faulty) == (True, True, True)
    assert disturbed._same(faulty, answer("inconclusive", ("aeration", 11.2, "x"))) == (False, False, False)
    late = answer("faulty", ("internal_leakage", 11.1, "x"), leak)
    assert disturbed._same(faulty, late) == (True, True, False), "the leading one's"


def test_the_table_has_each_disturbances_logs() -> None:
    compared = [
        disturbed.Comparison(unit, "200 Hz", healthy=False, verdict=True, fault=unit != "b", onset=False)
        for unit in ("a", "b", "c", "d")
    ]
    text = disturbed.table(compared)
    row = next(line for line in text.splitlines() if line.startswith("| 200 Hz"))
    assert "| 4 |" in row and row.count("of 4") == 3
    assert [c.split()[0] for c in row.split("|")[3:6]] == ["1.00", "0.75", "0.00"]
    assert "4 units" in text and text.count("| - of 0") == 3 * (len(disturbed.DISTURBANCES) - 1)


def test_a_mirrored_profile_has_its_ends_swapped(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the mirrored mirror is the profile itself."""
    monkeypatch.setattr(disturbed, "add_baseline", lambda unit, logs: unit)
    unit = Unit.load("axis_a")
    c = unit.cylinder
    unit.cylinder = c.model_copy(update={"area_2": 0.9 * c.area_1, "volume_2": 1.3 * c.volume_1})
    for name, zero in (("position", 1e-3), ("pressure_1", 5e3)):
        unit.sensors[name] = unit.sensor(name).model_copy(update={"zero": zero})
    turned = disturbed.mirrored_unit(unit, [])
    assert turned.cylinder.area_1 == unit.cylinder.area_2 and turned.cylinder.area_2 == unit.cylinder.area_1
    assert turned.cylinder.volume_1 == unit.cylinder.volume_2
    assert turned.friction.forward == unit.friction.reverse
    assert turned.sensor("position").zero == -1e-3 and turned.sensor("pressure_2").zero == 5e3
    assert disturbed.mirrored_unit(turned, []) == unit
