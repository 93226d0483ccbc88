"""TDMS, LabVIEW's logs: channels in groups, with stamps from their waveform's properties."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager

from fdd.logs.formats import readable, require_stored
from fdd.logs.formats.trees import Group, Leaf, TreeFile, tree_file


def open_tdms(path: Path) -> TreeFile:
    """Signals of a TDMS file, ``group/channel``. Raises InputError: damaged, or no channels of numbers."""
    log_manager.set_level(logging.CRITICAL)  # it tells of each oddity on standard error
    groups: dict[str, Group] = {}
    start: Any = None
    declared = 0
    with readable("damaged TDMS file", path), TdmsFile.read_metadata(path) as file:
        for channel in (channel for group in file.groups() for channel in group.channels()):
            name, about = channel.group_name, channel.properties
            if channel.dtype is None or np.dtype(channel.dtype).kind not in "fiubM":
                continue
            declared += len(channel) * np.dtype(channel.dtype).itemsize
            unit = about.get("unit_string") or about.get("unit")
            load = partial(_load, path, name, channel.name)
            own = groups.setdefault(name, Group())
            own.leaves[channel.name] = Leaf(len(channel), load, str(unit) if unit else None)
            if (step := about.get("wf_increment")) is not None:
                own.scalars["dt"] = float(step)
                start = start or about.get("wf_start_time")
    require_stored(declared, path.stat().st_size, path)
    found = tree_file(path, groups)
    if isinstance(start, np.datetime64):
        found.start_ns = int(start.astype("datetime64[ns]").astype(np.int64))
    return found


def _load(path: Path, group: str, channel: str) -> Any:
    with readable(f"{group}/{channel} cannot be read", path), TdmsFile.open(path) as file:
        return file[group][channel][:]
