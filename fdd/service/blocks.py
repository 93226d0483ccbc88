"""A block of one axis's samples, and the message `fdd.block/1` that carries it as JSON or Arrow."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from struct import error as StructError
from struct import unpack_from
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from fdd.bounds import MAX_BLOCK_BYTES, MOST_BLOCK_COLUMNS, MOST_BLOCK_ROWS, MOST_SEQUENCE
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.monitor.stream import StreamMap
from fdd.samples import Samples

Array = NDArray[np.float64]

SCHEMA = "fdd.block/1"
_NAME = re.compile(r"(?!\.{1,2}(/|$))[A-Za-z0-9_.-]+(/(?!\.{1,2}(/|$))[A-Za-z0-9_.-]+)*")
_LONGEST_AXIS, _LONGEST_UNIT, _MOST_TOLD = 64, 200, 8
_HEAD_BYTES = 8192
"""Of an Arrow message besides its numbers; one with more is not kept as it came."""
_KEYS = ("schema", "axis", "sequence", "time", "columns", "unit")
ARROW_START = b"\xff\xff\xff\xff"
"""First bytes of an Arrow IPC stream."""
DAMAGE = (pa.ArrowException, OSError, StructError, StopIteration, UnicodeDecodeError, MemoryError)
FLOATS = (pa.float64().id, pa.float32().id)
MEND = "send one record batch of float64 or float32 columns as an IPC stream, not compressed"


def nothing() -> None:
    """What a block without a sender to answer calls when it is accepted."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one axis that came together.

    Attributes
    ----------
    samples : channels of the contract in SI; `time` in s of the sender's clock.
    sequence : number of the block, one more than the block's before; None where they are not counted.
    received : s since 1970. unit : name of the profile, where the sender says it.
    ignored : names of columns that are no channels.
    patient : the sender keeps what is not accepted: the inbox does not drop it for being late.
    accepted : called once by the fleet when the block is stored, or refused and counted.
    payload : the Arrow message that it came as, where that holds these samples and little else, perhaps
        not the axis.
    """

    axis: str
    samples: Samples
    sequence: int | None
    received: float
    unit: str | None = None
    ignored: tuple[str, ...] = ()
    patient: bool = False
    accepted: Callable[[], None] = nothing
    payload: bytes | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of the numbers in it."""
        return 8 * len(self.samples) * (1 + len(self.samples.channels))

    @property
    def seconds(self) -> float:
        """s of data in it, the last row's own period included; 0 for one row."""
        rows = len(self.samples)
        return self.samples.duration * rows / (rows - 1) if rows > 1 else 0.0


def axis_name(name: object) -> str:
    """The name, if it is one of an axis: 1 to 64 of letters, digits and ``_ - . /``, no part ``..``.

    Raises InputError: it is none.
    """
    if not isinstance(name, str) or len(name) > _LONGEST_AXIS or not _NAME.fullmatch(name):
        mend = "use 1 to 64 of letters, digits, _ - . and /"
        raise InputError(f"{str(name)[:80]!r} is no name of an axis", mend=mend)
    return name


