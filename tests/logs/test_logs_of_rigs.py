"""Logs that we did not make, through the maps in examples/. Skipped where they are not at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import open_log
from fdd.logs.mapping import given_of, propose

EXAMPLES = Path(__file__).parents[2] / "examples"
REQUIRED = {"position", "pressure_difference", "pressure_1", "pressure_2"}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.map.yaml")), ids=lambda p: p.name)
def test_example_maps_are_valid(path: Path) -> None:
    assert set(ChannelMap.load(path).channels) >= REQUIRED - {"pressure_difference"}


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["rig1", "rig4"])
def test_every_rig_log_is_read(rig_logs: Path, rig: str) -> None:
    channel_map = ChannelMap.load(EXAMPLES / f"{rig}.map.yaml")
    paths = sorted((rig_logs / rig).iterdir())
    assert len(paths) >= 11
    for path in paths:
        log = read_log(path, channel_map)
        quality = log.quality
        assert set(log.samples.channels) >= REQUIRED and log.axis
        assert quality.period == 0.001 and quality.time_jumps == 0
        # The rigs' description: about 0.1 % of the rows are missing, some stamps are late.
        assert 0.0003 < quality.dropped_samples / len(log.samples) < 0.003
        assert quality.nan_samples < 0.01 * len(log.samples)
        assert np.abs(log.samples["position"]).max() < 0.16


@pytest.mark.parametrize("rig", ["rig1", "rig4"])
def test_pump_and_cylinder_agree_where_the_load_is_light(rig_logs: Path, rig: str) -> None:
    """Fast motion, a tenth of a second at a time, at low pressure (little leakage): the thesis's transmission
    D/A = 3.66e-4 m/rad within the rigs' spread, both ways, positive out."""
    baseline = next((rig_logs / rig).glob("baseline.*"))
    samples = read_log(baseline, EXAMPLES / f"{rig}.map.yaml").samples
    turned = samples["pump_angle"][100::100] - samples["pump_angle"][:-100:100]
    moved = samples["position"][100::100] - samples["position"][:-100:100]
    light = np.abs(samples["pressure_difference"][50::100][: turned.size]) < 4e5
    for direction in (1, -1):
        fast = light & (direction * turned > 4.0)
        assert fast.sum() > 20
        assert np.median(moved[fast] / turned[fast]) == pytest.approx(3.66e-4, rel=0.2)


SCALES = [
    "position=ADC1_Channel_14*0.025:mm", "pressure_1=ADC1_Channel_2*0.0625-0.625:bar",
    "pressure_2=ADC1_Channel_3*0.07576-18.333:bar",
]  # fmt: skip


@pytest.mark.slow
def test_the_map_of_every_third_healthy_bench_run_has_the_same_channels_and_signs(bench: Path) -> None:
    """Columns without names or units; the angle counts down, and the loop's rpm are 1.136 times those of the
    encoder's counts."""
    numbers = {"pump_angle": 6, "pump_speed": 10, "position": 14, "pressure_1": 2, "pressure_2": 3}
    columns = {channel: f"ADC1_Channel_{k}" for channel, k in numbers.items()}
    paths = sorted(p for s in ("session_17oct", "session_18oct") for p in (bench / s).glob("*.csv"))
    assert len(paths) == 26
    for path in paths[::3]:
        found = propose(open_log(path), given=given_of(SCALES))
        assert not found.questions, path.name
        sources = {c: found.rows[c].source for c in columns}
        assert {c: s.column for c, s in sources.items()} == columns, path.name
        angle, speed = sources["pump_angle"], sources["pump_speed"]
        assert (angle.sign, angle.wrap, angle.sign_of) == (-1, 4096.0, "ADC1_Channel_16"), path.name
        assert (speed.sign, speed.unit) == (1, "rpm") and speed.scale == pytest.approx(1.0 / 1.136, rel=2e-3)
        signs = {c: s.sign for c, s in sources.items() if c != "pump_angle"}
        assert set(signs.values()) == {1} and not any(s.delay for s in sources.values()), path.name
        if "command" in found.rows:
            assert found.rows["command"].source.column == "ADC1_Channel_9", path.name


def test_bench_signs_and_gains(bench: Path, bench_map: ChannelMap) -> None:
    """The unloaded 50 mm run goes out with positive pump motion and pressure in chamber 1, and back with
    negative motion and pressure in chamber 2."""
    samples = read_log(bench / "session_18oct" / "exp_data_1_4.csv", bench_map).samples
    out = (samples.time > 4.5) & (samples.time < 7.0)
    back = (samples.time > 12.5) & (samples.time < 15.0)
    gain = {}
    for name, rows, direction in (("out", out, 1), ("back", back, -1)):
        turned, moved = (np.ptp(samples[c][rows]) for c in ("pump_angle", "position"))
        assert direction * np.median(np.diff(samples["pump_angle"][rows])) > 0
        assert direction * (samples["position"][rows][-1] - samples["position"][rows][0]) > 0.02
        assert direction * samples["pressure_difference"][rows].mean() > 5e5
        gain[name] = moved / turned
    assert gain["out"] == pytest.approx(1.25e-4, rel=0.05)
    assert 1.35 < gain["back"] / gain["out"] < 1.55
