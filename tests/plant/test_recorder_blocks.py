"""The recorder and its faults do not depend on how a run is cut, and do what their severity says."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors import Recorder, Recording, Rows, position_offset
from fdd.plant.sensors.faults import DROPOUTS, PLAY
from fdd.plant.sensors.recorder import KNOWN, MEASURED
from fdd.sensor import Sensor
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
# A sensor of every kind: a lag and band of each order of size, tones, shaft orders, a loop, a range.
BUSY = UNIT.model_copy(deep=True)
BUSY.sensors["pressure_1"] = Sensor(noise=3e3, bandwidth_hz=20.0, resolution=200.0, gain=1.01, zero=5e3)
BUSY.sensors["oil_temperature"] = Sensor(noise=0.1, bandwidth_hz=0.5)
BUSY.sensors["pump_speed"] = Sensor(noise=0.2, resolution=0.05, tones=[(50.0, 0.1)])
ROWS = 3000
TIME = np.arange(ROWS) * 1e-3
RECORDING = Recording(dropped=0.05, late=0.05, jitter=5e-6, nan_bursts_per_minute=60.0, load_force=True)


def fault(name: str, severity: float, **more: Any) -> FaultSpec:
    """A fault whether or not the catalogue has it as simulated already."""
    given = {"fault": name, "severity": severity, "onset": 0.2, "profile": "step", "ramp": 1.0, "period": 0.7}
    return FaultSpec.model_construct(**{**given, "duty": 0.5, "side": None, "variant": None, **more})


FAULTS = [
    fault("pressure_sensor_bias", 0.5, profile="ramp"),
    fault("pressure_sensor_drift", 0.7, profile="intermittent"),
    fault("position_sensor_slip", 0.8),
    fault("sensor_dropout", 0.3, variant="held", profile="intermittent"),
]


def plant(n: int = ROWS) -> dict[str, np.ndarray]:
    """Plausible truth of every channel."""
    rng, time = np.random.default_rng(0), np.arange(n) * 1e-3
    wave = np.sin(2.0 * np.pi * 0.8 * time)
    truth = {c: 1e5 * wave + 1e3 * np.cumsum(rng.standard_normal(n)) for c in MEASURED}
    truth |= {"pump_angle": 30.0 * (1.0 - wave), "position": 0.01 * wave, "oil_temperature": 40.0 + time}
    return truth | dict.fromkeys(KNOWN, 10.0 * wave)


TRUTH = plant()


def in_blocks(
    recorder: Recorder, truth: dict[str, np.ndarray], time: np.ndarray, edges: Iterable[int]
) -> Rows:
    """All rows measured between the edges, joined."""
    blocks = [
        recorder.measure({c: v[i:j] for c, v in truth.items()}, time[i:j])
        for i, j in pairwise([0, *sorted(edges), time.size])
    ]
    assert recorder.row == time.size
    return Rows(
        np.concatenate([b.time for b in blocks]),
        {c: np.concatenate([b.columns[c] for b in blocks]) for c in blocks[0].columns},
        np.concatenate([b.kept for b in blocks]),
    )


def recorded(edges: Iterable[int]) -> Rows:
    return in_blocks(Recorder(BUSY, FAULTS, RECORDING, seed=11), TRUTH, TIME, edges)


WHOLE = recorded([])


@given(st.lists(st.integers(0, ROWS), max_size=12))
def test_any_blocks_give_the_same_bits(edges: list[int]) -> None:
    cut = recorded(edges)
    assert list(cut.columns) == list(WHOLE.columns)
    assert cut.time.tobytes() == WHOLE.time.tobytes() and cut.kept.tobytes() == WHOLE.kept.tobytes()
    for channel, values in WHOLE.columns.items():
        assert cut.columns[channel].tobytes() == values.tobytes(), channel


def measured(n: int, spec: FaultSpec, unit: Unit = UNIT) -> dict[str, np.ndarray]:
    """Columns of a long run at rest with a fault."""
    recorder = Recorder(unit, [spec], Recording.perfect(), seed=2)
    return recorder.measure({c: np.zeros(n) for c in MEASURED}, np.arange(n) * 1e-3).columns


@pytest.mark.parametrize("severity", [0.05, 0.3, 0.7, 1.0])
def test_a_dropout_takes_the_share_of_time_that_its_severity_says(severity: float) -> None:
    spec = fault("sensor_dropout", severity, onset=0.0, variant="missing")
    lost = np.isnan(measured(600_000, spec)["pressure_difference"])
    # 0.1 s of memory: 3000 independent pieces, so the share is known to ±2.7 % of a unit (3 deviations).
    assert lost.mean() == pytest.approx(severity, abs=0.03)
    if severity < 1.0:
        bursts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
        assert lost.sum() * 1e-3 / bursts == pytest.approx(0.1 / (1.0 - severity), rel=0.25)


def test_what_a_dropout_leaves_in_the_log() -> None:
    n = 60_000
    found = {v: measured(n, fault("sensor_dropout", 0.5, variant=v)) for v in DROPOUTS}
    healthy = measured(n, fault("sensor_dropout", 0.0))
    lost = np.isnan(found["missing"]["pressure_difference"])
    assert not lost[:200].any()
    for variant, (channel, _) in DROPOUTS.items():
        for other in set(healthy) - {channel}:
            np.testing.assert_array_equal(found[variant][other], healthy[other])
    np.testing.assert_array_equal(np.isnan(found["position_missing"]["position"]), lost)
    # A broken loop carries no current: 4 mA below the live zero, thesis eq. A.4.
    broken = found["broken_loop"]["pressure_difference"]
    np.testing.assert_allclose(broken[lost], -1.724e6, rtol=2e-4)
    np.testing.assert_array_equal(broken[~lost], healthy["pressure_difference"][~lost])
    held, true = found["held"]["pressure_difference"], healthy["pressure_difference"]
    last_seen = np.maximum.accumulate(np.where(lost, 0, np.arange(n)))
    np.testing.assert_array_equal(held, true[last_seen])


def test_a_slip_jumps_once_a_second_by_a_millimetre_and_stays_in_its_play() -> None:
    spec = fault("position_sensor_slip", 1.0, onset=10.0)
    offset = position_offset([spec], 0, 3_600_000, seed=4)
    jumps = np.diff(offset)
    struck = np.flatnonzero(jumps)
    assert struck[0] >= 9_999 and np.abs(offset).max() <= PLAY
    # 3590 expected, deviation 60.
    assert abs(struck.size - 3590) < 240
    sizes = np.abs(jumps[struck])
    inside = np.abs(offset[struck]) < PLAY - 1.5e-3
    # Two slips within one millisecond add up; 3.6 are expected in 3600.
    assert np.sum((sizes[inside] < 0.499e-3) | (sizes[inside] > 1.501e-3)) <= 12
    assert sizes[inside].mean() == pytest.approx(1e-3, rel=0.05)
    assert 0.4 < (jumps[struck] > 0.0).mean() < 0.6
    # All over the play: a walk between walls is as often in one half as in the other.
    assert (offset > 0.0).mean() == pytest.approx(0.5, abs=0.2)
