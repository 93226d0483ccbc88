"""Read a log of any kind: by what is in it, not by what it is called."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.angles import accumulate_speed
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.conversion import checked_finite, held, to_si, with_values
from fdd.logs.mcap_reading import (
    MEASUREMENT_TOPIC,
    Recording,
    contract_fields,
    fields_of,
    read_topics,
    require_field,
)
from fdd.logs.mcap_records import MAGIC
from fdd.logs.near_misses import listed
from fdd.logs.quality import (
    DataQuality,
    check_magnitudes,
    check_time,
    count_missing,
    ordered_time,
    suspicions,
)
from fdd.logs.tabular import CsvTable, ParquetTable, Table
from fdd.samples import CHANNELS, Samples, missing_required

Column = NDArray[np.float64]

MAX_LOG_BYTES = 8 << 30
LONGEST_HOLD = 5.0
"""s, or five of its own periods: as long a value of a slower topic stands for what follows."""
EPOCH_SECONDS = 1e6
"""A log that starts later than this (11 days) carries the time of day; it is counted from its start."""


@dataclass
class Log:
    """A log in the house's currency.

    Attributes
    ----------
    samples : channels in SI.
    quality : what was missing or odd.
    name : file name.
    axis : of the topic, the map, or the caller; None where nothing tells.
    metadata : of an MCAP file: record name to its key-value pairs. A run of
        ours has ``metadata["unit"]["yaml"]`` and ``metadata["scenario"]["json"]``.
    start_ns : ns; log time of t = 0 in an MCAP file, else 0.
    """

    samples: Samples
    quality: DataQuality
    name: str
    axis: str | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    start_ns: int = 0


@dataclass
class _Raw:
    """Columns in SI before they are checked."""

    time: Column
    columns: dict[str, Column]
    notes: list[str]
    place: Callable[[int], str]
    axis: str | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    first_stamp: int | None = None
    truncated: bool = False


def read_log(
    path: str | Path,
    channel_map: ChannelMap | str | Path | None = None,
    axis: str | None = None,
    *,
    shortest: float = 2.0,
) -> Log:
    """Read a CSV, Parquet or MCAP log.

    Parameters
    ----------
    path : the log. Its content tells what it is, whatever its suffix.
    channel_map : where the channels stand, or the path of such a map. Not needed
        where columns carry the contract's names, or MCAP messages stand on
        ``/eha/<axis>/measurement``.
    axis : which axis of an MCAP file with several.
    shortest : s; a shorter log is refused.

    Returns
    -------
    Log : samples in SI and what was odd about them.

    Raises
    ------
    InputError : one line that names file, place, problem and mend.

    Examples
    --------
    >>> log = read_log("run.mcap")  # doctest: +SKIP
    >>> log.samples["position"], log.quality.dropped_samples  # doctest: +SKIP
    """
    path = Path(path)
    if channel_map is not None and not isinstance(channel_map, ChannelMap):
        channel_map = ChannelMap.load(channel_map)
    kind = _kind_of(path)
    try:
        if kind == "mcap":
            raw = _from_mcap(path, channel_map, axis)
        else:
            table: Table = (
                ParquetTable.open(path)
                if kind == "parquet"
                else CsvTable.open(path, channel_map.csv if channel_map else None)
            )
            raw = _from_table(path, table, channel_map)
            raw.axis = axis or raw.axis
        return _checked(path, raw, channel_map, shortest)
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None


def _kind_of(path: Path) -> str:
    if path.is_dir():
        raise InputError("is a folder, not a log", where=path, mend="give the files in it")
    if not path.is_file():
        raise InputError("no such file", where=path, mend="check the path")
    try:
        size = path.stat().st_size
        with path.open("rb") as source:
            head = source.read(8)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from None
    if size == 0:
        raise InputError("the file is empty", where=path, mend="record or copy it again")
    if size > MAX_LOG_BYTES:
        raise InputError(f"{size} bytes, at most {MAX_LOG_BYTES} are read", where=path, mend="split the log")
    if head == MAGIC:
        return "mcap"
    if head[:4] == b"PAR1":
        return "parquet"
    for magic, what in ((b"\x1f\x8b", "gzip"), (b"PK\x03\x04", "zip"), (b"\x28\xb5\x2f\xfd", "zstd")):
        if head.startswith(magic):
            raise InputError(f"is compressed ({what})", where=path, mend="unpack it first")
    suffix = path.suffix.lower()
    if suffix in (".mcap", ".parquet"):
        kind = "an MCAP" if suffix == ".mcap" else "a Parquet"
        raise InputError(f"not {kind} file (wrong first bytes)", where=path, mend="record or copy it again")
    return "csv"


def _from_table(path: Path, table: Table, channel_map: ChannelMap | None) -> _Raw:
    if channel_map is None:
        sources = {n: ChannelSource(column=n) for n in CHANNELS if n in table.names}
        if "time" not in sources and len(sources) > 1:
            raise InputError("no column 'time'", where=path, mend="say with --map which column is the time")
        if len(sources) < 2:
            raise InputError(
                "no usable channels", where=path,
                mend=f"say with --map what its columns are: {listed(n for n in table.names if n)}",
            )  # fmt: skip
    else:
        if channel_map.reads_mcap:
            raise InputError("the map names topics, but this is a table", where=path, mend="map columns")
        sources = channel_map.channels
    read = {n: s for n, s in sources.items() if s.from_ is None}
    wanted = [str(s.column) for s in read.values()] + [s.sign_of for s in read.values() if s.sign_of]
    raw = table.read(wanted)
    columns = {
        name: to_si(name, source, raw[str(source.column)], raw[source.sign_of] if source.sign_of else None)
        for name, source in read.items()
    }
    time = columns.pop("time")
    return _Raw(time, columns, list(table.notes), table.place, channel_map.axis if channel_map else None)


def _from_mcap(path: Path, channel_map: ChannelMap | None, axis: str | None) -> _Raw:
    if channel_map is None:
        return _from_own_mcap(path, axis)
    if not channel_map.reads_mcap:
        raise InputError("the map names columns, but this is an MCAP file", where=path, mend="map topics")
    read = {n: s for n, s in channel_map.channels.items() if s.from_ is None}
    paths: dict[str, list[str]] = {}
    for source in read.values():
        mine = paths.setdefault(str(source.topic), [])
        mine.extend(f for f in (source.field, source.sign_of) if f is not None and f not in mine)
    recording = read_topics(path, paths.get)
    main = next((read[n].topic for n in ("position", "time", *read) if n in read), None)
    columns: dict[str, Column] = {}
    time: Column | None = None
    stamps: NDArray[np.int64] | None = None
    for name, source in sorted(read.items(), key=lambda item: item[1].topic != main):
        topic = str(source.topic)
        if source.field is None:
            _require_topic(path, recording, topic)
            continue
        raw = require_field(path, recording, topic, source.field)
        direction = require_field(path, recording, topic, source.sign_of) if source.sign_of else None
        values = to_si(name, source, raw, direction)
        own = recording.series[topic].stamps
        if topic == main:
            stamps = own
            if name == "time":
                time = values
                continue
        elif stamps is not None:
            if name == "time":
                raise InputError(
                    f"time is mapped to {topic}, position to {main}", mend="map both to one topic"
                )
            slow = 5.0 * float(np.median(np.diff(own))) * 1e-9 if own.size > 1 else 0.0
            values = held(stamps, own, values, max(LONGEST_HOLD, slow))
        columns[name] = values
    if stamps is None:
        raise InputError("the map gives no channel of a topic", where=path)
    return _mcap_raw(recording, stamps, time, columns, axis or channel_map.axis)


def _require_topic(path: Path, recording: Recording, topic: str) -> None:
    """Refuse a map's time topic that the file does not have."""
    if topic not in recording.series:
        raise InputError(
            f"no message on topic {topic}",
            where=path,
            mend=f"the file has: {listed(recording.topics) or 'none'}",
        )


