"""Recordings as annotated MCAP, and the bound on the folder that holds them."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.logs.mcap_writing import write_annotated
from fdd.samples import Samples
from fdd.service.recent import FRESH_S

OURS = re.compile(r".+_\d{8}T\d{6}Z_\w+\.mcap")
"""Only files with such a name are ever removed."""


def name_of(axis: str, wall: float, alarm: object) -> str:
    """A recording's name.

    Examples
    --------
    >>> name_of("hall/A1", 0.0, 7)
    'hall_A1_19700101T000000Z_7.mcap'
    """
    stamp = datetime.fromtimestamp(max(wall, 0.0), UTC).strftime("%Y%m%dT%H%M%SZ")
    return f"{plain(axis)}_{stamp}_{re.sub('[^A-Za-z0-9]', '', str(alarm))[:40]}.mcap"


def plain(axis: str) -> str:
    """An axis's name as it can stand in a topic and a file's name.

    Examples
    --------
    >>> plain("../A 1")
    '_._A_1'
    """
    return re.sub(r"[^A-Za-z0-9_.\-]|^\.", "_", axis)[:64]


def begins(transition: Mapping[str, Any]) -> bool:
    """Whether an alarm's transition is one that is recorded: it is raised, or raised again."""
    return transition["action"] in ("RAISED", "RERAISED")


def wall_offset(last: float) -> float:
    """s to add to a stream's stamps, of which `last` has just come, for Unix seconds."""
    lag = time.time() - last
    # Stamps that are Unix seconds already need no offset, however late they come.
    return 0.0 if abs(lag) < FRESH_S else lag


def write(
    path: Path,
    axis: str,
    samples: Samples,
    statuses: list[dict[str, Any]],
    alarms: list[dict[str, Any]],
    offset: float,
    unit_yaml: str | None,
) -> None:
    """Write a recording; its time begins at 0 with its first sample, its log times are Unix time.

    Parameters
    ----------
    statuses, alarms : what happened beside the samples, each with its ``time``.
    offset : s to add to the stream's stamps for Unix seconds.

    Raises
    ------
    InputError : it cannot be written.
    """
    start = float(samples.time[0])
    wall = max(0.0, start + offset)
    faults = _faults(alarms, start, wall)
    answer = {"schema": "fdd.recording/1", "axis": axis, "faults": faults, "alarms": alarms}
    write_annotated(
        path, Samples(samples.time - start, samples.columns), trajectories(statuses, start),
        json.dumps(answer), axis=plain(axis), unit_yaml=unit_yaml, start_ns=round(wall * 1e9),
    )  # fmt: skip


def _faults(alarms: list[dict[str, Any]], start: float, wall: float) -> list[dict[str, Any]]:
    """The alarms' findings, as a diagnosis lists them, in the file's time."""
    found = []
    for alarm in alarms:
        finding = alarm["alarm"]["body"]
        if begins(alarm):
            # MCAP has no times before 1970.
            times = {name: max(finding[name] - start, -wall) for name in ("onset_s", "detected_s")}
            if finding.get("onset_interval"):
                times["onset_interval"] = [t - start for t in finding["onset_interval"]]
            found.append({**finding, **times})
    return found


def trajectories(statuses: list[dict[str, Any]], start: float) -> dict[str, Any]:
    """Estimates and probabilities over the statuses' times, as `write_annotated` takes them."""
    rows = sorted((s for s in statuses if s["time"] >= start), key=lambda s: s["time"])
    times = np.array([row["time"] - start for row in rows])

    def column(group: str, name: str, key: str | None) -> NDArray[np.float64]:
        cells = [row.get(group, {}).get(name) for row in rows]
        values = [cell.get(key) if key and cell is not None else cell for cell in cells]
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)

    quantities, families = (
        list(dict.fromkeys(name for row in rows for name in row.get(group, {})))
        for group in ("estimates", "probabilities")
    )
    return {
        "time": times,
        "estimates": {"ekf": {name: column("estimates", name, "value") for name in quantities}},
        "stds": {"ekf": {name: column("estimates", name, "std") for name in quantities}},
        "window_time": times,
        "probabilities": {name: column("probabilities", name, None) for name in families},
    }


def keep_within(folder: Path, most_bytes: int, newest: Path) -> None:
    """Remove the oldest recordings, but never the newest, until the folder holds at most so many bytes."""
    files = []
    for path in folder.iterdir():
        with suppress(OSError):
            if OURS.fullmatch(path.name):
                about = path.stat()
                files.append((about.st_mtime_ns, about.st_size, path))
    size = sum(bytes_ for _, bytes_, _ in files)
    for _, bytes_, path in sorted(files):
        if size <= most_bytes:
            return
        if path != newest:
            with suppress(OSError):
                path.unlink()
                size -= bytes_
