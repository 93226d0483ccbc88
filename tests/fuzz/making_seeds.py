"""Make the small valid files that are mutated, with the formats' own libraries.

``python -m tests.fuzz --make-seeds`` writes ``tests/fuzz/seeds/KIND/NAME``. They are committed, so that a
case is the same whatever versions of the libraries are installed.
"""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

ROWS = 120
TIME = np.round(np.arange(ROWS) * 0.01, 3)
_SPEED = np.round(80.0 * np.sin(3.0 * TIME), 1)
COLUMNS = {
    "position": np.round(0.02 * (1.0 - np.cos(3.0 * TIME)), 5),
    "pump_speed": _SPEED,
    "pressure_1": np.round(6e5 + 2e3 * _SPEED, -2),
    "pressure_2": np.round(6e5 - 2e3 * _SPEED, -2),
}
FRAME = pd.DataFrame({"time": TIME, **COLUMNS})
_MAP = "\n".join(f"{c}: {{topic: /daq, field: {c}}}" for c in COLUMNS) + "\n"


def text_logs(folder: Path) -> None:
    FRAME.to_csv(folder / "csv/plain.csv", index=False)
    FRAME.to_csv(folder / "csv/semicolons.txt", index=False, sep=";", decimal=",")
    FRAME.to_csv(folder / "csv/tabs16.tsv", index=False, sep="\t", encoding="utf-16")
    units = pd.DataFrame([["s", "m", "rad/s", "Pa", "Pa"]], columns=FRAME.columns)
    body = pd.concat([units, FRAME]).to_csv(index=False, sep=";")
    (folder / "csv/titles.asc").write_text(f"Bench 3\noperator;M\u00fcller\n\n{body}", encoding="cp1252")
    dated = FRAME.assign(time=pd.Timestamp("2026-03-01 10:00:00") + pd.to_timedelta(TIME, "s"))
    dated.to_csv(folder / "csv/dated.csv", index=False)
    split = dated.assign(time=dated.time.dt.strftime("%H:%M:%S.%f"), day="2026-03-01")
    split.to_csv(folder / "csv/day_and_clock.csv", index=False)
    grouped = FRAME.assign(pressure_1=[f"{v:,.1f}" for v in FRAME.pressure_1])
    grouped.to_csv(folder / "csv/thousands.csv", index=False, sep=";")
    (folder / "gzip/plain.csv.gz").write_bytes(
        gzip.compress((folder / "csv/plain.csv").read_bytes(), mtime=0)
    )


def arrow(folder: Path) -> None:
    for codec in ("snappy", "gzip", "zstd", "lz4", "brotli", "none"):
        FRAME.to_parquet(folder / f"parquet/{codec}.parquet", compression=codec)
    FRAME.to_parquet(
        folder / "parquet/v1.parquet", version="1.0", use_dictionary=False, data_page_version="1.0"
    )
    for codec in ("lz4", "zstd", "uncompressed"):
        FRAME.to_feather(folder / f"feather/{codec}.feather", compression=codec)


def excel(folder: Path) -> None:
    FRAME[:40].to_excel(folder / "xlsx/plain.xlsx", index=False)
    with pd.ExcelWriter(folder / "xlsx/two.xlsx") as book:
        pd.DataFrame({"about": ["rig 3", "a note"]}).to_excel(book, sheet_name="cover", index=False)
        FRAME[:40].to_excel(book, sheet_name="data", startrow=3, index=False)


def matlab(folder: Path) -> None:
    from scipy.io import savemat

    flat = {"Ts": 0.01, **COLUMNS}
    nested = {"rec": {n: {"time": TIME, "value": v, "unit": "SI"} for n, v in COLUMNS.items()}}
    savemat(folder / "matlab/flat.mat", flat)
    savemat(folder / "matlab/packed.mat", flat, do_compression=True)
    savemat(folder / "matlab/nested.mat", nested)
    cells = np.array([TIME, "a", {"b": 1.0}], dtype=object)
    savemat(folder / "matlab/cells.mat", {"time": TIME, "c": cells, **COLUMNS})


