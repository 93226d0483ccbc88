"""Sources from real sockets, pipes, files and folders: all of each, in order, once."""

import json
import os
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.bounds import MAX_BLOCK_BYTES
from fdd.errors import InputError
from fdd.logs import read_log
from fdd.samples import Samples
from fdd.service.blocks import Decoder, encode_arrow, encode_json
from fdd.service.config_sources import FolderSource, ReplaySource, TcpSource, UdpSource
from fdd.service.service import open_source
from fdd.service.sources import Source
from tests.service.senders import Taker, a_block, ordered, until


@pytest.fixture
def tcp(start):
    return lambda **more: start(open_source(TcpSource.model_validate({"type": "tcp", "port": 0, **more})))


def connected(source: Source) -> socket.socket:
    return socket.create_connection(("127.0.0.1", source.status()["port"]), timeout=10)


def samples(first: int, count: int, **more: object) -> bytes:
    rows = [{"time": (first + k) / 128, "position": first + k, **more} for k in range(count)]
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def test_blocks_and_samples_on_one_connection(taker, tcp):
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


def test_samples_that_come_slowly_or_in_pieces_are_not_kept_waiting(taker, tcp):
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


def test_wrong_lines_are_counted_and_spoil_no_other_and_a_clock_is_followed(taker, tcp):
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


def test_a_fast_sender_is_made_to_wait(taker, tcp):
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


def test_connections_and_silence_are_bounded(taker, tcp):
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


def test_a_port_that_is_taken_or_a_map_of_no_use_is_told_in_one_line(tcp, tmp_path):
    port = tcp().status()["port"]
    with pytest.raises(InputError, match=f"tcp 127.0.0.1:{port}: cannot be listened on"):
        tcp(port=port)
    (tmp_path / "map.yaml").write_text("position: {topic: /a, field: b}")
    with pytest.raises(InputError, match="a stream takes plain columns only"):
        open_source(UdpSource(type="udp", port=0, map=tmp_path / "map.yaml"))


def test_datagrams_are_messages(taker, start):
    source = start(open_source(UdpSource(type="udp", port=0, axis="A1")))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", source.status()["port"]))
        for datagram in (encode_json(a_block(0, "C3")), encode_arrow(a_block(1, "C3")), b"garbage"):
            sender.send(datagram)
        sender.send(samples(0, 1))
    until(lambda: len(taker.blocks) == 3)
    assert taker.numbers("C3") == [0, 1] and source.status()["refused"] == 1
    assert np.array_equal(taker.joined("C3")["position"][10:], a_block(1).samples["position"])


def test_the_sender_of_the_manual_sends(taker, tcp):
    page = (Path(__file__).parents[2] / "docs" / "serve-blocks.md").read_text("utf-8")
    sender = page.split("```python\n")[1].split("```")[0]
    source = tcp()
    for said, here in (("9001", str(source.status()["port"])), ("time.sleep(0.1)", "time.sleep(0.0)")):
        assert said in sender
        sender = sender.replace(said, here)
    exec(sender, {})
    until(lambda: taker.numbers() == list(range(20)))
    assert source.status()["refused"] == 0 and len(taker.blocks[0].samples) == 100
    example = page.split("```json\n")[1].split("```")[0]
    assert Decoder().decode(example.encode()).samples.time.tolist() == pytest.approx([12.3, 12.301, 12.302])


@pytest.fixture(autouse=True)
def soon_at_rest(monkeypatch) -> None:
    """Files are taken for whole after half a second, not after two."""
    monkeypatch.setattr("fdd.service.sources.logs.AT_REST_S", 0.5)


def log(path: Path, seed: int = 0) -> Path:
    """Six seconds at 100 Hz; it appears whole."""
    rng, n = np.random.default_rng(seed), 600
    sizes = {"position": 0.01, "pump_speed": 100.0, "pressure_difference": 1e6}
    columns = {c: size * rng.standard_normal(n) for c, size in sizes.items()}
    path.parent.mkdir(exist_ok=True)
    pd.DataFrame({"time": 0.01 * np.arange(n), **columns}).to_parquet(path.with_suffix(".part"))
    path.with_suffix(".part").rename(path)
    os.utime(path, (1e9 + seed, 1e9 + seed))
    return path


def same(found: Samples, path: Path) -> None:
    wanted = read_log(path).samples
    assert np.array_equal(found.time, wanted.time)
    assert all(np.array_equal(found[n], wanted[n], equal_nan=True) for n in wanted.channels)


def folder(path: Path, **more: object) -> Source:
    return open_source(FolderSource.model_validate({"type": "folder", "folder": path, "every": 0.05, **more}))


