"""Lines over TCP, datagrams and standard input, from real sockets and pipes."""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fdd.bounds import MAX_BLOCK_BYTES
from fdd.errors import InputError
from fdd.service.blocks import Decoder, encode_arrow, encode_json
from fdd.service.config_sources import StdinSource, TcpSource, UdpSource
from fdd.service.sources import Source, open_source
from tests.service.senders import Taker, a_block, until

Lines = Callable[..., Source[TcpSource]]


@pytest.fixture
def tcp(taker: Taker, stop: threading.Event) -> Lines:
    """Begins a source, which gives the taker what comes."""

    def begun(**more: object) -> Source[TcpSource]:
        source = open_source(TcpSource.model_validate({"type": "tcp", "port": 0, **more}))
        source.start(taker.put, stop)
        return source

    return begun


def connected(source: Source[TcpSource]) -> socket.socket:
    return socket.create_connection(("127.0.0.1", source.status()["port"]), timeout=10)


def samples(first: int, count: int, **more: object) -> bytes:
    rows = [{"time": (first + k) / 128, "position": first + k, **more} for k in range(count)]
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def test_blocks_and_samples_on_one_connection(taker: Taker, tcp: Lines) -> None:
    source = tcp(axis="A1", unit="rig")
    with connected(source) as sender:
        sender.sendall(samples(0, 50))
        sender.sendall(samples(0, 20, axis="B2"))
        for k in range(3):
            sender.sendall(encode_json(a_block(k, "C3")) + b"\n")
    until(lambda: len(taker.numbers("C3")) == 3 and source.status()["connections"] == 0)
    assert taker.joined("A1")["position"].tolist() == list(range(50))
    assert taker.joined("B2").time.tolist() == [k / 128 for k in range(20)]
    assert taker.numbers("C3") == [0, 1, 2] and taker.blocks[0].unit == "rig"
    assert len(taker.blocks) < 20, "samples are gathered"


def test_samples_that_come_slowly_or_in_pieces_are_not_kept_waiting(taker: Taker, tcp: Lines) -> None:
    source, text = tcp(axis="A1"), samples(1, 3)
    with connected(source) as sender:
        sender.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sender.sendall(samples(0, 1))
        until(lambda: len(taker.blocks) == 1, 5.0)
        for k in range(0, len(text), 7):
            sender.sendall(text[k : k + 7])
            time.sleep(0.002)
    until(lambda: sum(len(b.samples) for b in taker.blocks) == 4)
    assert source.status()["refused"] == 0


