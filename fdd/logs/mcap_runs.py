"""Runs of the plant as MCAP: whole, or block by block with bounded memory, of one axis or several.

Topics are the contract's: ``/eha/<axis>/measurement`` and ``/truth``. Truth never stands in the measurement.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from fdd.errors import InputError
from fdd.samples import Samples


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

    def axis_of(self, axes: Sequence[str]) -> str:
        """The block's axis; InputError where it is none of the run's."""
        axis = axes[0] if self.axis is None and len(axes) == 1 else self.axis
        if axis is None or axis not in axes:
            raise InputError(
                f"a block of axis {axis!r} in a run of {', '.join(axes)}", mend="name one of these axes"
            )
        return axis


def require_axis(axis: str) -> None:
    """Refuse a name that cannot stand in a topic."""
    if not re.fullmatch(r"[A-Za-z0-9_.\-]{1,64}", axis):
        raise InputError(f"axis {axis[:70]!r} cannot stand in a topic", mend="use letters, digits, _ . and -")


def write_blocks(
    path: str | Path,
    blocks: Iterable[RunBlock],
    *,
    axes: Sequence[str],
    units: Mapping[str, str] | None = None,
    scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None,
    start_ns: int = 0,
) -> None:
    """Write a run from an iterator of blocks; the messages do not depend on how the rows are cut into them.

    Parameters
    ----------
    path : the file; it appears whole or not at all.
    blocks : of some seconds each, those of several axes in turn: what they overlap, chunks in the file do.
    axes : names of all axes.
    units : profile (YAML) of each axis that has one: metadata record ``unit`` with the key ``yaml`` for one
        axis, with the axes' names as keys for several.
    scenario_json, labels : metadata records ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises
    ------
    InputError : an axis that is no topic, columns that change, or a folder that is not there.
    """
    # Takes a while to import: not before it is needed.
    from fdd.logs.mcap_chunks import mcap_file

    if not axes or len(set(axes)) < len(axes):
        raise InputError("a run needs axes of different names", where=path, mend="name each axis once")
    for axis in axes:
        require_axis(axis)
    records: dict[str, dict[str, str]] = {}
    if units:
        records["unit"] = {"yaml" if len(axes) == 1 else a: units[a] for a in axes if a in units}
    if scenario_json is not None:
        records["scenario"] = {"json": scenario_json}
    if labels is not None:
        records["labels"] = {"json": json.dumps(labels, allow_nan=False)}
    with mcap_file(path, records, start_ns) as out:
        for block in blocks:
            root, samples = f"/eha/{block.axis_of(axes)}", block.samples
            topics: dict[str, Mapping[str, ArrayLike]] = {
                f"{root}/measurement": {"time": samples.time, **samples.columns}
            }
            if block.truth is not None:
                topics[f"{root}/truth"] = {"time": samples.time, **block.truth}
            out.add_columns(topics)


def write_run(
    path: str | Path,
    samples: Samples,
    *,
    axis: str,
    truth: Mapping[str, ArrayLike] | None = None,
    unit_yaml: str | None = None,
    **about: Any,
) -> None:
    """Write a run of one axis that is there as a whole; `about` as for `write_blocks`."""
    units = None if unit_yaml is None else {axis: unit_yaml}
    write_blocks(path, [RunBlock(samples, truth)], axes=[axis], units=units, **about)
