"""Twins: each faulty log once more without its faults, to the last bit; what the faults do, over noise."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_generate import contents, small

from fdd.campaign.dataset import Dataset, Entry
from fdd.campaign.generate import generate
from fdd.campaign.recipe import Recipe
from fdd.campaign.visibility import (
    largest_rms,
    noise_deviation,
    visibility,
    visibility_class,
)
from fdd.errors import InputError
from fdd.plant.faults.spec import SIMULATED
from fdd.plant.sensors import MEASURED, Recorder, Recording
from fdd.samples import Samples
from fdd.unit import Unit

SENSOR_FAULTS = ("position_sensor_slip", "pressure_sensor_bias", "pressure_sensor_drift", "sensor_dropout")
FEW = ["pump_angle", "position", "pressure_difference", "motor_current"]


def with_twins(**fields: object) -> Recipe:
    """Short logs, all of them faulty."""
    return small(
        **{"duration": [3.0, 3.0], "healthy_share": 0.0, "onset": [0.3, 0.6], "twins": True, **fields}
    )


def all_kinds() -> Recipe:
    """Each fault of the catalogue at least once, on machines of three rates."""
    rates = [{"name": f"r{r}", "rate": r, "speed": s, "channels": c} for r, s, c in
             ((200, "sampled", FEW), (1000, "counts", None), (2000, "sampled", None))]  # fmt: skip
    return with_twins(
        units=3, logs_per_unit=7, faults={f: {} for f in SIMULATED}, structures=rates, at_start_share=0.15,
        profiles={"step": 1, "ramp": 1, "intermittent": 1},
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return Dataset.load(generate(all_kinds(), tmp_path_factory.mktemp("twins") / "set"))


def twin_of(data: Dataset, entry: Entry) -> Samples:
    twin = data.twin(entry)
    assert twin is not None
    return twin


def same_bits(one: Samples, other: Samples, rows: slice = slice(None)) -> bool:
    columns = [(one.time, other.time), *((one[c], other[c]) for c in one.channels)]
    return one.channels == other.channels and all(a[rows].tobytes() == b[rows].tobytes() for a, b in columns)


def rows_before(data: Dataset, entry: Entry) -> int:
    """Rows before anything was wrong, which have to be the same in both."""
    log, twin = data.samples(entry), twin_of(data, entry)
    rows = int(np.searchsorted(log.time, min(f.onset_s for f in entry.faults)))
    assert same_bits(log, twin, slice(rows)), entry.file
    assert np.array_equal(log.time, twin.time)
    return rows


def test_a_log_of_any_fault_is_its_twin_to_the_last_bit_before_the_onset(made: Dataset) -> None:
    assert {f.fault for e in made.logs for f in e.faults} == set(SIMULATED)
    before = {e.file: rows_before(made, e) for e in made.logs}
    first = [e for e in made.logs if not before[e.file]]
    assert first and all(e.faults[0].onset_s == 0.0 for e in first), "faults from the first sample"
    assert {e.structure for e in made.logs if before[e.file]} == {"r200", "r1000", "r2000"}
    assert min(n for n in before.values() if n) > 0.29 * 3.0 * 200.0 * 0.97
    changed = [not same_bits(made.samples(e), twin_of(made, e)) for e in made.logs]
    assert sum(changed) >= len(made.logs) - 3, "nearly every fault leaves some trace in some bit"


def test_a_fault_of_severity_nothing_changes_nothing(tmp_path: Path) -> None:
    recipe = with_twins(units=1, logs_per_unit=5, severity=[0.0, 0.0], at_start_share=0.5,
                        faults={f: {} for f in ("seal_wear", *SENSOR_FAULTS)})  # fmt: skip
    data = Dataset.load(generate(recipe, tmp_path / "set"))
    for entry in data.logs:
        assert entry.twin is not None and entry.visibility
        assert (data.directory / entry.twin).read_bytes() == (data.directory / entry.file).read_bytes()
        assert entry.visible is False and entry.largest_rms == 0.0
        assert {(v.rms, v.peak, v.lost) for v in entry.visibility.values()} == {(0.0, 0.0, 0.0)}


def test_without_twins_nothing_changes_and_with_them_no_log_does(tmp_path: Path) -> None:
    fields: dict[str, object] = {"units": 1, "logs_per_unit": 2, "healthy_share": 0.5}
    plain = generate(with_twins(**fields, twins=False), tmp_path / "plain")
    twins = generate(with_twins(**fields), tmp_path / "twins")
    without, having = contents(plain), contents(twins)
    assert not [name for name in without if "twin" in name]
    assert b"twin" not in b"".join(without[n] for n in ("recipe.yaml", "labels.json", "README.md"))
    assert {n for n in having if n not in without} == {"unit_000/twin_000.parquet"} or {
        n for n in having if n not in without
    } == {"unit_000/twin_001.parquet"}, "of the faulty log alone"
    assert all(having[n] == without[n] for n in without if n.startswith("unit_000/"))
    assert b"twin_00" in having["SHA256SUMS"]
    new = {"twin", "visibility", "largest_rms", "visible"}
    for before, after in zip(
        json.loads(without["labels.json"]), json.loads(having["labels.json"]), strict=True
    ):
        assert {k: v for k, v in after.items() if k not in new} == before
        assert set(after) - set(before) == (new if before["faults"] else {"twin"})
    data = Dataset.load(plain)
    assert all(e.twin is None and e.visibility is None and data.twin(e) is None for e in data.logs)
    Dataset.load(twins).check()
    with pytest.raises(InputError, match="another recipe"):
        generate(with_twins(**fields), plain)


def test_noise_is_what_sensors_show_beside_a_smooth_motion() -> None:
    """A pump that gathers speed, a piston that creeps, pressures that rise: all else in the log is noise."""
    unit, recording = Unit.load("axis_a"), Recording.perfect()
    unit = unit.model_copy(update={"sensors": {
        name: sensor.model_copy(update={"shaft_orders": [], "bandwidth_hz": None})
        for name, sensor in unit.sensors.items()
    }})  # fmt: skip
    n = 60_000
    time = np.arange(n) * 1e-3
    slope = {"pump_angle": time, "position": 7.31e-4, "motor_current": 0.01, "oil_temperature": 0.07}
    truth = {name: slope.get(name, 2.7e4) * time for name in MEASURED}
    shown = Recorder(unit, [], recording, seed=5).measure({**truth, "command": 0.0 * time}, time).columns
    assert noise_deviation(unit, "command", recording) == 0.0
    for name in (*MEASURED[:-1], "pump_speed"):
        error = (shown[name] - np.polyval(np.polyfit(time, shown[name], 2), time))[1:]
        assert noise_deviation(unit, name, recording) == pytest.approx(error.std(), rel=0.03), name


def test_visibility_is_what_the_hand_gets() -> None:
    unit, recording, gap = Unit.load("axis_a"), Recording(), np.nan
    time = np.arange(5) * 1e-3
    log = {"pressure_1": [0.0, 3e3, -6e3, gap, gap], "command": [1.0] * 5, "position": [1e-3] * 5,
           "pump_speed": [50.0, 50.0, 50.0, 50.0, 60.0]}  # fmt: skip
    twin = {**log, "pressure_1": [0.0, 0.0, 0.0, 0.0, gap], "pump_speed": [50.0] * 5, "command": [0.0] * 5}
    found = visibility(Samples(time, log), Samples(time, twin), unit, recording)
    assert set(found) == {"pressure_1", "position", "pump_speed"}
    noise = np.sqrt(3e3**2 + 263.5**2 / 12.0)
    pressure = found["pressure_1"]
    assert pressure.noise == pytest.approx(noise, rel=1e-5)
    assert pressure.rms == pytest.approx(np.sqrt((3e3**2 + 6e3**2) / 3) / noise, rel=1e-5)
    assert pressure.peak == pytest.approx(6e3 / noise, rel=1e-5)
    assert pressure.lost == pytest.approx(0.2), "the row that the twin lacks too is not the fault's"
    counts = 2.0 * np.pi / (4 * 16384) / 1e-3 / np.sqrt(6.0)
    assert found["pump_speed"].rms == pytest.approx(10.0 / np.sqrt(5.0) / counts, rel=1e-4)
    assert largest_rms(found) == pressure.rms and visibility_class(found) == "1 to 3"