def _from_own_mcap(path: Path, axis: str | None) -> _Raw:
    def wanted(topic: str) -> Sequence[str] | None:
        found = MEASUREMENT_TOPIC.match(topic)
        return contract_fields(topic) if found and axis in (None, found["axis"]) else None

    recording = read_topics(path, wanted)
    axes = [found["axis"] for t in recording.topics if (found := MEASUREMENT_TOPIC.match(t))]
    if not axes:
        there = f"it has: {listed(recording.topics)}" if recording.topics else "it has no topics"
        raise InputError(
            "no usable channels: no topic /eha/<axis>/measurement", where=path,
            mend=f"say with --map what its topics are ({there})",
        )  # fmt: skip
    if axis is not None and axis not in axes:
        raise InputError(f"no axis {axis!r}", where=path, mend=f"the file has: {listed(axes)}")
    if axis is None and len(axes) > 1:
        raise InputError(f"{len(axes)} axes: {listed(axes)}", where=path, mend="choose one with --axis")
    chosen = axis or axes[0]
    series = recording.series.get(f"/eha/{chosen}/measurement")
    if series is None:
        raise InputError(
            "no message could be read", where=path, mend="the file may be cut off: record or copy it again"
        )
    columns = {n: v for n, v in series.fields.items() if np.isfinite(v).any()}
    time = columns.pop("time", None)
    if not columns:
        there = listed(fields_of(path, f"/eha/{chosen}/measurement"))
        raise InputError(
            "no usable channels", where=path, mend=f"say with --map what its fields are: {there}"
        )
    # One message without its time would be lost; the log times serve all of them.
    time = None if time is not None and not np.isfinite(time).all() else time
    return _mcap_raw(recording, series.stamps, time, columns, chosen)


