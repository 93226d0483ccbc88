"""The example package, installed as a user installs it, does in every command what it promises."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "fdd_example"
FAULT = "piston_seal_extrusion"
OVER_THE_CATALOGUE = ("faults/test_catalogue.py", "faults/test_signatures.py", "plant/test_injection.py")

pytestmark = pytest.mark.slow


def installed(source: Path, folder: Path) -> Path:
    """Folder of site packages with the package in it, built without network."""
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
    ]
    done = subprocess.run(
        [*pip, "--target", folder / "site", source], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return folder / "site"


def copy_of(folder: Path) -> Path:
    """The example's sources; building writes beside them."""
    left = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    return Path(shutil.copytree(EXAMPLE, folder / "source", ignore=left))


def pytest_on(site: Path, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-rA", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(site), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=900)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package")
    return installed(copy_of(folder), folder)


def test_its_own_tests_pass(site: Path) -> None:
    done = pytest_on(site, site.parent / "source" / "tests", cwd=site.parent)
    assert done.returncode == 0, done.stdout[-4000:]


def test_the_tests_over_the_catalogue_take_its_fault(site: Path) -> None:
    done = pytest_on(site, *(f"tests/{name}" for name in OVER_THE_CATALOGUE), cwd=ROOT)
    assert done.returncode == 0, done.stdout[-4000:]
    for name in OVER_THE_CATALOGUE:
        assert re.search(rf"PASSED tests/{re.escape(name)}.*{FAULT}", done.stdout), name


@pytest.mark.parametrize(
    ("group", "test"),
    [
        ("fdd.faults", "test_the_catalogue_lists_it"),
        ("fdd.log_formats", "test_a_bench_log_is_read_like_any_other"),
        ("fdd.trackers", "test_the_tracker_stands_beside_ours"),
        ("fdd.classifiers", "test_the_classifier_learns_it_and_its_opinion_stands_beside_ours"),
    ],
)
def test_without_its_entry_point_its_test_fails(group: str, test: str, tmp_path: Path) -> None:
    source = copy_of(tmp_path)
    text = (source / "pyproject.toml").read_text("utf-8")
    fewer = re.sub(rf'\[project\.entry-points\."{re.escape(group)}"\]\n.*\n', "", text)
    assert fewer != text
    (source / "pyproject.toml").write_text(fewer, "utf-8")
    done = pytest_on(installed(source, tmp_path), source / "tests", "-k", test, cwd=tmp_path)
    assert done.returncode == 1 and "passed" not in done.stdout.splitlines()[-1], done.stdout[-2000:]
