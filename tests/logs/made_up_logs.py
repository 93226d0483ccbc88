"""Made-up logs, and how an error line must look."""

import json
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from fdd.logs import Log, read_log
from fdd.logs.mcap_writing import RunBlock
from fdd.samples import Samples
from tests.refusal import refused


def strokes(n: int = 6000, seed: int = 5) -> Samples:
    """A cylinder going to and fro at 1 kHz, with plausible magnitudes in every channel."""
    noise = np.random.default_rng(seed)
    time = np.arange(n) * 1e-3
    sine = np.sin(2.0 * np.pi * 0.5 * time)
    speed = 80.0 * sine
    angle = np.cumsum(speed) * 1e-3
    pressure_1, pressure_2 = (6e5 + side * sine + 3e3 * noise.standard_normal(n) for side in (2e5, -2e5))
    return Samples(
        time,
        {
            "command": speed,
            "pump_angle": angle,
            "pump_speed": speed,
            "position": 3.6e-4 * angle,
            "pressure_difference": pressure_1 - pressure_2,
            "pressure_1": pressure_1,
            "pressure_2": pressure_2,
            "oil_temperature": np.full(n, 40.0),
        },
    )


def frame(n: int = 6000) -> pd.DataFrame:
    """The same as a table with the contract's names."""
    samples = strokes(n)
    return pd.DataFrame({"time": samples.time, **samples.columns})


ROWS = 1200
A, B = strokes(ROWS, seed=1), strokes(ROWS, seed=2)
# The axes are sampled together, but B loses rows of its own.
B = Samples(B.time[np.arange(ROWS) % 7 > 0], {c: v[np.arange(ROWS) % 7 > 0] for c, v in B.columns.items()})


def parts(samples: Samples, edges: list[int], axis: str, thin: int = 10) -> list[RunBlock]:
    """Blocks between the edges, with every `thin`-th row's truth; 0 for none."""
    bounds = [0, *sorted(min(e, len(samples)) for e in edges), len(samples)]
    blocks = []
    for start, stop in pairwise(bounds):
        truth = None
        if thin:
            rows = np.arange(start, stop)[np.arange(start, stop) % thin == 0]
            truth = {"time": samples.time[rows], "leakage": 1e-12 * rows, "stuck": rows % 2 == 0}
        blocks.append(RunBlock(samples.rows(start, stop), truth, axis))
    return blocks


def refused_log(path: Path, *args: object, **kwargs: object) -> str:
    """The line that refuses a log; it must begin with the file."""
    line = refused(lambda: read_log(path, *args, **kwargs))
    assert line.startswith(f"{path}: "), line
    return line


def assert_same(log: Log, samples: Samples) -> None:
    """The log has the samples' channels, bit for bit (apart from the sign of zero)."""
    np.testing.assert_array_equal(log.samples.time, samples.time)
    for name in samples.channels:
        np.testing.assert_array_equal(log.samples.get(name), samples[name], err_msg=name)


def mcap_of(
    path: Path, messages: Iterable[bytes], topic: str = "/daq", encoding: str = "json",
    schema: tuple[str, str, bytes] | None = None, start_ns: int = 0, **how: Any,
) -> Path:  # fmt: skip
    """A file of messages a millisecond apart, as the library writes it."""
    with path.open("wb") as stream:
        writer = Writer(stream, **how)
        writer.start()
        number = 0 if schema is None else writer.register_schema(*schema)
        channel = writer.register_channel(topic, encoding, number)
        for k, message in enumerate(messages):
            writer.add_message(channel, start_ns + k * 10**6, message, 0)
        writer.finish()
    return path


def as_dict(message: Any) -> dict[str, Any]:
    """A decoded Protobuf message's fields that are there, in the order of their numbers."""
    return {
        field.name: as_dict(value) if field.message_type else value for field, value in message.ListFields()
    }


def messages(path: Path) -> list[tuple[int, str, dict[str, Any]]]:
    """Log time, topic and fields of each message, as the MCAP and Protobuf libraries read them through the
    index, in the order of time; checksums are checked."""
    protobuf, decoders, found = DecoderFactory(), {}, []
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            if channel.id not in decoders:
                decoded = protobuf.decoder_for(channel.message_encoding, schema)
                decoders[channel.id] = json.loads if decoded is None else lambda d, f=decoded: as_dict(f(d))
            found.append((message.log_time, channel.topic, decoders[channel.id](message.data)))
    return found


def of_topic(path: Path, topic: str) -> list[dict[str, Any]]:
    return [fields for _, name, fields in messages(path) if name == topic]
