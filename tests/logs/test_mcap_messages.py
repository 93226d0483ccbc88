"""MCAP messages of every encoding, written by the encodings' own libraries, against what these read.

``pytest tests/logs --benchmark-enable -k reading`` times them.
"""

import itertools
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_logs import mcap_of, refused, refused_log
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import open_log

N = 300
ROS2 = """std_msgs/Header header
string label
Motor motor
float64[3] pressures
float32[] extra
Tag[] tags
string[<=4] names
bool running
int16 mode
uint8 MODE_A=1
float64 position # m
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: rig_msgs/Motor
float32 speed
int64 counts
================================================================================
MSG: rig_msgs/Tag
string name
float64 value
"""


def ros_message(k: int) -> dict[str, Any]:
    return {
        "header": {"stamp": {"sec": 7, "nanosec": k * 1_000_000}, "frame_id": "x" * (k % 5)},
        "label": "é" * (k % 3),
        "motor": {"speed": 0.5 * k, "counts": -(2**40) - k},
        "pressures": [1e5 + k, 2e5 - k, 3e5],
        "extra": [0.25 * k, -1.0][: 1 + k % 2],
        "tags": [{"name": "t" * j, "value": 1.0} for j in range(k % 3)],
        "names": ["a", "bc"][: k % 3],
        "running": k % 2 == 0,
        "mode": -3,
        "position": 1e-3 * k,
    }


def test_reading_ros2_messages_of_any_shape(benchmark, tmp_path):
    from mcap_ros2.writer import Writer as RosWriter

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = RosWriter(stream)
        schema = writer.register_msgdef("rig_msgs/msg/Daq", ROS2)
        for k in range(N):
            writer.write_message("/daq", schema, ros_message(k), log_time=k * 10**6, publish_time=0)
        writer.finish()
    log = open_log(tmp_path / "a.mcap")
    k = np.arange(N)
    wanted = {
        "motor.speed": 0.5 * k, "motor.counts": -(2.0**40) - k, "pressures[1]": 2e5 - k, "extra[0]": 0.25 * k,
        "running": k % 2 == 0, "mode": -3.0 + 0 * k, "position": 1e-3 * k, "header.stamp": 7 + 1e-3 * k,
    }  # fmt: skip
    assert {f"/daq.{n}" for n in wanted} <= set(log.signals)
    read = benchmark(log.read, [f"/daq.{n}" for n in wanted])
    for name, values in wanted.items():
        np.testing.assert_allclose(read[f"/daq.{name}"], values, rtol=1e-12, err_msg=name)
    channel_map = ChannelMap.from_yaml(
        "position: {topic: /daq, field: position}\npump_speed: {topic: /daq, field: motor.speed}\n"
        "pressure_1: {topic: /daq, field: 'pressures[0]'}\npressure_2: {topic: /daq, field: 'pressures[1]'}\n"
    )
    samples = read_log(tmp_path / "a.mcap", channel_map, shortest=0.1).samples
    np.testing.assert_allclose(samples["position"], 1e-3 * k)


def test_ros2_in_the_other_byte_order_and_ros1(tmp_path):
    text = b"uint8 a\nfloat64 x\nint16 b\nfloat32[] c\n"
    big, ros1 = [], []
    for k in range(N):
        big.append(b"\0\0\0\0" + struct.pack(">B7xdhxxIff", k % 256, 0.5 * k, -k, 2, 1.5 * k, 9.0))
        ros1.append(struct.pack("<BdhIff", k % 256, 0.5 * k, -k, 2, 1.5 * k, 9.0))
    for encoding, kind, messages in (("cdr", "ros2msg", big), ("ros1", "ros1msg", ros1)):
        path = mcap_of(tmp_path / f"{encoding}.mcap", messages, "/daq", encoding, ("p/msg/T", kind, text))
        read = open_log(path).read(["/daq.x", "/daq.b", "/daq.c[0]", "/daq.c[1]"])
        for values, wanted in zip(read.values(), (0.5, -1.0, 1.5), strict=False):
            np.testing.assert_allclose(values, wanted * np.arange(N))
        assert (read["/daq.c[1]"] == 9.0).all()


