"""Generating data sets: the same whatever the workers, resumable, whole or recognisably not; their twins."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fdd import InputError, Samples, Unit
from fdd.campaign import generate as generate_module
from fdd.campaign.dataset import Dataset, digest, for_each_unit
from fdd.campaign.generate import generate
from fdd.campaign.labels import largest_rms, noise_deviation, visibility, visibility_class
from fdd.campaign.recipe import Recipe
from fdd.plant.faults import SIMULATED, FaultScales
from fdd.plant.oil import viscosity_ratio
from fdd.plant.sensors import MEASURED, Recorder
from fdd.plant.sensors.recording import Recording
from tests.refusal import refused

FOUR = ("internal_leakage", "seal_wear", "aeration", "check_valve_stuck_open")


def small(**fields: object) -> Recipe:
    given = {
        "schema": "fdd.recipe/1", "name": "small", "seed": 11, "units": 2, "logs_per_unit": 2,
        "duration": [3.0, 4.0], "healthy_share": 0.25, "severity": [0.6, 1.0],
        "faults": {f: {} for f in FOUR}, "baseline": False,
        # An orifice's leakage coefficient grows without bound as the pressure passes zero.
        "fault_scales": {**FaultScales.usual, "internal_leakage_orifice_share": [0.0, 0.0]}, **fields,
    }  # fmt: skip
    return Recipe(**given)


def contents(directory: Path) -> dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("made") / "set"
    return generate(small(baseline=True), directory)


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def test_layout_labels_and_truth_belong_together(made: Path) -> None:
    data = Dataset.load(made)
    assert data.units == ("unit_000", "unit_001")
    assert data.manifest.number == len(data.logs) == 4
    assert sum(e.healthy for e in data.logs) == 1
    assert {e.family for e in data.logs} <= {"healthy", "leakage", "seal_wear", "aeration", "check_valve"}
    assert not [name for name in contents(made) if Path(name).name.startswith(".")]
    for entry in data.logs:
        samples, truth = data.samples(entry), data.truth(entry)
        assert len(samples) == entry.samples
        assert samples.duration == pytest.approx(entry.duration_s, abs=1e-3)
        assert len(truth) == pytest.approx(entry.duration_s * 20.0, abs=2)
        assert set(truth.severity) == {f.fault for f in entry.faults}
        at = np.searchsorted(samples.time, truth.time - 1e-9)
        error = samples["position"][at] - truth["position"]
        assert np.nanmax(np.abs(error - np.nanmedian(error))) < 1e-5  # the same but for the encoder's zero
        assert abs(np.nanmedian(error)) <= 2e-3 + 1e-6
        unit = data.true_unit(entry.unit)
        healthy = unit.pump.total_leakage / float(viscosity_ratio(unit.oil, entry.scenario.oil_temperature))
        leaking = 12e-12 * entry.faults[0].severity if entry.family == "leakage" else 0.0
        ratio = healthy / unit.pump.total_leakage
        # A ramp's median is half its end; loose seals leak up to 1e-12 more.
        assert entry.truth_medians["leakage"] >= 0.98 * (healthy + 0.3 * leaking * ratio)
        assert entry.truth_medians["leakage"] <= 1.02 * (healthy + leaking * ratio) + 1e-12 * ratio
    for unit_name in data.units:
        assert [s.duration > 10.0 for s in data.baseline(unit_name)] == [True, True, True]
        assert [e.unit for e in data.logs_of(unit_name)] == [unit_name] * 2
        assert isinstance(data.true_unit(unit_name), Unit)


def interrupted(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Make the run after `after` others fail, as an interrupt would."""
    whole, calls = generate_module.make_run, []

    def run(*arguments: object) -> None:
        calls.append(arguments)
        if len(calls) > after:
            raise KeyboardInterrupt
        whole(*arguments)

    monkeypatch.setattr(generate_module, "make_run", run)


