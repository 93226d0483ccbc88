"""Runs of the plant as MCAP: whole, or block by block with bounded memory, of one axis or several."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fdd.errors import InputError
from fdd.logs.json_rows import Columns
from fdd.logs.mcap_merging import (
    MergedWriter,
    Messages,
    checked_columns,
    in_turn,
    merged_file,
    nanoseconds,
    require_axis,
)
from fdd.samples import Samples

BLOCK = 20_000
"""Rows that a whole run is written in at a time: some 20 MB of text."""


@dataclass(frozen=True)
class RunBlock:
    """A stretch of one axis's run.

    Attributes
    ----------
    samples : what was measured; may be empty, with its channels.
    truth : true quantities by name, ``time`` (m,) s and columns (m,); without a ``time`` on the samples' own.
    axis : name of the axis in the topics; None for the file's only one.
    """

    samples: Samples
    truth: Mapping[str, ArrayLike] | None = None
    axis: str | None = None


class RunWriter:
    """Takes a run's blocks; made by `run_file`.

    The topics are those of each axis in the order of `axes`: its measurement, then its truth, where its first
    block has one. The file is the same, byte for byte, however the rows are cut into blocks and
    whichever axis's block comes first.
    """

    def __init__(self, merged: MergedWriter, axes: Sequence[str], start_ns: int) -> None:
        self.axes = tuple(axes)
        self._merged, self._start_ns = merged, start_ns
        self._topics: dict[str, tuple[int, int | None]] = {}
        self._early: list[tuple[str, list[tuple[str, str, Columns]]]] = []

    def add(self, block: RunBlock) -> None:
        """The next rows of an axis.

        Raises
        ------
        InputError : unknown axis, times that go back, columns that change from block to block, or one axis
            that stays far behind the others.
        """
        axis = self._axis_of(block)
        topics = _topics_of(block, axis)
        if self._topics:
            self._push(axis, topics)
            self._merged.drain()
            return
        # The topics stand at the head of the file, so all axes must have come once.
        self._early.append((axis, topics))
        if {a for a, _ in self._early} == set(self.axes):
            self._begin()
            self._merged.drain()
        elif sum(c["time"].size for _, early in self._early for _, _, c in early) > self._merged.most_held:
            absent = ", ".join(a for a in self.axes if a not in {b for b, _ in self._early})
            raise InputError(f"no block of {absent} so far", mend="give the blocks of all axes in turn")

    def close(self) -> None:
        """Nothing more comes; an axis without a block has no topic."""
        if not self._topics:
            self._begin()

    def _axis_of(self, block: RunBlock) -> str:
        axis = block.axis
        if axis is None and len(self.axes) == 1:
            axis = self.axes[0]
        if axis not in self.axes:
            raise InputError(
                f"a block of axis {axis!r} in a run of {', '.join(self.axes)}", mend="name one of these axes"
            )
        return str(axis)

    def _begin(self) -> None:
        for axis in self.axes:
            first = next((topics for a, topics in self._early if a == axis), None)
            if first is None:
                continue
            numbers = [self._merged.topic(name, title, columns) for name, title, columns in first]
            self._topics[axis] = (numbers[0], numbers[1] if len(numbers) > 1 else None)
        for axis, topics in self._early:
            self._push(axis, topics)
        self._early = []

    def _push(self, axis: str, topics: list[tuple[str, str, Columns]]) -> None:
        measurement, truth = self._topics[axis]
        if (truth is not None) != (len(topics) > 1):
            raise InputError(
                f"axis {axis}: truth in some blocks only", mend="give it with every block or with none"
            )
        for number, (_, _, columns) in zip((measurement, truth), topics, strict=False):
            if number is not None:
                self._merged.push(number, nanoseconds(columns["time"], self._start_ns), columns)


@contextmanager
def run_file(
    path: str | Path,
    *,
    axes: Sequence[str],
    units: Mapping[str, str] | None = None,
    scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None,
    start_ns: int = 0,
) -> Iterator[RunWriter]:
    """A run's file to add blocks to; it appears whole or not at all.

    Parameters
    ----------
    path : the file.
    axes : names of all axes, in the order of their topics.
    units : profile (YAML) of each axis that has one: metadata record ``unit`` with the key ``yaml`` for one
        axis, with the axes' names as keys for several.
    scenario_json, labels : metadata records ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises
    ------
    InputError : a name of an axis that is no topic, or a folder that is not there.

    Examples
    --------
    >>> with run_file("run.mcap", axes=["axis_a", "axis_b"]) as out:  # doctest: +SKIP
    ...     for block in blocks:
    ...         out.add(block)
    """
    if not axes or len(set(axes)) < len(axes):
        raise InputError("a run needs axes of different names", where=path, mend="name each axis once")
    for axis in axes:
        require_axis(axis)
    records = run_metadata(axes, units, scenario_json)
    if labels is not None:
        records["labels"] = {"json": json.dumps(labels, allow_nan=False)}
    with merged_file(path, records) as merged:
        writer = RunWriter(merged, axes, start_ns)
        yield writer
        writer.close()


def write_blocks(path: str | Path, blocks: Iterable[RunBlock], *, axes: Sequence[str], **about: Any) -> None:
    """Write a run from an iterator of blocks; `about` as for `run_file`.

    Examples
    --------
    >>> write_blocks("run.mcap", blocks, axes=["axis_a"])  # doctest: +SKIP
    """
    with run_file(path, axes=axes, **about) as out:
        for block in blocks:
            out.add(block)


def write_run(
    path: str | Path,
    samples: Samples,
    *,
    axis: str,
    truth: Mapping[str, ArrayLike] | None = None,
    unit_yaml: str | None = None,
    scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None,
    start_ns: int = 0,
) -> None:
    """Write a simulated or recorded run of one axis that is there as a whole.

    Parameters
    ----------
    path : the file; it appears whole or not at all.
    samples : what was measured.
    axis : name of the axis in the topics.
    truth : true quantities by name; ``time`` (m,) s and columns (m,). Without a
        ``time``, on the samples' own.
    unit_yaml, scenario_json, labels : travel as the metadata records ``unit``
        (key yaml), ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises
    ------
    InputError : a name of an axis that is no topic, or a folder that is not there.

    Examples
    --------
    >>> write_run("run.mcap", samples, axis="axis_a")  # doctest: +SKIP
    """
    require_axis(axis)
    metadata = run_metadata([axis], None if unit_yaml is None else {axis: unit_yaml}, scenario_json)
    if labels is not None:
        metadata["labels"] = {"json": json.dumps(labels, allow_nan=False)}
    with merged_file(path, metadata) as merged:
        write_whole(merged, _topics_of(RunBlock(samples, truth), axis), start_ns)


def write_whole(
    merged: MergedWriter,
    topics: Sequence[tuple[str, str, Columns]],
    start_ns: int,
    messages: Messages | None = None,
) -> None:
    """Push topics that are there as a whole: name, title and columns with their ``time``, in slices.

    `messages`, where there are any, are one topic more.

    Examples
    --------
    >>> with merged_file("run.mcap", {}) as merged:  # doctest: +SKIP
    ...     write_whole(merged, [("/a", "A", {"time": np.arange(9.0)})], 0)
    """
    stamps = [nanoseconds(columns["time"], start_ns) for _, _, columns in topics]
    numbers = [merged.topic(*topic) for topic in topics]
    if messages is not None:
        last_one = merged.topic(messages.name, messages.title, {}, messages.schema)
        merged.push_texts(last_one, messages.stamps, messages.texts, last=True)
    # Times that go to and fro can only be sorted as a whole.
    apart = [bool(np.any(np.diff(s) < 0)) for s in stamps]
    lengths = [0 if whole else s.size for s, whole in zip(stamps, apart, strict=True)]
    for number, own, whole, (_, _, columns) in zip(numbers, stamps, apart, topics, strict=True):
        if whole or not own.size:
            merged.push(number, own, columns, last=True)
    for which, rows in in_turn(lengths, BLOCK):
        last = rows.stop >= lengths[which]
        merged.push(numbers[which], stamps[which][rows], _sliced(topics[which][2], rows), last=last)
        merged.drain()


def run_metadata(
    axes: Sequence[str], units: Mapping[str, str] | None, scenario_json: str | None
) -> dict[str, dict[str, str]]:
    """Metadata records of a run: ``unit`` and ``scenario``.

    Examples
    --------
    >>> run_metadata(["a"], {"a": "name: x"}, None)
    {'unit': {'yaml': 'name: x'}}
    """
    records: dict[str, dict[str, str]] = {}
    if units:
        one = len(axes) == 1
        records["unit"] = {"yaml" if one else axis: units[axis] for axis in axes if axis in units}
    if scenario_json is not None:
        records["scenario"] = {"json": scenario_json}
    return records


def _topics_of(block: RunBlock, axis: str) -> list[tuple[str, str, Columns]]:
    """Name, title and columns of the block's topics."""
    samples = block.samples
    topics: list[tuple[str, str, Columns]] = [
        (f"/eha/{axis}/measurement", "fdd.Measurement", {"time": samples.time, **samples.columns})
    ]
    if block.truth is not None:
        time = np.asarray(block.truth.get("time", samples.time), dtype=np.float64)
        others = {k: v for k, v in block.truth.items() if k != "time"}
        columns = {"time": time, **checked_columns(others, time.size, "truth")}
        topics.append((f"/eha/{axis}/truth", "fdd.Truth", columns))
    return topics


def _sliced(columns: Columns, rows: slice) -> dict[str, Any]:
    return {
        name: _sliced(values, rows) if isinstance(values, Mapping) else np.asarray(values)[rows]
        for name, values in columns.items()
    }
