"""Healthy recordings of a real machine are quiet, and what is done to them is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bench_runs import bench_run
from numpy.typing import NDArray

from fdd.logs import ChannelMap
from fdd.samples import Samples
from fdd.sensors import SensorFinding, SensorWatch
from fdd.unit import Unit

pytestmark = pytest.mark.slow
Columns = dict[str, NDArray[np.float64]]
RUNS = ("session_18oct/exp_data_5_3.csv", "session_18oct/exp_data_1_1.csv", "session_17oct/test2.csv")
AT_REST = 14.3


def watched(samples: Samples, unit: Unit) -> tuple[list[SensorFinding], Samples]:
    watch = SensorWatch(unit)
    out = watch.push(samples)
    return watch.findings(), out


def broken(samples: Samples, change: Callable[[Columns, slice], None], at: float) -> Samples:
    columns = {n: v.copy() for n, v in samples.columns.items()}
    change(columns, slice(int(np.searchsorted(samples.time, at)), None))
    columns["pressure_difference"] = columns["pressure_1"] - columns["pressure_2"]
    return Samples(samples.time, columns)


def test_healthy_runs_are_quiet(bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap) -> None:
    runs = sorted(p for s in ("session_17oct", "session_18oct") for p in (bench_folder / s).glob("*.csv"))
    assert len(runs) == 26
    loud = {p.name: f for p in runs if (f := watched(bench_run(p, bench_map), bench_unit)[0])}
    assert not loud


def test_bursts_of_the_angle_sensor_are_spikes(
    bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap
) -> None:
    for path in sorted((bench_folder / "session_15oct").glob("*.csv")):
        samples = bench_run(path, bench_map)
        found, out = watched(samples, bench_unit)
        spikes = [f for f in found if (f.channel, f.kind) == ("pump_angle", "spikes")]
        assert len(spikes) == 1, path.name
        row = int(np.searchsorted(samples.time, spikes[0].onset_s))
        step = np.abs(np.diff(samples["pump_angle"][row - 1 : row + 2])).max()
        # Rows that go a third of a turn in a millisecond are taken out at once, the others are told.
        assert step < 1.0 or np.isnan(out["pump_angle"][row])


def dead(columns: Columns, rows: slice) -> None:
    columns["pressure_1"][rows] = 0.0


def stuck(columns: Columns, rows: slice) -> None:
    columns["pressure_2"][rows] = columns["pressure_2"][rows][0]


def saturated(columns: Columns, rows: slice) -> None:
    columns["pressure_1"][rows] = 25.5e6


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [0.0, 6.3, AT_REST])
@pytest.mark.parametrize(
    ("change", "channel", "kind"),
    [(dead, "pressure_1", "dead"), (stuck, "pressure_2", "stuck"), (saturated, "pressure_1", "saturated")],
)
def test_silent_pressure_is_named_and_taken_out(
    bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap, run: str, at: float,
    change: Callable[[Columns, slice], None], channel: str, kind: str,
) -> None:  # fmt: skip
    samples = broken(bench_run(bench_folder / run, bench_map), change, at)
    found, out = watched(samples, bench_unit)
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
@pytest.mark.parametrize("step", [1.05e-3, -0.55e-3, 1e-3])
def test_encoder_step_is_a_slip(
    bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap, run: str, at: float, step: float
) -> None:
    def slip(columns: Columns, rows: slice) -> None:
        columns["position"][rows] += step

    found, _ = watched(broken(bench_run(bench_folder / run, bench_map), slip, at), bench_unit)
    assert [(f.channel, f.kind, f.fault) for f in found] == [("position", "slip", "position_sensor_slip")]
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    assert found[0].size == pytest.approx(abs(step), abs=50e-6), "two counts of 25 µm"


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [6.3, AT_REST])
def test_bias_of_30_bar_is_a_step_of_the_loaded_chamber(
    bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap, run: str, at: float
) -> None:
    def bias(columns: Columns, rows: slice) -> None:
        columns["pressure_1"][rows] += 3e6

    found, _ = watched(broken(bench_run(bench_folder / run, bench_map), bias, at), bench_unit)
    assert [(f.channel, f.kind, f.fault) for f in found] == [("pressure_1", "step", "pressure_sensor_bias")]
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    # The pressure has 0.65 bar of noise, and more while the pump turns.
    assert found[0].size == pytest.approx(3e6, abs=0.6e6)


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("at", [6.3, AT_REST])
def test_lost_supply_is_one_finding(
    bench_folder: Path, bench_unit: Unit, bench_map: ChannelMap, run: str, at: float
) -> None:
    def lost(columns: Columns, rows: slice) -> None:
        for name in ("pressure_1", "pressure_2", "position", "pump_angle"):
            columns[name][rows] = 0.0

    found, out = watched(broken(bench_run(bench_folder / run, bench_map), lost, at), bench_unit)
    assert [f.kind for f in found] == ["supply_loss"]
    assert set(found[0].channels) == {"pressure_1", "pressure_2", "position", "pump_angle"}
    assert found[0].onset_s == pytest.approx(at, abs=0.05)
    assert all(np.isnan(out[n][-1]) for n in found[0].channels)
