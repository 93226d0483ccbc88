"""TDMS, LabVIEW's logs: channels in groups, with stamps from their waveform's properties."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdd.logs.formats.signals import readable, require_stored
from fdd.logs.formats.trees import Leaf, TreeFile, tree_file


def open_tdms(path: Path) -> TreeFile:
    """Signals of a TDMS file, ``group/channel``.

    Raises
    ------
    InputError : damaged, or without channels of numbers.
    """
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # it tells of each oddity on standard error
    groups: dict[str, dict[str, Leaf]] = {}
    scalars: dict[str, dict[str, float]] = {}
    start: Any = None
    declared = 0
    with readable("damaged TDMS file", path), TdmsFile.read_metadata(path) as file:
        for group in file.groups():
            for channel in group.channels():
                kind = None if channel.dtype is None else np.dtype(channel.dtype).kind
                if kind not in ("f", "i", "u", "b", "M"):
                    continue
                unit = channel.properties.get("unit_string") or channel.properties.get("unit")
                declared += len(channel) * np.dtype(channel.dtype).itemsize
                groups.setdefault(group.name, {})[channel.name] = Leaf(
                    len(channel),
                    partial(_load, path, group.name, channel.name),
                    str(unit) if unit else None,
                )
                if (step := channel.properties.get("wf_increment")) is not None:
                    scalars.setdefault(group.name, {})["dt"] = float(step)
                    start = start or channel.properties.get("wf_start_time")
    require_stored(declared, path.stat().st_size, path)
    found = tree_file(path, groups, scalars)
    if isinstance(start, np.datetime64):
        found.start_ns = int(start.astype("datetime64[ns]").astype(np.int64))
    return found


def _load(path: Path, group: str, channel: str) -> Any:
    from nptdms import TdmsFile

    with readable(f"{group}/{channel} cannot be read", path), TdmsFile.open(path) as file:
        return file[group][channel][:]
