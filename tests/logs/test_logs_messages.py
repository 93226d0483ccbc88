"""MCAP messages of every encoding, written by the encodings' own libraries, against what these read.

``pytest tests/logs --benchmark-enable -k reading`` times them.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from made_up_logs import mcap_of, refused, refused_log

from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import open_log

N = 300
TIME = np.arange(N) * 1e-3
RNG = np.random.default_rng(11)
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


def test_reading_ros2_messages_of_any_shape(benchmark: Any, tmp_path: Path) -> None:
    from mcap_ros2.writer import Writer as RosWriter

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = RosWriter(stream)
        schema = writer.register_msgdef("rig_msgs/msg/Daq", ROS2)
        for k in range(N):
            writer.write_message("/daq", schema, ros_message(k), log_time=k * 10**6, publish_time=0)
        writer.finish()
    log = open_log(tmp_path / "a.mcap")
    names = ["motor.speed", "motor.counts", "pressures[1]", "extra[0]", "running", "mode"]
    names += ["position", "header.stamp"]
    assert {f"/daq.{n}" for n in names} <= set(log.signals)
    read = benchmark(log.read, [f"/daq.{n}" for n in names])
    k = np.arange(N)
    wanted = (0.5 * k, -(2.0**40) - k, 2e5 - k, 0.25 * k, k % 2 == 0, -3.0 + 0 * k, 1e-3 * k, 7 + 1e-3 * k)
    for name, values in zip(names, wanted, strict=True):
        np.testing.assert_allclose(read[f"/daq.{name}"], values, rtol=1e-12, err_msg=name)
    channel_map = ChannelMap.from_yaml(
        "position: {topic: /daq, field: position}\npump_speed: {topic: /daq, field: motor.speed}\n"
        "pressure_1: {topic: /daq, field: 'pressures[0]'}\npressure_2: {topic: /daq, field: 'pressures[1]'}\n"
    )
    samples = read_log(tmp_path / "a.mcap", channel_map, shortest=0.1).samples
    np.testing.assert_allclose(samples["position"], 1e-3 * k)


def test_ros2_in_the_other_byte_order_and_ros1(tmp_path: Path) -> None:
    text = b"uint8 a\nfloat64 x\nint16 b\nfloat32[] c\n"
    big, ros1 = [], []
    for k in range(N):
        big.append(
            b"\0\0\0\0" + struct.pack(">B7xdhxx", k % 256, 0.5 * k, -k) + struct.pack(">Iff", 2, 1.5 * k, 9.0)
        )
        ros1.append(struct.pack("<BdhI", k % 256, 0.5 * k, -k, 2) + struct.pack("<ff", 1.5 * k, 9.0))
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


def test_reading_protobuf_messages(benchmark: Any, tmp_path: Path) -> None:
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


def test_a_cut_protobuf_message_is_told(tmp_path: Path) -> None:
    kind, schema = protobuf_schema()
    whole = kind(d=1.5, s64=-1).SerializeToString()
    path = mcap_of(
        tmp_path / "a.mcap", [whole, whole[:7]], "/daq", "protobuf", ("rig.Daq", "protobuf", schema)
    )
    assert "a Protobuf message is damaged" in refused(lambda: open_log(path).read(["/daq.d"]))


def test_reading_json_of_every_make_up(benchmark: Any, tmp_path: Path) -> None:
    """Test: messages over several lines, absent and null members, lists, NaN. Expected: json's own values."""
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


def test_what_cannot_be_read_says_why(tmp_path: Path) -> None:
    wanted = ChannelMap.from_yaml("position: {topic: /daq, field: x}")
    for encoding, schema, said in (
        ("cbor", ("T", "", b""), "carries cbor messages"),
        ("cdr", ("p/T", "ros2idl", b"struct"), "with a schema in ros2idl"),
        ("cdr", ("p/T", "ros2msg", b"Other x\n"), "no definition of the ROS type p/Other"),
        ("protobuf", ("rig.Daq", "protobuf", b"\xff\xff"), "damaged Protobuf schema"),
    ):
        path = mcap_of(tmp_path / "a.mcap", [b"\0\1\0\0" * 4] * 3, "/daq", encoding, schema)
        assert said in refused_log(path, wanted)