def hdf5(folder: Path) -> None:
    import h5py

    with h5py.File(folder / "hdf5/chunks.h5", "w") as file:
        for name, values in {"time": TIME, **COLUMNS}.items():
            data = file.create_dataset(f"daq/{name}", data=values, compression="gzip", shuffle=True)
            data.attrs["unit"] = "SI"
    with h5py.File(folder / "hdf5/compound.h5", "w") as file:
        file["table"] = FRAME.to_records(index=False)
    with h5py.File(folder / "hdf5/latest.h5", "w", libver="latest") as file:
        file.attrs["dt"] = 0.01
        for name, values in COLUMNS.items():
            file[f"g/{name}"] = values
        file["g"].attrs["dt"] = 0.01
        file["matrix"] = np.column_stack(list(COLUMNS.values()))
        file["text"] = ["a", "bc"]
    with h5py.File(folder / "hdf5/matlab73.mat", "w", userblock_size=512) as file:
        for name, values in {"t": TIME, **COLUMNS}.items():
            file.create_dataset(f"log/{name}", data=values[None, :])
    with (folder / "hdf5/matlab73.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116))


def tdms(folder: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    stamped = {"wf_increment": 0.01, "wf_start_time": np.datetime64("2026-03-01T10:00"), "unit_string": "SI"}
    with TdmsWriter(folder / "tdms/waveform.tdms") as writer:
        writer.write_segment([ChannelObject("daq", n, v, properties=stamped) for n, v in COLUMNS.items()])
    with TdmsWriter(folder / "tdms/segments.tdms") as writer:
        for part in (slice(0, 60), slice(60, None)):
            writer.write_segment([ChannelObject("g", n, FRAME[n].to_numpy()[part]) for n in FRAME])


def mdf(folder: Path) -> None:
    from asammdf import MDF, Signal

    for name, version, packed in (("v4.mf4", "4.10", 0), ("packed.mf4", "4.20", 2), ("v3.mdf", "3.30", 0)):
        with MDF(version=version) as file:
            file.append([Signal(v, TIME, name=n, unit="SI") for n, v in COLUMNS.items()])
            file.append([Signal(40.0 + TIME[::10], TIME[::10], name="oil_temperature", unit="degC")])
            file.save(folder / f"mdf/{name}", overwrite=True, compression=packed)


def mcap_file(
    path: Path, encoding: str, schema: tuple[str, str, bytes], messages: list[bytes], **how: Any
) -> None:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4096, **how)
        writer.start()
        channel = writer.register_channel("/daq", encoding, writer.register_schema(*schema))
        for k, message in enumerate(messages):
            writer.add_message(channel, k * 10_000_000, message, 0)
        writer.add_metadata("rig", {"number": "3"})
        writer.finish()


def mcap(folder: Path) -> None:
    from mcap.writer import CompressionType

    rows = list(zip(*COLUMNS.values(), strict=True))
    told = json.dumps({"properties": {c: {"type": "number", "unit": "SI"} for c in COLUMNS}}).encode()
    texts = [
        json.dumps({**dict(zip(COLUMNS, row, strict=True)), "p": {"l": [1, k]}}).encode()
        for k, row in enumerate(rows)
    ]
    for compression in CompressionType:
        name = f"mcap/json_{compression.name.lower()}.mcap"
        mcap_file(folder / name, "json", ("Daq", "jsonschema", told), texts, compression=compression)
    mcap_file(folder / "mcap/json_loose.mcap", "json", ("Daq", "jsonschema", told), texts, use_chunking=False)
    kind, schema = _protobuf()
    messages = []
    for k, row in enumerate(rows):
        one = kind(**dict(zip(COLUMNS, row, strict=True)), s=-k, f=k, text="ab", list=[k, 2])
        one.inner.add(w=k).packed.extend([1.0, k])
        messages.append(one.SerializeToString())
    mcap_file(folder / "mcap/protobuf.mcap", "protobuf", ("rig.Daq", "protobuf", schema), messages)
    numbers = "\n".join(f"float64 {c}" for c in COLUMNS)
    rest = f"string label\nfloat32[] extra\nTag[] tags\nstring[<=4] names\nint16[3] modes\n{numbers}\n"
    tag = f"{'=' * 80}\nMSG: rig/Tag\nstring name\nfloat64 value\n"
    ros2 = [_ros(k, row, aligned=True) for k, row in enumerate(rows)]
    mcap_file(folder / "mcap/ros2.mcap", "cdr", ("rig/msg/Daq", "ros2msg", (rest + tag).encode()), ros2)
    ros1 = [_ros(k, row, aligned=False) for k, row in enumerate(rows)]
    plain = (rest + tag).replace("[<=4]", "[]").encode()
    mcap_file(folder / "mcap/ros1.mcap", "ros1", ("rig/Daq", "ros1msg", plain), ros1)


def _ros(k: int, row: tuple[float, ...], *, aligned: bool) -> bytes:
    """A message of the types above: CDR with its alignment, or ROS 1, which ends texts without a zero."""
    out, end = bytearray(), b"\0" if aligned else b""

    def put(kind: str, *values: float) -> None:
        for value in values:
            if aligned:
                out.extend(b"\0" * (-len(out) % struct.calcsize(kind)))
            out.extend(struct.pack(f"<{kind}", value))

    def text(value: bytes) -> None:
        put("I", len(value + end))
        out.extend(value + end)

    text(b"abc"[: k % 4])
    put("I", 1 + k % 2)
    put("f", *[0.5] * (1 + k % 2))
    put("I", k % 3)
    for _ in range(k % 3):
        text(b"t")
        put("d", 1.0)
    put("I", k % 2)
    for _ in range(k % 2):
        text(b"n")
    put("h", 1, -2, 3)
    put("d", *row)
    return (b"\0\1\0\0" if aligned else b"") + bytes(out)


def _protobuf() -> tuple[Any, bytes]:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="rig.proto", package="rig", syntax="proto3")
    inner = file.message_type.add(name="Inner")
    inner.field.add(name="w", number=1, type=1, label=1)
    inner.field.add(name="packed", number=2, type=1, label=3)
    outer = file.message_type.add(name="Daq")
    for number, name in enumerate(COLUMNS, 1):
        outer.field.add(name=name, number=number, type=1, label=1)
    for number, (name, kind, label) in enumerate(
        (("s", 17, 1), ("f", 2, 1), ("text", 9, 1), ("list", 17, 3)), 10
    ):
        outer.field.add(name=name, number=number, type=kind, label=label)
    outer.field.add(name="inner", number=20, type=11, label=3, type_name=".rig.Inner")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("rig.Daq"))
    return made, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def texts(folder: Path) -> None:
    (folder / "map/topics.yaml").write_text(_MAP)
    (folder / "words/own.yaml").write_text(
        "schema: fdd.words/1\nwords:\n  pressure: [druk, p]\n  position: [weg, stand]\n"
    )
    answer = {
        "schema": "fdd.diagnosis/1", "log": "run.mcap", "axis": "axis_a", "unit": "axis_a",
        "duration_s": 60.0, "samples": 60000, "verdict": "faulty",
        "probabilities": {"healthy": 0.1, "leakage": 0.9},
        "faults": [{
            "fault": "internal_leakage", "family": "leakage", "ambiguity": ["internal_leakage"],
            "confidence": 0.97, "onset_s": 20.3, "detected_s": 20.9, "severity": 0.41, "evidence": ["a leak"],
        }],
        "estimates": {}, "quality": {"dropped_samples": 3, "nan_samples": 0, "time_jumps": 0, "notes": []},
        "versions": {"fdd": "0.1.0"}, "sha256": {"log": "0" * 64},
    }  # fmt: skip
    (folder / "answers/answers.jsonl").write_text((json.dumps(answer) + "\n") * 2)
    lines = [json.dumps({k: float(v) for k, v in row.items()}) for row in FRAME[:40].to_dict("records")]
    (folder / "lines/stream.jsonl").write_text("\n".join(lines) + "\n")


WRITERS: tuple[Callable[[Path], None], ...] = (text_logs, arrow, excel, matlab, hdf5, tdms, mdf, mcap, texts)


def make_all(folder: Path) -> None:
    """Write all seeds below a folder."""
    for kind in ("csv", "gzip", "parquet", "feather", "xlsx", "matlab", "hdf5", "tdms", "mdf", "mcap",
                 "map", "words", "answers", "lines"):  # fmt: skip
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for write in WRITERS:
        write(folder)
