"""The published schemas against real files and answers, with another library's validator."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent.parent
FILES = [
    ("map", "examples/*.map.yaml"), ("profile", "fdd/units/*.yaml"), ("profile", "fdd/demo/unit.yaml"),
    ("profile", "examples/*.base.yaml"), ("recipe", "datasets/*.yaml"), ("serve", "examples/serve.yaml"),
]  # fmt: skip


class Yaml12(yaml.SafeLoader):
    """As editors read it: PyYAML's 1.1 takes 2.1e8 for text."""


Yaml12.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)


def plain(text: str) -> Any:
    return json.loads(json.dumps(yaml.load(text, Yaml12)))


@pytest.mark.parametrize(("kind", "pattern"), FILES)
def test_files_of_the_project_are_valid(validator, kind: str, pattern: str) -> None:
    paths = sorted(ROOT.glob(pattern))
    assert paths
    for path in paths:
        assert [e.message for e in validator(kind).iter_errors(plain(path.read_text("utf-8")))] == [], path


@pytest.mark.parametrize(
    ("kind", "file", "old", "new"),
    [
        ("profile", "fdd/units/axis_a.yaml", "moving_mass: {value: 3.688", "moving_mass: {value: heavy"),
        ("profile", "fdd/units/axis_a.yaml", "moving_mass:", "mass:"),
        ("profile", "fdd/units/axis_a.yaml", "3.688, unit: kg", "3.688, size: kg"),
        ("profile", "fdd/units/axis_a.yaml", "fdd.unit/1", "fdd.unit/9"),
        ("map", "examples/rig1.map.yaml", "position: {column: cyl_mm", "postion: {column: cyl_mm"),
        ("map", "examples/rig1.map.yaml", "{column: cyl_mm, unit: mm}", "{column: cyl_mm, sign: 2}"),
        ("recipe", "datasets/smoke.yaml", "units: 2", "units: 0"),
        ("recipe", "datasets/smoke.yaml", "seed: 5", "sed: 5"),
    ],
)  # fmt: skip
def test_wrong_files_are_refused(validator, kind: str, file: str, old: str, new: str) -> None:
    text = (ROOT / file).read_text("utf-8")
    assert old in text
    assert not validator(kind).is_valid(plain(text.replace(old, new)))


@pytest.fixture(scope="module")
def answers(run, logs, tiny_model_file, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """Of a log that was read and of one that could not be."""
    folder = tmp_path_factory.mktemp("answers")
    out, bad = folder / "answers.json", folder / "bad.csv"
    bad.write_text("nothing,of,use\n1,2,3\n")
    run("diagnose", logs["leaking"], bad, "--model", tiny_model_file, "--json", out, "--workers", 1)
    read, unread = json.loads(out.read_text("utf-8"))
    return [read, unread]


@pytest.mark.parametrize(
    "change",
    [
        {"verdict": "fine"},
        {"schema": "fdd.diagnosis/2"},
        {"duration_s": "60"},
        {"faults": [{"fault": "aeration"}]},
        {"quality": {"dropped_samples": 0.5}},
        {"sha256": {"log": 1}},
        {"samples": None},
    ],
)
def test_answers_are_valid(validator, answers: list[dict[str, Any]], change: dict[str, Any]) -> None:
    valid = validator("diagnosis")
    for answer in answers:
        assert [e.message for e in valid.iter_errors(answer)] == []
        assert not valid.is_valid({**answer, **change})
        for key in set(answer) - {"error", "started_at"}:
            assert not valid.is_valid({k: v for k, v in answer.items() if k != key}), key


def test_a_map_may_have_its_channels_at_the_top(validator, run, one_line) -> None:
    short = {"position": {"topic": "/daq", "field": "cyl.pos", "unit": "mm"}}
    assert validator("map").is_valid(short)
    assert not validator("map").is_valid({"posision": short["position"]})
    one_line(run("schema", "answer"), "diagnosis", "recipe")