class Decoder:
    """Messages to blocks, by one source's channel map.

    Without an entry for `time` in the map the message's own times are taken, in s; without a map the columns
    are the contract's, in SI. Raises InputError: the map has what a stream cannot use.
    """

    def __init__(self, channel_map: ChannelMap | None = None) -> None:
        self.map, self._plain = StreamMap(channel_map), channel_map is None

    def decode(self, payload: bytes, *, axis: str | None = None, **more: Any) -> Block:
        """The block that a message (JSON text or an Arrow IPC stream) holds.

        `axis`: as the topic says, where it does; `more`: further attributes of the `Block`.
        Raises InputError: one line that says what is wrong with the message.
        """
        if len(payload) > MAX_BLOCK_BYTES:
            problem = f"a block of {len(payload)} bytes, at most {MAX_BLOCK_BYTES}"
            raise InputError(problem, mend="send shorter blocks")
        if payload.startswith(ARROW_START):
            columns, head = arrow_columns(payload)
            ignored = self._ignored(columns)
            numbers = 8 * sum(v.size for v in columns.values())
            if self._plain and not ignored and len(payload) <= numbers + _HEAD_BYTES:
                more["payload"] = payload
            return self._block(columns, _of_axis(head, axis), {**more, "ignored": ignored})
        return self.decode_object(_of_axis(json_object(payload), axis), **more)

    def decode_object(self, message: Mapping[str, Any], **more: Any) -> Block:
        """The block that a message's parsed JSON object holds; see `decode`."""
        stray = message.keys() - {*_KEYS}
        if stray:
            raise InputError(f"unknown key {min(stray)[:40]!r} in a block", mend=f"use {', '.join(_KEYS)}")
        given = message.get("columns")
        if not isinstance(given, dict) or len(given) > MOST_BLOCK_COLUMNS:
            problem = f"columns is no object of at most {MOST_BLOCK_COLUMNS} lists"
            raise InputError(problem, mend='write "columns": {"position": [0.01, 0.02], ...}')
        columns = {name: json_numbers(name, given[name]) for name in self.map.keys if name in given}
        if "time" not in columns and message.get("time") is not None:
            columns["time"] = json_times(message["time"])
        ignored = self._ignored(given) if len(columns) < len(given) else ()
        return self._block(columns, message, {**more, "ignored": ignored})

    def _ignored(self, names: Iterable[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name not in self.map.keys)[:_MOST_TOLD]

    def _block(self, columns: dict[str, Array], head: Mapping[str, Any], more: dict[str, Any]) -> Block:
        if head.get("schema") != SCHEMA:
            raise InputError(f"not a block: its schema is not {SCHEMA}", mend=f'write "schema": "{SCHEMA}"')
        axis, sequence, unit = axis_name(head.get("axis")), head.get("sequence"), head.get("unit")
        if sequence is not None and (type(sequence) is not int or not 0 <= sequence <= MOST_SEQUENCE):
            raise InputError(f"axis {axis}: sequence {str(sequence)[:40]!r} is no whole number from 0 on")
        if unit is not None and (not isinstance(unit, str) or not 0 < len(unit) <= _LONGEST_UNIT):
            raise InputError(f"axis {axis}: unit is no name of a profile")
        try:
            samples = self._samples(columns)
        except InputError as error:
            raise InputError(error.problem, where=f"axis {axis}", mend=error.mend) from None
        return Block(axis, samples, sequence, unit=unit, **{"received": time.time(), **more})

    def _samples(self, columns: dict[str, Array]) -> Samples:
        if self._plain:
            found = {n: columns[n] for n in self.map.sources if n in columns}
        else:
            with np.errstate(over="ignore"):  # beyond any number is missing, as infinity is
                found = self.map.in_si(columns.get)
        stamps = found.pop("time", None)
        if stamps is None:
            mend = "give its times in s: a list, or start, period and n"
            raise InputError("no time in the block", mend=mend)
        if not 1 <= stamps.size <= MOST_BLOCK_ROWS:
            raise InputError(f"a block of {stamps.size} rows, 1 to {MOST_BLOCK_ROWS} are taken")
        if not found:
            mend = "name its columns as the channels, or give a map"
            raise InputError("no channel in the block", mend=mend)
        try:
            return Samples(stamps, found)
        except InputError:  # perhaps for what is infinite, which is missing
            return Samples(stamps, {n: np.where(np.isinf(v), np.nan, v) for n, v in found.items()})


def encode_json(block: Block) -> bytes:
    """The block as JSON of `fdd.block/1`; what is missing becomes null."""
    message = {**_head(block), "time": block.samples.time, "columns": block.samples.columns}
    return orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY)


def encode_arrow(block: Block) -> bytes:
    """The block as an Arrow IPC stream of `fdd.block/1`, float64; what is missing is NaN."""
    return arrow_payload({"time": block.samples.time, **block.samples.columns}, _head(block))


def _head(block: Block) -> dict[str, Any]:
    head = {"schema": SCHEMA, "axis": block.axis, "sequence": block.sequence, "unit": block.unit}
    return {k: v for k, v in head.items() if v is not None}


def _of_axis(head: dict[str, Any], axis: str | None) -> dict[str, Any]:
    if axis is None:
        return head
    if head.get("axis") not in (None, axis):
        # Who may publish to one axis's topic must not speak for another.
        problem = f"the message says axis {str(head['axis'])[:80]!r}, its topic {axis!r}"
        raise InputError(problem, mend="leave axis out")
    return {**head, "axis": axis}


def json_object(payload: bytes) -> dict[str, Any]:
    """A message's JSON object; NaN is taken as Python writes it. Raises InputError: it is none."""
    try:
        found = orjson.loads(payload)
    except orjson.JSONDecodeError:
        # Python's own takes NaN and integers of any size, at several times the cost.
        try:
            found = json.loads(payload)
        except (ValueError, RecursionError):
            found = None
    if not isinstance(found, dict):
        problem = f"neither a JSON object nor an Arrow stream: {payload[:40]!r}"
        raise InputError(problem, mend="send messages of fdd.block/1")
    return found