def test_an_interrupted_data_set_is_known_as_such_and_resumes(made, tmp_path, monkeypatch):
    recipe, directory = small(baseline=True), tmp_path / "set"
    with monkeypatch.context() as patch:
        interrupted(patch, after=6)
        with pytest.raises(KeyboardInterrupt):
            generate(recipe, directory)
    line = refused(lambda: Dataset.load(directory))
    assert "unfinished" in line and "fdd generate" in line
    (directory / "unit_000" / ".log_001.parquet.part").write_bytes(b"half a file")
    kept = {p: p.stat().st_mtime_ns for p in directory.rglob("*.parquet")}
    assert len(kept) == 6 + 2  # six runs, of which two have their truth
    generate(recipe, directory)
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in kept.items())
    assert contents(directory) == contents(made)


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert "not empty" in refused(lambda: generate(small(), tmp_path))
    assert "is a file" in refused(lambda: generate(small(), tmp_path / "notes.txt"))
    assert "0 workers" in refused(lambda: generate(small(), tmp_path / "set", workers=0))
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_runs_that_would_rest_at_a_limit_are_drawn_anew(tmp_path, monkeypatch):
    recipe = small(units=1, logs_per_unit=1)
    drawn = []
    look = generate_module._trouble

    def strict(run: generate_module.Simulation) -> str:
        drawn.append(run.scenario.seed)
        return "too good" if len(drawn) < 3 else look(run)

    monkeypatch.setattr(generate_module, "_trouble", strict)
    data = Dataset.load(generate(recipe, tmp_path / "set"))
    assert len(set(drawn)) == 3
    assert data.logs[0].scenario.seed == drawn[-1]
    monkeypatch.setattr(generate_module, "_trouble", lambda run: "never good")
    assert "never good" in refused(lambda: generate(recipe, tmp_path / "other"))


@pytest.mark.parametrize("name", ["labels.json", "recipe.yaml"])
def test_changed_labels_or_recipe_are_noticed(copy: Path, name: str) -> None:
    text = (copy / name).read_text(encoding="utf-8")
    (copy / name).write_text(text.replace("seal_wear", "seal_waer", 1) + " ", encoding="utf-8")
    assert "SHA-256" in refused(lambda: Dataset.load(copy))
    (copy / name).unlink()
    assert f"{name}: no such part of a data set" in refused(lambda: Dataset.load(copy))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "Invalid JSON"),
        ('{"schema": "fdd.dataset/9"}', "fdd.dataset/9"),
        ('{"schema": "fdd.dataset/1"}', "Field required"),
        ("[" * 100_000, "Invalid JSON"),
    ],
)
def test_a_damaged_manifest_is_refused(copy: Path, text: str, told: str) -> None:
    (copy / "manifest.json").write_text(text, encoding="utf-8")
    line = refused(lambda: Dataset.load(copy))
    assert told in line and "manifest.json" in line


def test_labels_cannot_point_out_of_the_folder(copy: Path) -> None:
    labels, manifest = (json.loads((copy / f).read_text("utf-8")) for f in ("labels.json", "manifest.json"))
    labels[0]["file"] = "../../etc/passwd"
    text = json.dumps(labels)
    manifest["sha256"] = digest((copy / "recipe.yaml").read_text("utf-8"), text)
    (copy / "labels.json").write_text(text, encoding="utf-8")
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    line = refused(lambda: Dataset.load(copy))
    assert "labels.json" in line and "file" in line


