"""YAML that users write: bounded, nothing but plain data, and one line where it is wrong.

Aliases, merges and tags are refused: a page of nested aliases stands for more nodes than a machine holds,
and no file of ours needs them. So is a key given twice, of which one would be lost without a word.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fdd.bounds import LONGEST_BASE_60, LONGEST_NUMBER, MOST_DEPTH, MOST_NODES
from fdd.errors import InputError

try:
    from yaml import CSafeLoader as _Loader  # ten times as fast
except ImportError:  # a PyYAML without libyaml
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]


class _Refused(yaml.MarkedYAMLError):
    """It is YAML, but not plain data of bounded size."""


def yaml_text(path: Path, kind: str, most: int, mend: str) -> str:
    """The text of a YAML file of at most so many bytes; `kind` and `mend` are for people, see `yaml_mapping`.
    An InputError where there is no such file, or it is too large or not readable."""
    try:
        if not path.is_file():
            raise InputError(f"no such {kind}", where=path, mend=mend)
        if path.stat().st_size > most:
            raise InputError(f"larger than {most} bytes, not a {kind}", where=path)
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path, mend=mend) from None


def yaml_mapping(
    text: str, where: str | Path, kind: str, *, mend: str | None = None, schema: str | None = None
) -> dict[str, Any]:
    """Parse YAML text that is one mapping; keys are text as written.

    `where`, `kind`: for errors, the file and what it should be. `mend`: what a right one looks like; where
    None, its first line with the schema. `schema`: what its key ``schema`` must be; None takes any.

    Raises InputError: names the line where it is not YAML, or has aliases, merges, tags, a key twice, too
    many nodes or levels; not a mapping; another schema.
    """
    try:
        _check_bounds(text)
        data = _Plain(text).get_single_data()
    except (yaml.YAMLError, ValueError) as error:  # ValueError: dates such as 2020-99-99
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or (str(error) or type(error).__name__).splitlines()[0]
        word = "plain" if isinstance(error, _Refused) else "valid"
        raise InputError(f"{place}not {word} YAML ({problem})", where=where) from None
    if not isinstance(data, dict) or (schema is not None and data.get("schema") != schema):
        mend = mend or f"its first line should be 'schema: {schema}'"
        raise InputError(f"not a {kind}", where=where, mend=mend)
    return data


def yaml_of(data: Any) -> str:
    """Plain data as YAML text that `yaml_mapping` reads: in order, without aliases."""
    return yaml.dump(data, sort_keys=False, allow_unicode=True, Dumper=_WrittenOut)


class _WrittenOut(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _check_bounds(text: str) -> None:
    """Refuse what would expand, before anything is built: events come one by one and hold no tree."""
    depth = nodes = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            raise _refused(event, f"alias *{event.anchor}: write the value out")
        if isinstance(event, yaml.NodeEvent):
            nodes += 1
            tag = getattr(event, "tag", None)
            if tag is not None:
                raise _refused(event, f"tag {tag:.40}: write the plain value")
            if nodes > MOST_NODES:
                raise _refused(event, f"more than {MOST_NODES} values")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MOST_DEPTH:
            raise _refused(event, f"nested deeper than {MOST_DEPTH} levels")


def _refused(at: Any, problem: str) -> _Refused:
    return _Refused(problem=problem, problem_mark=at.start_mark)


class _Plain(_Loader):
    """Loads what `_check_bounds` passed: keys are text; no merges, no key twice, no endless numbers."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping: dict[Any, Any] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused(key, "a key that is no text")
            if key.tag == "tag:yaml.org,2002:merge":
                raise _refused(key, "merge <<: write the values out")
            if key.value in mapping:
                raise _refused(key, f"key {key.value[:40]!r} twice: keep one")
            mapping[key.value] = self.construct_object(value, deep=deep)
        return mapping

    def bounded_number(self, node: yaml.ScalarNode) -> float:
        if len(node.value) > (LONGEST_BASE_60 if ":" in node.value else LONGEST_NUMBER):
            raise _refused(node, f"a number of {len(node.value)} characters")
        whole = node.tag == "tag:yaml.org,2002:int"
        return self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)


for _kind in ("int", "float"):
    _Plain.add_constructor(f"tag:yaml.org,2002:{_kind}", _Plain.bounded_number)
