"""The troubles: each lasts while its context does."""

from __future__ import annotations

import http.client
import random
import resource
import shutil
import socket
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import orjson
import paho.mqtt.client as paho

from fdd.service.blocks import encode_arrow, encode_json
from reports.service import Process
from reports.troubles.trial import Mqtt, Sender, blocks_of, leaking


@contextmanager
def locked(process: Process, sender: Sender) -> Iterator[None]:
    """Another program holds the store's lock."""
    other = sqlite3.connect(process.state / "fdd.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.execute("ROLLBACK")
        other.close()


@contextmanager
def full(process: Process, sender: Sender) -> Iterator[None]:
    """A file fills the disk (a small tmpfs) that the state folder is on."""
    filler = process.state / "filler"
    with filler.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        filler.unlink()


@contextmanager
def no_growth(process: Process, sender: Sender) -> Iterator[None]:
    """No file of the process may grow beyond 64 KiB (RLIMIT_FSIZE), as with a quota."""
    pid, kind = process.popen.pid, resource.RLIMIT_FSIZE
    soft, hard = resource.prlimit(pid, kind)
    resource.prlimit(pid, kind, (1 << 16, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, kind, (soft, hard))


@contextmanager
def renamed_file(process: Process, sender: Sender) -> Iterator[None]:
    """The store's file is moved away, and later back."""
    path = process.state / "fdd.db"
    path.rename(away := path.with_name("away.db"))
    try:
        yield
    finally:
        away.rename(path)


@contextmanager
def renamed_folder(process: Process, sender: Sender) -> Iterator[None]:
    """The state folder is moved away, and later back."""
    away = process.state.with_name("away")
    process.state.rename(away)
    try:
        yield
    finally:
        if process.state.exists():
            shutil.rmtree(process.state)
        away.rename(process.state)


@contextmanager
def broker_away(process: Process, sender: Sender) -> Iterator[None]:
    """The broker is stopped, and started again."""
    assert isinstance(sender, Mqtt)
    sender.broker.stop()
    try:
        yield
    finally:
        sender.broker.start()


@contextmanager
def clock_ahead(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is an hour ahead, and set back."""
    with _clock(process.clock, 3600):
        yield


@contextmanager
def clock_back(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is set back by an hour, and is set right."""
    with _clock(process.clock, -3600):
        yield


@contextmanager
def _clock(clock: Path, off: int) -> Iterator[None]:
    for seconds in (off, 0):
        (new := clock.with_name("clock.new")).write_text(str(seconds))
        new.rename(clock)
        if seconds:
            yield


@contextmanager
def set_in_the_middle(process: Process, sender: Sender) -> Iterator[None]:
    """From the middle of the run on its stamps are an hour off."""
    yield


def garbage(seed: int = 3) -> Iterator[bytes]:
    """Messages that are no blocks, or almost."""
    rng = random.Random(seed)
    good = replace(blocks_of(leaking())[0], axis="G1")
    for length in (0, 1, 7, 100, 10_000, 1_000_000):
        yield rng.randbytes(length)
    for whole in (encode_arrow(good), encode_json(good)):
        yield from (whole[: rng.randrange(len(whole))] for _ in range(100))
        for _ in range(200):
            bent = bytearray(whole)
            for _ in range(rng.randint(1, 8)):
                bent[rng.randrange(len(bent))] = rng.randrange(256)
            yield bytes(bent)
    for deep in (b"[", b'{"a":', b'{"columns":{"position":['):
        yield deep * 200_000
    yield b'{"schema":"fdd.block/1","axis":"' + b"A" * (17 << 20) + b'"}'
    yield b'{"schema":"fdd.block/1","axis":"G1","columns":{"position":[' + b"1," * 2_000_000 + b"1]}}"
    message = orjson.loads(encode_json(good))
    never = ("NaN", "Infinity", "-Infinity", "1e400", "1e308", "-1e308", '"1"', "null", "true", "[[1]]", "{}",
             "9" * 5000, "[NaN,1]", "[0,Infinity]", "[1,0]", "[0,0]", '{"start":1e308,"period":1e308,"n":9}',
             '{"start":0,"period":-1,"n":5}', '{"start":0,"period":1,"n":1000000000000}')  # fmt: skip
    for key in ("time", "sequence", "axis", "unit", "columns", "schema"):
        for value in never:
            yield orjson.dumps(message | {key: "HERE"}).replace(b'"HERE"', value.encode())
    for axis in ("", ".", "../../etc", "a" * 65, "a\n", "\x00", "<b>", "é"):
        yield orjson.dumps(message | {"axis": axis})


@contextmanager
def garbage_sent(process: Process, sender: Sender) -> Iterator[None]:
    """Random, truncated, giant, deeply nested messages and impossible stamps over MQTT, TCP, UDP and HTTP."""
    ports = {source["type"]: source["port"] for source in process.sources}
    client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="garbage")
    client.connect("127.0.0.1", ports["mqtt"])
    client.loop_start()
    udp = socket.socket(type=socket.SOCK_DGRAM)
    with udp, socket.create_connection(("127.0.0.1", ports["tcp"])) as line:
        for number, message in enumerate(garbage()):
            client.publish("rigs/G1", message, qos=1).wait_for_publish(20.0)
            line.sendall(message + b"\n")
            udp.sendto(message[:60_000], ("127.0.0.1", ports["udp"]))
            if number % 10 == 0:
                with suppress(OSError, http.client.HTTPException):
                    link = http.client.HTTPConnection("127.0.0.1", process.port, timeout=60.0)
                    link.request("POST", "/api/login", message, {"X-Fdd": "1"})
                    link.getresponse()
                with suppress(OSError), socket.create_connection(("127.0.0.1", process.port)) as raw:
                    raw.sendall(message[:100_000])
    client.disconnect()
    client.loop_stop()
    yield
