"""The Arrow form of a block: one record batch of floats, its head in the schema's metadata."""

from __future__ import annotations

from collections.abc import Mapping
from struct import error as StructError
from struct import unpack_from
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fdd.bounds import MOST_BLOCK_COLUMNS, MOST_BLOCK_ROWS
from fdd.errors import InputError

Array = NDArray[np.float64]

ARROW_START = b"\xff\xff\xff\xff"
"""First bytes of an Arrow IPC stream."""
_DAMAGE = (pa.ArrowException, OSError, StructError, StopIteration, UnicodeDecodeError, MemoryError)
_FLOATS = (pa.float64().id, pa.float32().id)
_MEND = "send one record batch of float64 or float32 columns as an IPC stream, not compressed"


def arrow_columns(payload: bytes) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns (n,) and head of a message.

    Raises InputError: no Arrow stream of one bounded batch of floats.
    """
    try:
        messages = pa.ipc.MessageReader.open_stream(payload)
        schema = pa.ipc.read_schema(messages.read_next_message())
        if len(schema) > MOST_BLOCK_COLUMNS or len(set(schema.names)) < len(schema):
            raise InputError(f"more than {MOST_BLOCK_COLUMNS} columns, or one twice", mend=_MEND)
        odd = [n for n, t in zip(schema.names, schema.types, strict=True) if t.id not in _FLOATS]
        if odd:
            raise InputError(f"column {odd[0][:40]!r} is not of float64 or float32", mend=_MEND)
        message = messages.read_next_message()
        if _is_packed(message.metadata.to_pybytes()):
            # A few bytes could unpack to more than memory holds.
            raise InputError("compressed Arrow is not taken", mend=_MEND)
        batch = pa.ipc.read_record_batch(message, schema)
        if batch.num_rows > MOST_BLOCK_ROWS:
            raise InputError(
                f"a block of {batch.num_rows} rows, at most {MOST_BLOCK_ROWS}", mend="send shorter ones"
            )
        batch.validate(full=True)
        values = np.empty((batch.num_columns, batch.num_rows))
        if values.size:
            values = batch.to_tensor(null_to_nan=True, row_major=False).to_numpy().T.astype(float, copy=False)
        more = next(iter(messages), None) is not None
    except _DAMAGE as error:
        raise InputError(f"no Arrow stream ({type(error).__name__})", mend=_MEND) from None
    if more:
        raise InputError("more than one record batch", mend=_MEND)
    return dict(zip(schema.names, values, strict=True)), _head(schema.metadata or {})


def arrow_payload(columns: Mapping[str, Array], head: Mapping[str, Any]) -> bytes:
    """An Arrow IPC stream of one record batch.

    Parameters
    ----------
    columns : (n,) each. head : what stands in the schema's metadata.
    """
    fields = [pa.field(name, pa.float64()) for name in columns]
    schema = pa.schema(fields, metadata={k: str(v) for k, v in head.items()})
    out = pa.BufferOutputStream()
    with pa.ipc.new_stream(out, schema) as writer:
        writer.write_batch(pa.record_batch([pa.array(v) for v in columns.values()], schema=schema))
    return bytes(out.getvalue())


def _head(metadata: Mapping[bytes, bytes]) -> dict[str, Any]:
    keys = ("schema", "axis", "sequence", "unit")
    head: dict[str, Any] = {
        k: metadata[k.encode()].decode(errors="replace") for k in keys if k.encode() in metadata
    }
    text = head.get("sequence")
    if text is not None and text.isascii() and text.isdigit() and len(text) < 20:
        head["sequence"] = int(text)
    return head


def _is_packed(flatbuffer: bytes) -> bool:
    """Whether a record batch's metadata (Message.fbs of Arrow's format) name a compression."""
    message = unpack_from("<I", flatbuffer)[0]
    header = _field(flatbuffer, message, 2)
    return (
        header is not None
        and _field(flatbuffer, header + unpack_from("<I", flatbuffer, header)[0], 3) is not None
    )


def _field(flatbuffer: bytes, table: int, number: int) -> int | None:
    """Where a field of a flatbuffer's table stands; None where it is not given."""
    names = table - unpack_from("<i", flatbuffer, table)[0]
    size, at = unpack_from("<H", flatbuffer, names)[0], 4 + 2 * number
    offset = unpack_from("<H", flatbuffer, names + at)[0] if at < size else 0
    return table + offset if offset else None
