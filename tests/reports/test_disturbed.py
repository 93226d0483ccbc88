"""Disturbed logs: each is the same log but for what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.findings import Diagnosis, FaultFinding, Quality
from fdd.samples import Samples
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
