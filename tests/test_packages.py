"""What packages add to the catalogue, what becomes of those that cannot be used, and the example package."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fdd.faults
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.hypotheses import hypotheses
from fdd.diagnosis.model import Model
from fdd.faults import CATALOGUE, Effect, Fault, Figure, Signature
from fdd.packages import FAULTS, Addition
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults import FaultScales, FaultSpec, inject
from fdd.unit import Unit
from tests.refusal import refused

RUN = "from fdd.cli import main; main()"
UNIT = Unit.load("axis_a")
GOOD = Fault(
    id="made_up", family="leakage", title="made-up leak", plant="leaks", severity="1 m³/s", source="none",
    next_check="Look.", effects=(Effect("bypass", "add", 1e-5),),
    signatures=(Signature("made up", lambda unit: {"volume": {"relief_12": 0.1}}),),
)  # fmt: skip


def addition(given: object, name: str = "made_up", package: str = "made-up 1.0") -> Addition:
    """An entry point that names it."""
    return Addition(name, package, SimpleNamespace(load=lambda: given, group=FAULTS, value="made_up:FAULT"))


def collected(monkeypatch: pytest.MonkeyPatch, *added: Addition) -> tuple[dict[str, Fault], dict[str, str]]:
    monkeypatch.setattr(fdd.faults, "additions", lambda group: list(added))
    return fdd.faults._collected(list(CATALOGUE.values()))


def test_a_fault_of_a_package_comes_last_in_its_family(monkeypatch, capsys) -> None:
    found, added_by = collected(monkeypatch, addition(replace(GOOD, rank=0)))
    assert [f for f in found if found[f].family == "leakage"][-1] == "made_up"
    assert added_by == {"made_up": "made-up 1.0"}
    assert [f for f in found if f != "made_up"] == list(CATALOGUE)
    assert capsys.readouterr().err == ""


BAD = {
    "is a str, not a Fault": "made_up",
    "the id 'aeration' is taken": replace(GOOD, id="aeration"),
    "the id 'leakage' is taken": replace(GOOD, id="leakage"),
    "the id 'Made up' is not": replace(GOOD, id="Made up"),
    "the family 'wear' is none of leakage, seal_wear": replace(GOOD, family="wear"),
    "the family 'unknown' is none of": replace(GOOD, family="unknown"),
    "needs code in fdd.plant.sensors": replace(GOOD, in_measurement=True),
    "neither effects nor signatures": replace(GOOD, effects=(), signatures=()),
    "the figure 'free_air' is taken": replace(GOOD, figures=(Figure("free_air", 1.0, (0.0, 2.0), ""),)),
}


@pytest.mark.parametrize("problem", BAD)
def test_what_cannot_stand_in_the_catalogue_is_told_and_left_out(monkeypatch, capsys, problem: str) -> None:
    other = addition(replace(GOOD, id="another"), "another")
    found, added_by = collected(monkeypatch, addition(BAD[problem]), other)
    assert set(found) == {*CATALOGUE, "another"} and set(added_by) == {"another"}
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("fdd: warning: package made-up 1.0: fdd.faults 'made_up': ")
    assert problem in line and line.endswith("; fdd goes on without it")


def test_of_two_packages_with_one_id_the_second_is_left_out(monkeypatch, capsys) -> None:
    found, added_by = collected(monkeypatch, addition(GOOD), addition(GOOD, "more", "other 2.0"))
    assert found["made_up"] is GOOD and added_by["made_up"] == "made-up 1.0"
    assert "package other 2.0: fdd.faults 'more': the id 'made_up' is taken" in capsys.readouterr().err


def test_a_package_that_cannot_be_imported_is_told_in_one_line(tmp_path: Path) -> None:
    """With a real entry point, in a process of its own."""
    about = tmp_path / "broken-0.3.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 0.3\n", "utf-8")
    (about / "entry_points.txt").write_text("[fdd.faults]\nbad = broken_fault:FAULT\n", "utf-8")
    (tmp_path / "broken_fault.py").write_text("import a_module_that_is_not_there\n", "utf-8")
    done = subprocess.run(
        [sys.executable, "-c", RUN, "simulate", "--list-faults"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0 and "aeration" in done.stdout
    assert done.stderr == (
        "fdd: warning: package broken 0.3: fdd.faults 'bad': broken_fault:FAULT cannot be loaded "
        "(ModuleNotFoundError: No module named 'a_module_that_is_not_there'); "
        "mend the package, or uninstall it; fdd goes on without it\n"
    )


def in_the_catalogue(monkeypatch: pytest.MonkeyPatch, entry: Fault) -> None:
    monkeypatch.setitem(CATALOGUE, entry.id, entry)
    monkeypatch.setitem(fdd.faults.ADDED_BY, entry.id, "made-up 1.0")


@pytest.mark.parametrize(
    ("effect", "problem"),
    [
        (Effect("sideways", "add", 1.0), "the plant has no parameter 'sideways'"),
        (Effect("bypass", "add", "half"), "no figure is called 'half'"),
    ],
)
def test_an_effect_on_what_the_plant_does_not_have_is_refused(monkeypatch, effect, problem) -> None:
    in_the_catalogue(monkeypatch, replace(GOOD, effects=(effect,)))
    monkeypatch.setattr("fdd.plant.faults.PLANT_FAULTS", ("made_up",))
    time = np.zeros(1)
    rows = c.healthy_conditions(UNIT, time, time)
    spec = FaultSpec(fault="made_up", severity=1.0)
    # It lists all figures.
    line = refused(lambda: inject(rows, time, [spec], FaultScales(), Details()), longest=3000)
    assert line.startswith(f"package made-up 1.0: fault 'made_up': {problem}; there are: ")


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"oil": {"leak": 1.0}}, "there is no balance 'oil'"),
        ({"volume": {"leek": 1.0}}, "balance 'volume' has no column 'leek'"),
    ],
)
def test_a_signature_in_what_no_balance_has_is_refused(monkeypatch, columns, problem) -> None:
    in_the_catalogue(monkeypatch, replace(GOOD, signatures=(Signature("made up", lambda unit: columns),)))
    line = refused(lambda: hypotheses(UNIT, effects_of(UNIT)))
    assert line.startswith(f"package made-up 1.0: fault 'made_up': {problem}; there are: ")


def test_a_model_knows_the_faults_that_it_has_learnt(monkeypatch) -> None:
    in_the_catalogue(monkeypatch, GOOD)
    shipped = Model.load()
    assert shipped.knows("aeration") and not shipped.knows("made_up")
    learnt = shipped.model_copy(update={"faults": ("made_up",)})
    assert learnt.knows("made_up") and not learnt.knows("aeration")
    assert Model.model_validate_json(learnt.model_dump_json(by_alias=True)).faults == ("made_up",)
    # One of before does not say; it has the same text, and so the same hash in every answer.
    before = shipped.model_copy(update={"faults": None})
    assert before.knows("aeration") and not before.knows("made_up") and "faults" not in before.model_dump()


@pytest.mark.slow
def test_the_example_package_builds_without_network_and_its_own_tests_pass(tmp_path: Path) -> None:
    example = Path(__file__).parents[1] / "examples" / "fdd_example"
    source, site = tmp_path / "source", tmp_path / "site"
    left_out = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(example, source, ignore=left_out)  # building writes beside its sources
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", site]
    command = [sys.executable, "-m", "pip", "install", *options, source]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", source / "tests"]
    environment = {**os.environ, "PYTHONPATH": str(site), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout[-4000:]
