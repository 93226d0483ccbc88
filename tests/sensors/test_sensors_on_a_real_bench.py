"""Healthy recordings of a real machine are quiet, and what is done to them is named."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fdd import Samples, Unit
from fdd.logs import ChannelMap, read_log
from fdd.sensors import SensorFinding, SensorWatch

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
RUNS = ("session_18oct/exp_data_5_3.csv", "session_18oct/exp_data_1_1.csv", "session_17oct/test2.csv")
AT_REST = 14.3
SUPPLIED = ("pressure_1", "pressure_2", "position", "pump_angle")
Recorded = Callable[[str], Samples]


@pytest.fixture(scope="module")
def recorded(bench: Path, bench_map: ChannelMap) -> Recorded:
    """One recording in SI, read once."""
    return cache(lambda run: read_log(bench / run, bench_map).samples)


def watched(samples: Samples) -> tuple[list[SensorFinding], Samples]:
    watch = SensorWatch(Unit.load(ROOT / "examples" / "bench.base.yaml"))
    out = watch.push(samples)
    return watch.findings(), out


def changed(
    samples: Samples, at: float, *channels: str, value: float | None = None, add: float = 0.0
) -> Samples:
    """From `at` (s) on `value`, or what stood there plus `add`; Δp is made of both pressures."""
    columns, first = {n: v.copy() for n, v in samples.columns.items()}, int(np.searchsorted(samples.time, at))
    for channel in channels:
        columns[channel][first:] = columns[channel][first:] + add if value is None else value
    columns["pressure_difference"] = columns["pressure_1"] - columns["pressure_2"]
    return Samples(samples.time, columns)


def test_healthy_runs_are_quiet(bench: Path, recorded: Recorded) -> None:
    runs = sorted(bench.glob("session_1[78]oct/*.csv"))
    assert len(runs) == 26
    assert not {run: f for run in runs if (f := watched(recorded(run))[0])}


def test_bursts_of_the_angle_sensor_are_spikes(bench: Path, recorded: Recorded) -> None:
    for run in sorted(bench.glob("session_15oct/*.csv")):
        samples = recorded(run)
        found, out = watched(samples)
        spikes = [f for f in found if (f.channel, f.kind) == ("pump_angle", "spikes")]
        assert len(spikes) == 1, run
        row = int(np.searchsorted(samples.time, spikes[0].onset_s))
        step = np.abs(np.diff(samples["pump_angle"][row - 1 : row + 2])).max()
        # Rows that go a third of a turn in a millisecond are taken out at once, the others are told.
        assert step < 1.0 or np.isnan(out["pump_angle"][row])


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [0.0, 6.3, AT_REST])
@pytest.mark.parametrize(
    ("channel", "value", "kind"),
    [("pressure_1", 0.0, "dead"), ("pressure_2", np.nan, "stuck"), ("pressure_1", 25.5e6, "saturated")],
)
def test_silent_pressure_is_named_and_taken_out(recorded, run, at, channel, value, kind):
    samples = recorded(run)
    if kind == "stuck":
        value = float(samples[channel][np.searchsorted(samples.time, at)])
    samples = changed(samples, at, channel, value=value)
    found, out = watched(samples)
    assert [(f.channel, f.kind, f.fault) for f in found] == [(channel, kind, "sensor_dropout")]
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    # Of a channel that never lived the pump has to turn first, which it does within 5 s here.
    assert found[0].detected_s <= (5.0 if at == 0.0 else at + 1.0)
    after = samples.time >= found[0].detected_s
    assert np.isnan(out[channel][after]).all()
    assert np.isnan(out["pressure_difference"][after]).all(), "made of both pressures, it fails with one"
    assert np.isfinite(out["position"]).all()


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [6.3, AT_REST])
@pytest.mark.parametrize(
    ("channel", "step", "kind", "fault", "within"),
    [
        # Two counts of 25 µm; the pressure has 0.65 bar of noise, and more while the pump turns.
        *(("position", s, "slip", "position_sensor_slip", 50e-6) for s in (1.05e-3, -0.55e-3, 1e-3)),
        ("pressure_1", 3e6, "step", "pressure_sensor_bias", 0.6e6),
    ],
)
def test_a_step_is_that_of_an_encoder_or_of_the_loaded_chamber(
    recorded: Recorded, run: str, at: float, channel: str, step: float, kind: str, fault: str, within: float
) -> None:
    found, _ = watched(changed(recorded(run), at, channel, add=step))
    assert [(f.channel, f.kind, f.fault) for f in found] == [(channel, kind, fault)]
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    assert found[0].size == pytest.approx(abs(step), abs=within)


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [6.3, AT_REST])
def test_lost_supply_is_one_finding(recorded: Recorded, run: str, at: float) -> None:
    found, out = watched(changed(recorded(run), at, *SUPPLIED, value=0.0))
    assert [f.kind for f in found] == ["supply_loss"]
    assert set(found[0].channels) == set(SUPPLIED)
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    assert all(np.isnan(out[n][-1]) for n in found[0].channels)