def test_what_is_wrong_is_counted_and_spoils_no_other_line_and_a_clock_is_followed(
    taker: Taker, tcp: Lines
) -> None:
    source = tcp(axis="A1")
    bad = [b"nonsense", b"\xff\xfe", b"[1]", b'{"position": 1}', b'{"time": 1, "position": "far"}',
           b'{"axis": "../x", "time": 1}', b'{"schema": "fdd.block/1"}', b"[" * 5000]  # fmt: skip
    with connected(source) as sender:
        for k, line in enumerate(bad):
            sender.sendall(line + b"\n" + encode_json(a_block(k, "C3")) + b"\n\n")
        until(lambda: taker.numbers("C3") == list(range(len(bad))))
        assert source.status()["refused"] == len(bad) and "\n" not in source.status()["last_error"]
        for _ in range(MAX_BLOCK_BYTES // (1 << 20) + 1):
            sender.sendall(b"x" * (1 << 20))
        sender.sendall(b"\n" + samples(100, 5))
        until(lambda: len(taker.joined("A1")) == 5)
        assert "a line of more than" in source.status()["last_error"]
        sender.sendall(samples(0, 5))
    until(lambda: sum(len(b.samples) for b in taker.blocks if b.axis == "A1") == 10)
    together = np.concatenate([b.samples.time for b in taker.blocks if b.axis == "A1"]) * 128
    assert together.tolist() == [*range(100, 105), *range(5)]
    assert source.status()["refused"] == len(bad) + 1


def test_a_fast_sender_is_made_to_wait(taker: Taker, tcp: Lines) -> None:
    source = tcp()
    taker.accepting = False

    def send() -> None:
        with connected(source) as sender:
            for k in range(100):
                sender.sendall(encode_json(a_block(k)) + b"\n")

    threading.Thread(target=send, daemon=True).start()
    until(lambda: len(taker.blocks) == 32)
    time.sleep(0.3)
    assert len(taker.blocks) == 32 and all(b.patient for b in taker.blocks)
    taker.accepting = True
    taker.accept()
    until(lambda: taker.numbers() == list(range(100)))


def test_connections_and_silence_are_bounded(taker: Taker, tcp: Lines) -> None:
    source = tcp(connections=2, idle=0.5)
    kept = [connected(source) for _ in range(2)]
    until(lambda: source.status()["connections"] == 2)
    third = connected(source)
    assert third.recv(1) == b"" and source.status()["refused"] == 1
    assert kept[0].recv(1) == b"", "a silent one is closed"
    until(lambda: source.status()["connections"] == 0)
    with connected(source) as sender:
        sender.sendall(encode_json(a_block(0)) + b"\n")
        until(lambda: len(taker.blocks) == 1)
    for one in (*kept, third):
        one.close()


def test_a_port_that_is_taken_or_a_map_of_no_use_is_told_in_one_line(tcp: Lines, tmp_path: Path) -> None:
    port = tcp().status()["port"]
    with pytest.raises(InputError, match=f"tcp 127.0.0.1:{port}: cannot be listened on"):
        tcp(port=port)
    (tmp_path / "map.yaml").write_text("position: {topic: /a, field: b}")
    with pytest.raises(InputError, match="a stream takes plain columns only"):
        open_source(UdpSource(type="udp", port=0, map=tmp_path / "map.yaml"))


def test_datagrams_are_messages(taker: Taker, stop: threading.Event) -> None:
    source = open_source(UdpSource(type="udp", port=0, axis="A1"))
    source.start(taker.put, stop)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", source.status()["port"]))
        sender.send(encode_json(a_block(0, "C3")))
        sender.send(encode_arrow(a_block(1, "C3")))
        sender.send(b"garbage")
        sender.send(samples(0, 1))
    until(lambda: len(taker.blocks) == 3)
    assert taker.numbers("C3") == [0, 1] and source.status()["refused"] == 1
    assert np.array_equal(taker.joined("C3")["position"][10:], a_block(1).samples["position"])


def test_standard_input(taker: Taker, stop: threading.Event, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: reading))
    source = open_source(StdinSource(type="stdin", axis="A1"))
    source.start(taker.put, stop)
    os.write(writing, samples(0, 5))
    until(lambda: len(taker.blocks) >= 1)
    os.write(writing, samples(5, 5)[:-1])  # the last line has no end
    os.close(writing)
    until(lambda: source.status().get("ended"))
    until(lambda: not source.status()["connected"])
    assert taker.joined()["position"].tolist() == list(range(10))
    os.close(reading)


def test_the_sender_of_the_manual_sends(taker: Taker, tcp: Lines) -> None:
    page = (Path(__file__).parents[2] / "docs" / "serve-blocks.md").read_text("utf-8")
    sender = page.split("```python\n")[1].split("```")[0]
    source = tcp()
    assert "9001" in sender and "0.1)" in sender
    exec(
        sender.replace("9001", str(source.status()["port"])).replace("time.sleep(0.1)", "time.sleep(0.0)"), {}
    )
    until(lambda: taker.numbers() == list(range(20)))
    assert source.status()["refused"] == 0 and len(taker.blocks[0].samples) == 100
    example = page.split("```json\n")[1].split("```")[0]
    assert Decoder().decode(example.encode()).samples.time.tolist() == pytest.approx([12.3, 12.301, 12.302])