def protobuf_schema() -> tuple[Any, bytes]:
    """A message class with numbers, text, nested and repeated members, and its descriptor set."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="daq.proto", package="rig", syntax="proto3")
    inner = file.message_type.add(name="Inner")
    inner.field.add(name="w", number=1, type=1, label=1)
    inner.field.add(name="packed", number=2, type=1, label=3)
    outer = file.message_type.add(name="Daq")
    for number, (name, kind) in enumerate({"d": 1, "f": 2, "u64": 4, "flag": 8, "s64": 18}.items(), 1):
        outer.field.add(name=name, number=number, type=kind, label=1)
    outer.field.add(name="text", number=20, type=9, label=1)
    outer.field.add(name="motor", number=21, type=11, label=1, type_name=".rig.Inner")
    outer.field.add(name="many", number=22, type=11, label=3, type_name=".rig.Inner")
    outer.field.add(name="list", number=3000, type=17, label=3)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("rig.Daq"))
    return kind, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def test_reading_protobuf_messages(benchmark, tmp_path):
    kind, schema = protobuf_schema()
    messages, wanted = [], []
    for k in range(N):
        values = {"d": 0.1 * k, "f": 0.5 * k, "u64": 2**40 + k, "flag": k % 2 == 0, "s64": k - 150}
        one = kind(text="ü" * (k % 7), list=[k, -k], **values)
        one.motor.w = 2.0 * k
        one.motor.packed.extend([1.0 * k, 2.0, 3.0])
        for j in range(2):
            one.many.add(w=k + 0.25 * j)
        messages.append(one.SerializeToString())
        wanted.append([*values.values(), 2.0 * k, k, k + 0.25, -k])
    path = mcap_of(tmp_path / "a.mcap", messages, "/daq", "protobuf", ("rig.Daq", "protobuf", schema))
    log = open_log(path)
    assert "/daq.list[2]" not in log.signals and "/daq.many[2].w" not in log.signals
    names = ("d", "f", "u64", "flag", "s64", "motor.w", "motor.packed[0]", "many[1].w", "list[1]")
    read = benchmark(log.read, [f"/daq.{n}" for n in names])
    np.testing.assert_array_equal(np.column_stack([read[f"/daq.{n}"] for n in names]), wanted)


def test_reading_json_of_every_make_up(benchmark, tmp_path):
    """Messages over several lines, absent and null members, lists, NaN."""
    objects: list[dict[str, Any]] = [
        {"x": 0.5 * k, "p": {"a": k, "list": [k, 2.0]}, "on": k % 2 == 0, **({} if k % 3 else {"rare": None})}
        for k in range(N)
    ]
    objects[7]["x"] = float("nan")
    del objects[9]["p"]["a"]
    texts = [json.dumps(o, indent=2 if k % 50 == 0 else None).encode() for k, o in enumerate(objects)]
    schema = ("Daq", "jsonschema", b'{"properties": {"x": {"unit": "mm"}}}')
    log = open_log(mcap_of(tmp_path / "a.mcap", texts, "/daq", "json", schema))
    assert log.signals["/daq.x"].unit == "mm"
    read = benchmark(log.read, [f"/daq.{n}" for n in ("x", "p.a", "p.list[0]", "on")])
    row = np.arange(N)
    wanted = (np.where(row == 7, np.nan, 0.5 * row), np.where(row == 9, np.nan, row), row, row % 2 == 0)
    for values, expected in zip(read.values(), wanted, strict=True):
        np.testing.assert_array_equal(values, expected)


def test_what_cannot_be_read_says_why(tmp_path):
    wanted = ChannelMap.from_yaml("position: {topic: /daq, field: x}")
    for encoding, schema, said in (
        ("cbor", ("T", "", b""), "carries cbor messages"),
        ("cdr", ("p/T", "ros2idl", b"struct"), "with a schema in ros2idl"),
        ("cdr", ("p/T", "ros2msg", b"Other x\n"), "no definition of the ROS type p/Other"),
        ("protobuf", ("rig.Daq", "protobuf", b"\xff\xff"), "damaged Protobuf schema"),
    ):
        path = mcap_of(tmp_path / "a.mcap", [b"\0\1\0\0" * 4] * 3, "/daq", encoding, schema)
        assert said in refused_log(path, wanted)
    kind, schema = protobuf_schema()
    whole = kind(d=1.5, s64=-1).SerializeToString()
    damaged = [whole, whole[:7]]
    path = mcap_of(tmp_path / "a.mcap", damaged, "/daq", "protobuf", ("rig.Daq", "protobuf", schema))
    assert "a Protobuf message is damaged" in refused(lambda: open_log(path).read(["/daq.d"]))


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
def test_all_options_are_read(content, tmp_path):
    """All combinations of the format's options, as in MCAP's own conformance cases; half of them padded."""
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


def test_messages_without_fields_refuse_nothing(tmp_path):
    """Their topics have stamps and no signals; the fields behind an empty one are at their place."""
    inner = b"std_msgs/Empty e\nuint8 a\n" + b"=" * 80 + b"\nMSG: std_msgs/Empty\n"
    path = tmp_path / "empty.mcap"
    kinds = {
        "/cdr": ("cdr", "std_msgs/msg/Empty", "ros2msg", b"", b"\0\1\0\0\0"),
        "/constants": ("cdr", "p/msg/C", "ros2msg", b"uint8 A=1  # is no field\n", b"\0\1\0\0\0"),
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
