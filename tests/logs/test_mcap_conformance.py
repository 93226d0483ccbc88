"""MCAP files in all combinations of the format's options, as in the project's own conformance cases.

The cases are made here by the project's Python writer: nothing, an attachment, metadata, one message with and
without a schema, ten messages; each in chunks or not, with and without message indexes, repeated channels and
schemas, statistics, summary offsets and checksums, compressions in turn, with padded and unknown records.
"""

from __future__ import annotations

import itertools
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from fdd.logs.formats import open_log

CONTENTS = {"nothing": 0, "attachment": 0, "metadata": 0, "message": 1, "schemaless": 1, "messages": 10}
OPTIONS = ("use_chunking", "repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets")
NOT_PADDED = (Opcode.FOOTER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
"""Records whose length tells how long their last field is, or that the format says are not extended."""


class Padded:
    """The library's record builder, which adds bytes to records and writes records that nobody knows."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        start, finish = RecordBuilder.start_record, RecordBuilder.finish_record

        def started(builder: Any, opcode: Opcode) -> None:
            if opcode in (Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT):
                builder.write(struct.pack("<BQ", 0x7F, 3) + b"new" + struct.pack("<BQ", 0x80, 0))
            builder.padded = opcode not in NOT_PADDED
            start(builder, opcode)

        def finished(builder: Any) -> None:
            if builder.padded:
                builder.write(b"\x01\x02\x03\x04")
            finish(builder)

        patch.setattr(RecordBuilder, "start_record", started)
        patch.setattr(RecordBuilder, "finish_record", finished)


def case(path: Path, content: str, how: dict[str, Any]) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, **how)
        writer.start(profile="x", library="y")
        if content == "attachment":
            writer.add_attachment(2, 1, "a", "text/plain", b"\x01\x02\x03")
        if content == "metadata":
            writer.add_metadata("m", {"foo": "bar"})
        if CONTENTS[content]:
            schema = 0 if content == "schemaless" else writer.register_schema("t", "jsonschema", b"{}")
            channel = writer.register_channel("/daq", "json", schema, {"foo": "bar"})
            for k in range(CONTENTS[content]):
                writer.add_message(channel, 10 * k, json.dumps({"x": 0.5 * k}).encode(), 0)
        writer.finish()


@pytest.mark.parametrize("content", CONTENTS)
def test_all_options_are_read(content: str, tmp_path: Path) -> None:
    """Test: each combination, half of them padded. Expected: signals, stamps and metadata as written."""
    path = tmp_path / "case.mcap"
    compressions = itertools.cycle(CompressionType)
    for k, flags in enumerate(itertools.product((False, True), repeat=len(OPTIONS) + 1)):
        with pytest.MonkeyPatch.context() as patch:
            if k.bit_count() % 2:
                Padded(patch)
            how = dict(zip(OPTIONS, flags, strict=False))
            index = IndexType.ALL if flags[-1] else IndexType.NONE
            crcs = {"enable_crcs": k % 2 == 0, "enable_data_crcs": k % 5 == 0}
            case(path, content, {**how, **crcs, "index_types": index, "compression": next(compressions)})
            told, count = open_log(path), CONTENTS[content]
            assert list(told.signals) == (["/daq.x"] if count else []), how
            assert told.metadata == ({"m": {"foo": "bar"}} if content == "metadata" else {}), how
            if count:
                np.testing.assert_array_equal(told.read(["/daq.x"])["/daq.x"], 0.5 * np.arange(count))
                stamps = told.stamps("/daq")
                assert stamps is not None
                np.testing.assert_allclose(stamps, 1e-8 * np.arange(count))
            assert not told.truncated and not getattr(told, "damaged", 0), how


EMPTY = b"uint8 BEFORE=1  # a constant alone is no field\n"


def test_messages_without_fields_refuse_nothing(tmp_path: Path) -> None:
    """Test: ROS 2, ROS 1 and JSON messages without a field beside others, and one inside another.

    Expected: their topics have stamps and no signals; the fields behind the empty one are at their place.
    """
    inner = b"std_msgs/Empty e\nuint8 a\n" + b"=" * 80 + b"\nMSG: std_msgs/Empty\n"
    path = tmp_path / "empty.mcap"
    kinds = {
        "/cdr": ("cdr", "std_msgs/msg/Empty", "ros2msg", b"", b"\0\1\0\0\0"),
        "/constants": ("cdr", "p/msg/C", "ros2msg", EMPTY, b"\0\1\0\0\0"),
        "/ros1": ("ros1", "std_msgs/Empty", "ros1msg", b"", b""),
        "/json": ("json", "e", "jsonschema", b"", b"{}"),
        "/inside": ("cdr", "p/msg/T", "ros2msg", inner, b"\0\1\0\0\0\7"),
        "/inside1": ("ros1", "p/T", "ros1msg", inner, b"\7"),
    }
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, (encoding, name, kind, schema, message) in kinds.items():
            channel = writer.register_channel(topic, encoding, writer.register_schema(name, kind, schema))
            for k in range(3):
                writer.add_message(channel, k * 10**6, message, 0)
        writer.finish()
    told = open_log(path)
    assert list(told.signals) == ["/inside.a", "/inside1.a"] and set(told.topics) == set(kinds)
    assert not getattr(told, "reasons", None)
    assert [v.tolist() for v in told.read(told.signals).values()] == [[7.0] * 3] * 2
    for topic in kinds:
        stamps = told.stamps(topic)
        assert stamps is not None and stamps.tolist() == [0.0, 1e-3, 2e-3]
