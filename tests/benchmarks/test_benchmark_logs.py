"""Speed of logs, written and read, beside peers: ``pytest tests/benchmarks --benchmark-enable -k logs``."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from fdd.logs.formats import open_log

pytestmark = pytest.mark.slow


MESSAGES = 60_000
"""A minute at 1 kHz, of ten numbers each."""
NAMES = [f"signal_{k}" for k in range(10)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same messages in each encoding, one a sample, as other people's recorders write them."""
    from google.protobuf import descriptor_pb2

    rows = np.random.default_rng(1).normal(size=(MESSAGES, len(NAMES))).cumsum(axis=0)
    file = descriptor_pb2.FileDescriptorProto(name="d.proto", package="rig", syntax="proto3")
    kind = file.message_type.add(name="Daq")
    for k, name in enumerate(NAMES, 1):
        kind.field.add(name=name, number=k, type=1, label=1)
    descriptors = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    ros = "\n".join(f"float64 {n}" for n in NAMES).encode()
    kinds: dict[str, tuple[tuple[str, str, bytes], Any]] = {
        "json": (
            ("Daq", "jsonschema", b"{}"),
            lambda r: json.dumps(dict(zip(NAMES, r, strict=True))).encode(),
        ),
        "protobuf": (
            ("rig.Daq", "protobuf", descriptors),
            lambda r: b"".join(bytes([k << 3 | 1]) + struct.pack("<d", v) for k, v in enumerate(r, 1)),
        ),
        "cdr": (("rig/msg/Daq", "ros2msg", ros), lambda r: b"\0\1\0\0" + struct.pack("<10d", *r)),
    }
    out = {}
    for encoding, (schema, packed) in kinds.items():
        out[encoding] = tmp_path_factory.mktemp("recorded") / f"{encoding}.mcap"
        with out[encoding].open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            channel = writer.register_channel("/daq", encoding, writer.register_schema(*schema))
            for k, row in enumerate(rows.tolist()):
                writer.add_message(channel, k * 10**6, packed(row), 0)
            writer.finish()
    return out


def plainly(path: Path, encoding: str) -> list[list[float]]:
    """The library's reader and the encoding's own decoder, message by message."""
    factories: list[Any] = []
    if encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory

        factories = [DecoderFactory()]
    elif encoding == "cdr":
        from mcap_ros2.decoder import DecoderFactory as RosFactory

        factories = [RosFactory()]
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=factories)
        if encoding == "json":
            return [[m[n] for n in NAMES] for m in (json.loads(x[2].data) for x in reader.iter_messages())]
        return [[getattr(x.decoded_message, n) for n in NAMES] for x in reader.iter_decoded_messages()]


@pytest.mark.parametrize("by", ["fdd", "plain reader"])
@pytest.mark.parametrize("encoding", ["json", "protobuf", "cdr"])
def test_reading_messages(benchmark: Any, recorded: dict[str, Path], encoding: str, by: str) -> None:
    benchmark.group = f"reading {encoding} messages"
    benchmark.extra_info["messages"] = MESSAGES

    def read() -> Any:
        if by == "plain reader":
            return np.array(plainly(recorded[encoding], encoding))[:, 0]
        log = open_log(recorded[encoding])
        return log.read(list(log.signals))["/daq.signal_0"]

    values = benchmark(read)
    assert values.shape == (MESSAGES,)