def test_damaged_files_and_unknown_units_are_told(copy: Path) -> None:
    data = Dataset.load(copy)
    entry = data.logs[0]
    whole = (copy / entry.truth).read_bytes()
    (copy / entry.truth).write_bytes(whole[: len(whole) // 2])
    assert "truth can't be read" in refused(lambda: data.truth(entry))
    (copy / entry.file).write_bytes(b"PAR1 nothing")
    assert "log_000.parquet" in refused(lambda: data.samples(entry))
    assert "unit_999" in refused(lambda: data.baseline("unit_999"))


UNITS = ["unit_000", "unit_001", "unit_002"]


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_unit_that_refuses_is_left_out_with_a_warning(workers: int) -> None:
    with pytest.warns(UserWarning, match=f"{UNITS[1]} left out: too short"):
        assert for_each_unit(one_refuses, UNITS, workers=workers) == [u for u in UNITS if u != UNITS[1]]
    with pytest.raises(InputError, match="too short"), pytest.warns(UserWarning, match="left out"):
        for_each_unit(one_refuses, UNITS[1:2], workers=workers)


def one_refuses(unit: str) -> list[str]:
    if unit == UNITS[1]:
        raise InputError("too short", mend="record more")
    return [unit]


SENSOR_FAULTS = ("position_sensor_slip", "pressure_sensor_bias", "pressure_sensor_drift", "sensor_dropout")
FEW = ["pump_angle", "position", "pressure_difference", "motor_current"]


def with_twins(**fields: object) -> Recipe:
    """Short logs, all of them faulty."""
    given = {"duration": [3.0, 3.0], "healthy_share": 0.0, "onset": [0.3, 0.6], "twins": True, **fields}
    return small(**given)


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Each fault of the catalogue at least once, on machines of three rates."""
    rates = [{"name": f"r{r}", "rate": r, "speed": s, "channels": c} for r, s, c in
             ((200, "sampled", FEW), (1000, "counts", None), (2000, "sampled", None))]  # fmt: skip
    recipe = with_twins(
        units=3, logs_per_unit=7, faults={f: {} for f in SIMULATED}, structures=rates, at_start_share=0.15,
        profiles={"step": 1, "ramp": 1, "intermittent": 1},
    )  # fmt: skip
    return Dataset.load(generate(recipe, tmp_path_factory.mktemp("twins") / "set"))


def same_bits(one: Samples, other: Samples, rows: slice = slice(None)) -> bool:
    columns = [(one.time, other.time), *((one[c], other[c]) for c in one.channels)]
    return one.channels == other.channels and all(a[rows].tobytes() == b[rows].tobytes() for a, b in columns)


def test_a_log_of_any_fault_is_its_twin_to_the_last_bit_before_the_onset(twins: Dataset) -> None:
    assert {f.fault for e in twins.logs for f in e.faults} == set(SIMULATED)
    before = {}
    for e in twins.logs:
        log, twin = twins.samples(e), twins.twin(e)
        before[e.file] = rows = int(np.searchsorted(log.time, min(f.onset_s for f in e.faults)))
        assert same_bits(log, twin, slice(rows)) and np.array_equal(log.time, twin.time), e.file
    first = [e for e in twins.logs if not before[e.file]]
    assert first and all(e.faults[0].onset_s == 0.0 for e in first), "faults from the first sample"
    assert {e.structure for e in twins.logs if before[e.file]} == {"r200", "r1000", "r2000"}
    assert min(n for n in before.values() if n) > 0.29 * 3.0 * 200.0 * 0.97
    changed = [not same_bits(twins.samples(e), twins.twin(e)) for e in twins.logs]
    assert sum(changed) >= len(twins.logs) - 3, "nearly every fault leaves some trace in some bit"


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
    paired = generate(with_twins(**fields), tmp_path / "twins")
    without, having = contents(plain), contents(paired)
    assert not [name for name in without if "twin" in name]
    assert b"twin" not in b"".join(without[n] for n in ("recipe.yaml", "labels.json", "README.md"))
    (added,) = having.keys() - without.keys()  # of the faulty log alone
    assert added in ("unit_000/twin_000.parquet", "unit_000/twin_001.parquet")
    assert all(having[n] == without[n] for n in without if n.startswith("unit_000/"))
    assert b"twin_00" in having["SHA256SUMS"]
    new = {"twin", "visibility", "largest_rms", "visible"}
    labels = (json.loads(files["labels.json"]) for files in (without, having))
    for before, after in zip(*labels, strict=True):
        assert {k: v for k, v in after.items() if k not in new} == before
        assert set(after) - set(before) == (new if before["faults"] else {"twin"})
    data = Dataset.load(plain)
    assert all(e.twin is None and e.visibility is None and data.twin(e) is None for e in data.logs)
    Dataset.load(paired).check()
    assert "another recipe" in refused(lambda: generate(with_twins(**fields), plain))


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
    _, shown, _ = Recorder(unit, [], recording, seed=5).measure({**truth, "command": 0.0 * time}, time)
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