@pytest.mark.parametrize("speed", ["max", 20.0])
def test_logs_of_several_axes_are_replayed_and_what_cannot_be_is_told(speed, tmp_path, taker, start, stop):
    logs = {"A1": log(tmp_path / "a.parquet"), "B2": log(tmp_path / "b.parquet", 1)}
    source = open_source(ReplaySource.model_validate({"type": "replay", "logs": logs, "speed": speed}))
    started = time.monotonic()
    start(source)
    until(lambda: not source.status()["running"])
    assert speed == "max" or time.monotonic() - started > 5.9 / 20.0
    for axis, path in logs.items():
        same(taker.joined(axis), path)
        assert taker.numbers(axis) == list(range(len(taker.numbers(axis))))
    source = start(open_source(ReplaySource(type="replay", logs={"A1": tmp_path / "none.csv"})))
    until(lambda: not source.status()["running"])
    assert "none.csv: " in source.status()["last_error"] and not source.status()["connected"]
    slow = Taker()  # of a store that takes its time
    slow.accepting = False
    open_source(ReplaySource(type="replay", logs={"A1": logs["A1"]}, speed="max")).start(slow.put, stop)
    until(lambda: len(slow.blocks) == 4)
    time.sleep(0.3)
    assert len(slow.blocks) == 4
    slow.accept()
    until(lambda: len(slow.blocks) == 6)


def test_logs_of_a_folder_are_read_once(tmp_path, taker):
    first, second = log(tmp_path / "A1" / "1.parquet", 1), log(tmp_path / "A1" / "2.parquet", 2)
    (tmp_path / "A1" / "bad.csv").write_text("nothing\n")
    (tmp_path / "stray.parquet").write_bytes(first.read_bytes())
    (tmp_path / "A1" / ".hidden").write_text("x")
    before = sorted(p.name for p in tmp_path.rglob("*"))
    for _ in range(2):  # again, as after a restart
        stop = threading.Event()
        source = folder(tmp_path)
        source.start(taker.put, stop)
        until(lambda source=source: source.status()["files"] == 2 and source.status()["bad_files"] == 2)
        time.sleep(0.3)
        stop.set()
        until(lambda source=source: not source.status()["connected"])
    assert taker.numbers() == [*range(6), *range(6)]
    found, order = ordered(taker.blocks)
    assert len(found) == 1200 and order.counts["repeated"] == order.counts["late"] == 0
    wanted = np.concatenate([read_log(p).samples["position"] for p in (first, second)])
    assert np.array_equal(found["position"], wanted, equal_nan=True)
    note = json.loads((tmp_path / ".fdd-done.json").read_text())
    bad, stray = (note["files"][name]["error"] for name in ("A1/bad.csv", "stray.parquet"))
    assert note["schema"] == "fdd.done/1" and "bad.csv" in bad and "\n" not in bad
    assert "no name of an axis" in stray
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted([*before, ".fdd-done.json"])


def test_a_file_is_read_when_it_is_whole(tmp_path, taker, start):
    whole = log(tmp_path / "elsewhere" / "a.parquet")
    content, target = whole.read_bytes(), tmp_path / "drop" / "a.parquet"
    target.parent.mkdir()
    source = start(folder(target.parent, axis="A1"))
    with target.open("wb") as out:
        for k in range(6):
            out.write(content[k * len(content) // 6 : (k + 1) * len(content) // 6])
            out.flush()
            time.sleep(0.15)
            assert not taker.blocks
    until(lambda: source.status()["files"] == 1)
    same(taker.joined(), whole)
    assert source.status()["bad_files"] == 0


def test_a_restart_in_the_middle_of_a_file_goes_on_there(tmp_path, taker, start, stop):
    path, source, again = log(tmp_path / "a.parquet"), folder(tmp_path, axis="A1"), Taker()
    taker.accepting = False
    start(source)
    until(lambda: len(taker.blocks) == 4)
    stored = taker.blocks[:2]
    for block in stored:
        block.accepted()
    until(lambda: len(taker.blocks) == 6)
    stop.set()
    until(lambda: not source.status()["connected"])
    source, stop = folder(tmp_path, axis="A1"), threading.Event()
    source.start(again.put, stop)
    until(lambda: source.status()["files"] == 1)
    stop.set()
    assert again.numbers() == [2, 3, 4, 5]
    same(Samples.concatenate([b.samples for b in [*stored, *again.blocks]]), path)


def test_a_damaged_note_is_not_overwritten_and_a_file_that_is_replaced_is_read_again(tmp_path, taker, start):
    note = tmp_path / ".fdd-done.json"
    note.write_text('{"schema": "fdd.done/1", "files": 3}')
    with pytest.raises(InputError, match="not a note of what is done; remove it"):
        start(folder(tmp_path))
    assert "3}" in note.read_text()
    with pytest.raises(InputError, match="no such folder"):
        start(folder(tmp_path / "none"))
    note.unlink()
    (tmp_path / "a.parquet").write_text("nothing")
    os.utime(tmp_path / "a.parquet", (1e9, 1e9))
    source = start(folder(tmp_path, axis="A1"))
    until(lambda: source.status()["bad_files"] == 1)
    path = log(tmp_path / "a.parquet", 5)
    until(lambda: source.status()["files"] == 1)
    same(taker.joined(), path)
    assert source.status()["bad_files"] == 0