def json_numbers(name: str, values: object) -> Array:
    """A column (n,) of a list of numbers; null is NaN. Raises InputError: it is none, or too long."""
    if isinstance(values, list) and len(values) <= MOST_BLOCK_ROWS:
        try:
            column = np.array(values)
            if column.dtype == object and not any(isinstance(v, str) for v in values):
                column = np.array(values, dtype=np.float64)  # null becomes NaN
            if column.ndim == 1 and (column.dtype.kind in "fiu" or not column.size):
                return column.astype(np.float64, copy=False)
        except (TypeError, ValueError, OverflowError):
            pass
    problem = f"column {name[:40]!r} is no list of at most {MOST_BLOCK_ROWS} numbers"
    raise InputError(problem, mend="write null for missing ones")


def json_times(given: object) -> Array:
    """Times (n,) in s of a list, or of start, period and n. Raises InputError: it is neither."""
    if not isinstance(given, dict):
        return json_numbers("time", given)
    values: list[Any] = [given.get(key) for key in ("start", "period", "n")]
    start, period, n = values
    numbers = {type(start), type(period)} <= {int, float} and type(n) is int and len(given) == 3
    if not numbers or not 1 <= n <= MOST_BLOCK_ROWS:
        problem = f"time is no object of start, period and n (1 to {MOST_BLOCK_ROWS})"
        raise InputError(problem, mend='write "time": {"start": 12.3, "period": 0.001, "n": 100}')
    try:
        return float(start) + float(period) * np.arange(n, dtype=np.float64)
    except OverflowError:
        raise InputError("time starts, or goes on, beyond any number") from None


def arrow_columns(payload: bytes) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns (n,) and head of a message. Raises InputError: no Arrow stream of one batch of floats."""
    try:
        messages = pa.ipc.MessageReader.open_stream(payload)
        schema = pa.ipc.read_schema(messages.read_next_message())
        if len(schema) > MOST_BLOCK_COLUMNS or len(set(schema.names)) < len(schema):
            raise InputError(f"more than {MOST_BLOCK_COLUMNS} columns, or one twice", mend=MEND)
        odd = [n for n, t in zip(schema.names, schema.types, strict=True) if t.id not in FLOATS]
        if odd:
            raise InputError(f"column {odd[0][:40]!r} is not of float64 or float32", mend=MEND)
        message = messages.read_next_message()
        if _is_packed(message.metadata.to_pybytes()):
            # A few bytes could unpack to more than memory holds.
            raise InputError("compressed Arrow is not taken", mend=MEND)
        batch = pa.ipc.read_record_batch(message, schema)
        if batch.num_rows > MOST_BLOCK_ROWS:
            problem = f"a block of {batch.num_rows} rows, at most {MOST_BLOCK_ROWS}"
            raise InputError(problem, mend="send shorter ones")
        batch.validate(full=True)
        values = np.empty((batch.num_columns, batch.num_rows))
        if values.size:
            values = batch.to_tensor(null_to_nan=True, row_major=False).to_numpy().T.astype(float, copy=False)
        more = next(iter(messages), None) is not None
    except DAMAGE as error:
        raise InputError(f"no Arrow stream ({type(error).__name__})", mend=MEND) from None
    if more:
        raise InputError("more than one record batch", mend=MEND)
    told = {k: (schema.metadata or {}).get(k.encode()) for k in _KEYS}
    head: dict[str, Any] = {k: v.decode(errors="replace") for k, v in told.items() if v is not None}
    text = head.get("sequence", "")
    if text.isascii() and text.isdigit() and len(text) < 20:
        head["sequence"] = int(text)
    return dict(zip(schema.names, values, strict=True)), head


def arrow_payload(columns: Mapping[str, Array], head: Mapping[str, Any]) -> bytes:
    """An Arrow IPC stream of one record batch, of columns (n,) and what stands in the schema's metadata."""
    batch = pa.record_batch(dict(columns), metadata={k: str(v) for k, v in head.items()})
    out = pa.BufferOutputStream()
    with pa.ipc.new_stream(out, batch.schema) as writer:
        writer.write_batch(batch)
    return bytes(out.getvalue())


def _is_packed(flatbuffer: bytes) -> bool:
    """Whether a record batch's metadata (Message.fbs of Arrow's format) name a compression."""
    message = unpack_from("<I", flatbuffer)[0]
    header = _field(flatbuffer, message, 2) or 0
    return bool(header and _field(flatbuffer, header + unpack_from("<I", flatbuffer, header)[0], 3))


def _field(flatbuffer: bytes, table: int, number: int) -> int | None:
    """Where a field of a flatbuffer's table stands; None where it is not given."""
    names = table - unpack_from("<i", flatbuffer, table)[0]
    size, at = unpack_from("<H", flatbuffer, names)[0], 4 + 2 * number
    offset = unpack_from("<H", flatbuffer, names + at)[0] if at < size else 0
    return table + offset if offset else None
