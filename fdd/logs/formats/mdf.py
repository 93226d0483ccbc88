"""MDF 3 and 4 (ASAM), as measurement and calibration tools write them: a channel group a rate."""

from __future__ import annotations

import logging
import mmap
import struct
from contextlib import redirect_stdout, suppress
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from asammdf import MDF
from asammdf.blocks import mdf_v3, mdf_v4
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.formats import readable, require_stored
from fdd.logs.formats.trees import Group, Leaf, TreeFile, tree_file

_IN_RECORD = (0, 1, 2, 4, 5)
"""Kinds of an MDF 4 channel that stand in the record; the others (3, 6) are counted."""


def _close(file: Any) -> None:
    """Throw a file away without a word, also one that could only be opened by half."""
    with suppress(Exception):
        file.close()


mdf_v3.MDF3.__del__ = mdf_v4.MDF4.__del__ = _close


def open_mdf(path: Path) -> TreeFile:
    """Signals of an MDF file; where two channels have one name, the group's number stands before it. An
    InputError where it is damaged, or without channels of numbers."""
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)  # it tells of each oddity on standard error
    groups: dict[str, Group] = {}
    with readable("damaged MDF file", path):
        _require_ends(path)
        with redirect_stdout(StringIO()):  # it prints what it cannot make sense of
            file = MDF(path)
        start, inner = file.header.start_time, list[Any](file.groups)
        rates = [int(g.channel_group.cycles_nr) for g in inner]
        several = sum(r > 1 for r in rates) > 1
        for number, (group, rows) in enumerate(zip(inner, rates, strict=True)):
            about = group.channel_group
            one = about.samples_byte_nr + getattr(about, "invalidation_bytes_nr", 0)
            # The library makes room for the records or for the blocks, whatever is more.
            blocks = sum(int(block.original_size or 0) for block in group.get_data_blocks())
            require_stored(max(rows * int(one), blocks), path.stat().st_size, path)
            master = file.masters_db.get(number)
            own = groups.setdefault(str(number) if several else "", Group()).leaves
            if master is not None:
                own["time"] = Leaf(rows, partial(_load, path, file, number, None), "s")
            for index, channel in enumerate(group.channels):
                _require_inside(path, about, channel)
                if index != master:
                    load = partial(_load, path, file, number, index)
                    own[channel.name] = Leaf(rows, load, channel.unit or None)
    found = tree_file(path, groups)
    found.start_ns = int(start.timestamp() * 1e9) if start is not None and start.year > 1970 else 0
    return found


_LINKS = {"group": ("group", "rate", "data"), "rate": ("rate", "channel"), "channel": ("channel",)}
"""Kinds that a block's first links lead to, as the library follows them, whatever stands there."""


def _require_ends(path: Path) -> None:
    """Refuse blocks whose links come back to one of them: the library would follow them for ever."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        newer = raw[8:9] >= b"4"
        start, form = (24, "<3q") if newer else (4, "<3I" if raw[24:26] == bytes(2) else ">3I")
        todo, seen = [("group", *struct.unpack_from(form.replace("3", ""), raw, 64 + start))], set[Any]()
        while todo:
            kind, at = todo.pop()
            if not 0 < at <= len(raw) - start - struct.calcsize(form):
                continue  # the last one, or a link that the library refuses
            if (kind, at) in seen:
                raise InputError("damaged MDF file (its blocks go round)", where=path, mend="copy it again")
            seen.add((kind, at))
            # Of data only lists lead further.
            leads = _LINKS.get(kind, ("data",) * (raw[at : at + 4] in (b"##DL", b"##HL")))
            todo += zip(leads, struct.unpack_from(form, raw, at + start), strict=False)


def _require_inside(path: Path, group: Any, channel: Any) -> None:
    """Refuse a channel that reaches beyond its record: the library would copy what lies behind."""
    if hasattr(channel, "byte_offset"):  # MDF 4
        bits = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
        whole = group.samples_byte_nr + group.invalidation_bytes_nr
        inside = channel.channel_type not in _IN_RECORD or bits <= 8 * whole
    else:
        bits = 8 * getattr(channel, "additional_byte_offset", 0) + channel.start_offset + channel.bit_count
        inside = bits <= 8 * group.samples_byte_nr
    if not inside:
        problem = f"damaged MDF file (channel {channel.name[:40]!r} reaches beyond its record)"
        raise InputError(problem, where=path, mend="copy it again")


def _load(path: Path, file: Any, group: int, index: int | None) -> NDArray[Any]:
    """A channel, or the group's stamps, of the file, which stays open."""
    with readable("a channel cannot be read", path), redirect_stdout(StringIO()):
        if index is None:
            return np.asarray(file.get_master(group))
        signal = file.get(group=group, index=index)
        values = np.asarray(signal.samples)
        if signal.invalidation_bits is not None and values.dtype.kind in "fiub":
            values = np.where(np.asarray(signal.invalidation_bits), np.nan, values)
        return values
