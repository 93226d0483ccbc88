"""Generating: the same whatever the workers, resumable, whole or recognisably not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fdd.campaign import generate as generate_module
from fdd.campaign.dataset import Dataset, digest
from fdd.campaign.generate import generate
from fdd.campaign.recipe import Recipe
from fdd.campaign.units import for_each_unit
from fdd.errors import InputError
from fdd.plant.faults.spec import FaultScales
from fdd.plant.oil import viscosity_ratio
from fdd.unit import Unit

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


def interrupted(monkeypatch: pytest.MonkeyPatch, after: int) -> Callable[..., None]:
    """Make the run after `after` others fail, as an interrupt would."""
    whole, calls = generate_module.make_run, []

    def run(*arguments: object) -> None:
        calls.append(arguments)
        if len(calls) > after:
            raise KeyboardInterrupt
        whole(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(generate_module, "make_run", run)
    return run


def test_an_interrupted_data_set_is_known_as_such_and_resumes(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe, directory = small(baseline=True), tmp_path / "set"
    with monkeypatch.context() as patch:
        interrupted(patch, after=6)
        with pytest.raises(KeyboardInterrupt):
            generate(recipe, directory)
    with pytest.raises(InputError, match=r"unfinished.*fdd generate"):
        Dataset.load(directory)
    (directory / "unit_000" / ".log_001.parquet.part").write_bytes(b"half a file")
    kept = {p: p.stat().st_mtime_ns for p in directory.rglob("*.parquet")}
    assert len(kept) == 6 + 2  # six runs, of which two have their truth
    generate(recipe, directory)
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in kept.items())
    assert contents(directory) == contents(made)


def test_a_folder_with_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        generate(small(), tmp_path)
    with pytest.raises(InputError, match="is a file"):
        generate(small(), tmp_path / "notes.txt")
    with pytest.raises(InputError, match="0 workers"):
        generate(small(), tmp_path / "set", workers=0)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_runs_that_would_rest_at_a_limit_are_drawn_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    with pytest.raises(InputError, match="never good"):
        generate(recipe, tmp_path / "other")


@pytest.mark.parametrize("name", ["labels.json", "recipe.yaml"])
def test_changed_labels_or_recipe_are_noticed(copy: Path, name: str) -> None:
    text = (copy / name).read_text(encoding="utf-8")
    (copy / name).write_text(text.replace("seal_wear", "seal_waer", 1) + " ", encoding="utf-8")
    with pytest.raises(InputError, match="SHA-256"):
        Dataset.load(copy)
    (copy / name).unlink()
    with pytest.raises(InputError, match=f"{name}: no such part of a data set"):
        Dataset.load(copy)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "Invalid JSON"),
        ('{"schema": "fdd.dataset/9"}', r"fdd\.dataset/9"),
        ('{"schema": "fdd.dataset/1"}', "Field required"),
        ("[" * 100_000, "Invalid JSON"),
    ],
)
def test_a_damaged_manifest_is_refused(copy: Path, text: str, told: str) -> None:
    (copy / "manifest.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=told) as error:
        Dataset.load(copy)
    assert "manifest.json" in str(error.value)
    assert "\n" not in str(error.value)


def test_labels_cannot_point_out_of_the_folder(copy: Path) -> None:
    labels = json.loads((copy / "labels.json").read_text(encoding="utf-8"))
    labels[0]["file"] = "../../etc/passwd"
    manifest = json.loads((copy / "manifest.json").read_text(encoding="utf-8"))
    text = json.dumps(labels)
    recipe = (copy / "recipe.yaml").read_text(encoding="utf-8")
    manifest["sha256"] = digest(recipe, text)
    (copy / "labels.json").write_text(text, encoding="utf-8")
    (copy / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(InputError, match=r"labels\.json.*file"):
        Dataset.load(copy)


def test_damaged_files_and_unknown_units_are_told(copy: Path) -> None:
    data = Dataset.load(copy)
    entry = data.logs[0]
    whole = (copy / entry.truth).read_bytes()
    (copy / entry.truth).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="truth can't be read"):
        data.truth(entry)
    (copy / entry.file).write_bytes(b"PAR1 nothing")
    with pytest.raises(InputError, match=r"log_000\.parquet"):
        data.samples(entry)
    with pytest.raises(InputError, match="unit_999"):
        data.baseline("unit_999")


UNITS = ["unit_000", "unit_001", "unit_002"]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_unit_that_refuses_is_left_out_with_a_warning(workers: int) -> None:
    with pytest.warns(UserWarning, match=f"{UNITS[1]} left out: too short"):
        assert for_each_unit(one_refuses, UNITS, workers=workers) == [u for u in UNITS if u != UNITS[1]]
    with pytest.raises(InputError, match="too short"), pytest.warns(UserWarning, match="left out"):
        for_each_unit(one_refuses, UNITS[1:2], workers=workers)


def one_refuses(unit: str) -> list[str]:
    if unit == UNITS[1]:
        raise InputError("too short", mend="record more")
    return [unit]