def _mcap_raw(
    recording: Recording,
    stamps: NDArray[np.int64],
    time: Column | None,
    columns: dict[str, Column],
    axis: str | None,
) -> _Raw:
    first = int(stamps[0])
    since_start: Column = (stamps - first).astype(np.float64) * 1e-9 if time is None else time
    notes = []
    if recording.damaged:
        notes.append(f"{recording.damaged} damaged chunks were left out (checksum or compression is wrong)")
    return _Raw(
        since_start,
        columns,
        notes,
        "message {}".format,
        axis,
        recording.metadata,
        first,
        recording.truncated,
    )


def _checked(path: Path, raw: _Raw, channel_map: ChannelMap | None, shortest: float) -> Log:
    time, rows, time_notes = ordered_time(raw.time, raw.place)
    columns = {n: v[rows] for n, v in raw.columns.items()} if rows.size < raw.time.size else raw.columns
    notes = raw.notes + time_notes
    if time[0] > EPOCH_SECONDS:
        notes.append(f"the clock starts at {time[0]:.3f} s; times are counted from there")
        time = time - time[0]
    if raw.truncated:
        notes.insert(0, f"file is truncated: read up to t={time[-1]:.3f} s")
    start_ns = 0 if raw.first_stamp is None else raw.first_stamp - round(float(time[0]) * 1e9)
    quality = check_time(time, shortest)
    columns, infinite_notes = checked_finite(columns)
    columns, empty = with_values(columns)
    absent = missing_required(columns)
    if absent:
        silent = f" ({', '.join(empty)} without a single value)" if empty else ""
        raise InputError(
            f"missing channels: {', '.join(absent)}{silent}",
            mend="record them, or name their columns with --map",
        )
    check_magnitudes(columns)
    count_missing(columns, quality)
    columns = _derived(time, columns, channel_map, quality.period)
    quality.notes = notes + quality.notes + infinite_notes
    quality.notes += [f"{name}: no value at all, taken as absent" for name in empty]
    quality.notes += suspicions(time, columns, quality.period)
    return Log(
        Samples(time, columns), quality, path.name, raw.axis, _of_axis(raw.metadata, raw.axis), start_ns
    )


def _of_axis(metadata: dict[str, dict[str, str]], axis: str | None) -> dict[str, dict[str, str]]:
    """The metadata with this axis's unit as the key yaml, where a run of several axes has one for each."""
    units = metadata.get("unit", {})
    if axis is None or "yaml" in units or axis not in units:
        return metadata
    return {**metadata, "unit": {**units, "yaml": units[axis]}}


def _derived(
    time: Column, columns: dict[str, Column], channel_map: ChannelMap | None, period: float
) -> dict[str, Column]:
    """Add the pump angle and the pressure difference where the log has only what makes them."""
    out = dict(columns)
    if "pump_angle" not in out:
        source = channel_map.channels.get("pump_angle") if channel_map else None
        stands_for = source.period if source is not None and source.period else period
        out["pump_angle"] = accumulate_speed(time, out["pump_speed"], stands_for)
    if "pressure_difference" not in out:
        out["pressure_difference"] = out["pressure_1"] - out["pressure_2"]
    return out
