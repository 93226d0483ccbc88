"""YAML that users write: bounded, plain data only, one line where it is wrong, for every kind of file."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fdd.campaign.recipe import Recipe
from fdd.logs import ChannelMap
from fdd.unit import Unit
from fdd.yaml_reading import yaml_mapping, yaml_text
from tests.refusal import refused

LOADERS: dict[str, Callable[[Path], Any]] = {
    "unit profile": Unit.load, "recipe": Recipe.load, "channel map": ChannelMap.load,
}  # fmt: skip
NOT_YAML = ["a: [", "\x00", "2020-99-99", "a: 2020-99-99", "a: \x00", "a: 1\nb: 2\nc: d: e\n"]


@pytest.mark.parametrize("kind", LOADERS)
@pytest.mark.parametrize("text", NOT_YAML)
def test_what_is_not_yaml_is_one_line(kind: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    line = refused(lambda: LOADERS[kind](path))
    assert line.startswith(f"{path}: ") and "not valid YAML" in line
    assert "line 3: not valid YAML" in line or "d: e" not in text


NESTED_ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "\n".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)
)
NOT_PLAIN = {
    "nested aliases": (NESTED_ALIASES, "line 2: not plain YAML (alias *a0"),
    "an alias of itself": ("a: 1\nb: &b [*b]", "line 2: not plain YAML (alias *b"),
    "a merge of an alias": ("a: &a {b: 1}\nc:\n  <<: *a", "line 3: not plain YAML (alias *a"),
    "a merge": ("a: 1\nc:\n  <<: {b: 1}", "line 3: not plain YAML (merge <<"),
    "a key twice": ("a: 1\nb: {c: 1,\n  c: 2}", "line 3: not plain YAML (key 'c' twice"),
    "a key twice, at the top": ("a: 1\nb: 2\na: 3", "line 3: not plain YAML (key 'a' twice"),
    "lists in lists": ("[" * 5000, "line 1: not plain YAML (nested deeper than"),
    "mappings in mappings": ("{a: " * 5000, "line 1: not plain YAML (nested deeper than"),
    "too many values": ("a:\n" + "- 1\n" * 300_000, "not plain YAML (more than 200000 values"),
    "a name of Python's": ("!!python/name:os.system", "line 1: not plain YAML (tag tag:yaml.org,2002:python"),
    "a tag on nothing": ("a: !!int", "line 1: not plain YAML (tag"),
    "an endless number": ("a: 1" + ":1" * 400_000, "line 1: not plain YAML (a number of"),
    "an endless fraction": ("a: 1" + ":1" * 400_000 + ".0", "line 1: not plain YAML (a number of"),
    "an endless hexadecimal": ("a: 0x" + "f" * 9_000, "line 1: not plain YAML (a number of"),
}  # fmt: skip


@pytest.mark.parametrize("case", NOT_PLAIN)
def test_what_would_expand_or_hide_is_refused_at_once(case: str) -> None:
    """Each of these hangs, fills the memory or loses a value where YAML is read as it stands."""
    text, message = NOT_PLAIN[case]
    started = time.perf_counter()
    line = refused(lambda: yaml_mapping(text, "file.yaml", "recipe"))
    assert line.startswith("file.yaml: ") and message in line
    assert time.perf_counter() - started < 5.0


def test_a_log_cannot_smuggle_a_profile_of_aliases() -> None:
    assert "alias" in refused(lambda: Unit.from_yaml("schema: fdd.unit/1\n" + NESTED_ALIASES, "run.mcap"))


@pytest.mark.parametrize("kind", LOADERS)
@pytest.mark.parametrize("text", ["", "- a", "[1, 2]", "3", "null"])
def test_what_is_no_mapping_is_told_as_what_it_should_be(kind: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    assert f"not a {kind}" in refused(lambda: LOADERS[kind](path))


@pytest.mark.parametrize("kind", LOADERS)
def test_missing_and_large_files_are_refused(kind: str, tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        assert f"no such {kind}" in refused(partial(LOADERS[kind], path))
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * 3_000_000)
    assert re.search(f"larger than .* bytes, not a {kind}", refused(lambda: LOADERS[kind](large)))


def test_a_byte_order_mark_is_no_part_of_the_text_and_a_file_that_cannot_be_read_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbfschema: x\n")
    assert yaml_text(tmp_path / "a.yaml", "recipe", 100, "") == "schema: x\n"

    def denied(*_: object, **__: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_text", denied)
    line = refused(lambda: yaml_text(tmp_path / "a.yaml", "recipe", 100, "give a YAML file"))
    assert "a.yaml: cannot be read (Permission denied)" in line


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), PLAIN, max_size=4))
def test_any_plain_mapping_is_read_as_it_was_written(data: dict[str, Any]) -> None:
    assert yaml_mapping(yaml.safe_dump(data), "file.yaml", "recipe") == data
