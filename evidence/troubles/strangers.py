"""Clients that mean harm, or know no better: garbage on every door, and 10,000 that are slow."""

from __future__ import annotations

import http.client
import random
import resource
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import orjson
import paho.mqtt.client as paho

from evidence.troubles.process import Process
from evidence.troubles.senders import Mqtt, Tcp, blocks_of, leaking
from fdd.service.blocks import encode_arrow, encode_json

CLIENTS = 10_000
BACK_S = 5.0
"""After which a client that was closed comes again."""
EVENTS = b"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
SLOWLY = b"GET /api/axes HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: " + b"a" * 1000
DATAGRAM = 60_000
LOGS = ("csv", "mcap", "parquet", "mf4", "h5", "mat", "xlsx", "tdms")


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
def garbage_sent(process: Process, sender: Tcp | Mqtt) -> Iterator[None]:
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
            udp.sendto(message[:DATAGRAM], ("127.0.0.1", ports["udp"]))
            if number % 10 == 0:  # a diagnosis is a process of its own: one of each kind
                log = [f"/api/diagnose?name=a.{LOGS[number // 10]}"] if number < 10 * len(LOGS) else []
                for path in ("/api/login", *log):
                    with suppress(OSError, http.client.HTTPException):
                        link = http.client.HTTPConnection("127.0.0.1", process.port, 60.0)
                        link.request("POST", path, message, {"X-Fdd": "1"})
                        link.getresponse()
                with suppress(OSError), socket.create_connection(("127.0.0.1", process.port)) as raw:
                    raw.sendall(message[:100_000])
    client.disconnect()
    client.loop_stop()
    yield


@contextmanager
def slow_clients(process: Process, sender: Tcp | Mqtt) -> Iterator[None]:
    """10,000 HTTP clients: half send a byte a second, half ask for events and never read; all come back."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    resource.prlimit(process.popen.pid, resource.RLIMIT_NOFILE, (1024, hard))  # what a service has by default
    stop, all_came = threading.Event(), threading.Event()
    attack = threading.Thread(target=_attack, args=(process.port, stop, all_came), daemon=True)
    attack.start()
    all_came.wait(120.0)
    try:
        yield
    finally:
        stop.set()
        attack.join()


def _attack(port: int, stop: threading.Event, all_came: threading.Event) -> None:
    links: list[socket.socket | None] = [None] * CLIENTS
    sent, again = [0] * CLIENTS, [0.0] * CLIENTS
    while not stop.is_set():
        begun = time.monotonic()
        for k, link in enumerate(links):
            try:
                if link is None and begun < again[k]:
                    continue
                if link is None:
                    links[k] = link = socket.socket()
                    link.setblocking(False)
                    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                    link.connect_ex(("127.0.0.1", port))
                    sent[k] = 0
                elif k % 2 and sent[k] == 0:
                    sent[k] = link.send(EVENTS)
                elif k % 2 == 0:
                    sent[k] += link.send(SLOWLY[sent[k] : sent[k] + 1])
            except BlockingIOError:
                pass
            except OSError:
                link.close() if link is not None else None
                links[k], again[k] = None, begun + BACK_S
        all_came.set()
        stop.wait(max(0.0, begun + 1.0 - time.monotonic()))
    for link in links:
        if link is not None:
            link.close()
