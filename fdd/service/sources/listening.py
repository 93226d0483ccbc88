"""JSON lines over TCP, datagrams over UDP: blocks, or single samples."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any, TypeVar

import numpy as np

from fdd.bounds import MAX_LINE_BYTES, MOST_AXES, MOST_PENDING
from fdd.errors import InputError
from fdd.monitor.stream import split_lines
from fdd.samples import Samples
from fdd.service.blocks import ARROW_START, Block, Decoder, axis_name, json_object
from fdd.service.config_sources import TcpSource, UdpSource, bound_socket
from fdd.service.sources import Source, Window

GATHERED_S = 0.1
"""s for which single samples are gathered to a block."""
_READ = 1 << 16
_RECEIVED_BYTES = 8 << 20
_ON_THEIR_WAY = 32
"""Blocks of one connection that may wait for the fleet."""
Config = TypeVar("Config", bound=TcpSource | UdpSource)


class Listener(Source[Config]):
    """A source of messages, each a block or a sample ``{"axis": "A1", "time": 0, "position": 0}``."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.axis, self.decoder = config.axis, Decoder(self._map)
        self._open = set[socket.socket]()

    def _bound(self, kind: socket.SocketKind) -> socket.socket:
        host, port = self._config.host, self._config.port
        bound = bound_socket(host, port, f"{self._config.type} {host}:{port}", "name a free port", kind)
        bound.settimeout(GATHERED_S)
        self._set(port=bound.getsockname()[1])
        return bound


class _Feed:
    """One connection's messages to blocks; without a window where the sender cannot wait."""

    def __init__(self, source: Listener[Any], stop: threading.Event, window: Window | None = None) -> None:
        self._source, self._stop, self._window = source, stop, window
        self._more: dict[str, Any] = {} if window is None else {"patient": True, "accepted": window.accepted}
        self._rows: dict[str, list[dict[str, Any]]] = {}
        self._pending, self._since = 0, time.monotonic()

    def pump(self, connection: socket.socket, idle: float) -> bool:
        """Read to the stream's end, `stop` or `idle` s of silence; whether it was that."""
        heard, tail = time.monotonic(), b""
        try:
            while not self._stop.is_set():
                try:
                    chunk = connection.recv(_READ)
                except TimeoutError:
                    if time.monotonic() - heard > idle:
                        return True
                else:
                    if not chunk:
                        break
                    tail = self._lines(tail, chunk)
                    heard = time.monotonic()
                self.flush(if_due=True)
            return False
        finally:
            self._lines(tail, b"", ended=True)
            self.flush()

    def _lines(self, tail: bytes, chunk: bytes, ended: bool = False) -> bytes:
        """Take the whole lines of what came; the rest."""
        lines, tail, overlong = split_lines(tail, chunk, ended)
        for line in lines:
            self.take(line)
        for _ in range(overlong):
            problem = f"a line of more than {MAX_LINE_BYTES} bytes"
            self._source.refuse(InputError(problem, mend="end each message with a line feed"))
        return tail

    def take(self, line: bytes) -> None:
        """One line or one datagram; what is wrong with it is counted and told."""
        decoder = self._source.decoder
        try:
            if line.startswith(ARROW_START):
                block = decoder.decode(line, **self._more)
            else:
                message = json_object(line)
                if "schema" not in message:
                    self._gather(message)
                    return
                block = decoder.decode_object(message, **self._more)
            self.flush()  # samples that came before
            self._give(block)
        except InputError as error:
            self._source.refuse(error)

    def _gather(self, sample: dict[str, Any]) -> None:
        axis = axis_name(sample.get("axis", self._source.axis))
        if not self._source.decoder.map.are_numbers(sample):
            problem = f"axis {axis}: a sample with something else than numbers"
            raise InputError(problem, mend="send null for none")
        if axis not in self._rows and len(self._rows) >= MOST_AXES:
            raise InputError(f"axis {axis}: more than {MOST_AXES} axes in {GATHERED_S} s")
        if not self._pending:
            self._since = time.monotonic()
        self._rows.setdefault(axis, []).append(sample)
        self._pending += 1
        self.flush(if_due=True)

    def flush(self, *, if_due: bool = False) -> None:
        """Give the samples that were gathered; with `if_due` where it was long enough, or they are many."""
        if if_due and time.monotonic() - self._since < GATHERED_S and self._pending < MOST_PENDING:
            return
        rows, self._rows, self._pending = self._rows, {}, 0
        for axis, samples in rows.items():
            try:
                self._give_samples(axis, samples)
            except InputError as error:
                self._source.refuse(error)

    def _give_samples(self, axis: str, rows: list[dict[str, Any]]) -> None:
        """As one block, or several where stamps go back: the axis's order sees to these."""
        source = self._source
        with np.errstate(over="ignore"):
            columns = source.decoder.map.of_rows(rows)
        stamps = columns.pop("time", np.full(len(rows), np.nan))
        stamped = np.isfinite(stamps)
        for _ in range(int((~stamped).sum())):
            source.refuse(InputError(f"axis {axis}: a sample without a time", mend='send "time" in s'))
        stamps = stamps[stamped]
        columns = {n: np.where(np.isinf(v), np.nan, v)[stamped] for n, v in columns.items()}
        if stamps.size and not columns:
            problem = f"axis {axis}: samples without a channel"
            raise InputError(problem, mend="name keys as channels, or give a map")
        cuts = np.flatnonzero(np.diff(stamps) <= 0.0) + 1
        for part in np.split(np.arange(stamps.size), cuts) if stamps.size else ():
            samples = Samples(stamps[part], {n: v[part] for n, v in columns.items()})
            self._give(Block(axis, samples, None, time.time(), **self._more))

    def _give(self, block: Block) -> None:
        if self._window is None or self._window.wait(self._stop):
            self._source.take(block)


class TcpLines(Listener[TcpSource]):
    """A TCP port that takes JSON lines; a sender that is too fast is made to wait."""

    def status(self) -> dict[str, Any]:
        """How it stands; `connections` are those that are open now."""
        return {**super().status(), "connections": len(self._open)}

    def _begin(self, stop: threading.Event) -> None:
        listener = self._bound(socket.SOCK_STREAM)
        listener.listen()
        self._run(self._accept, listener, stop)

    def _accept(self, listener: socket.socket, stop: threading.Event) -> None:
        with listener:
            while not stop.is_set():
                try:
                    connection, peer = listener.accept()
                except TimeoutError:
                    continue
                except OSError as error:  # no file numbers left: others may close theirs
                    self._told(f"no connection ({error.strerror})")
                    stop.wait(1.0)
                    continue
                if len(self._open) >= self._config.connections:
                    self.refuse(InputError(f"{peer[0]}: more than {self._config.connections} connections"))
                    connection.close()
                    continue
                self._open.add(connection)
                self._spawn(self._serve, connection, peer[0], stop)

    def _serve(self, connection: socket.socket, peer: str, stop: threading.Event) -> None:
        try:
            connection.settimeout(GATHERED_S)
            feed, idle = _Feed(self, stop, Window(_ON_THEIR_WAY)), self._config.idle
            if feed.pump(connection, idle):
                self._told(f"{peer}: silent for {idle:g} s, closed")
        except OSError as error:
            self._told(f"{peer}: connection lost ({error.strerror or error})")
        finally:
            self._open.discard(connection)
            connection.close()


class Datagrams(Listener[UdpSource]):
    """A UDP port that takes a message, a block or a sample, in each datagram."""

    def _begin(self, stop: threading.Event) -> None:
        bound = self._bound(socket.SOCK_DGRAM)
        # A hundred axes may send in one instant; the system grants what it allows.
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVED_BYTES)
        self._run(self._receive, bound, stop)

    def _receive(self, bound: socket.socket, stop: threading.Event) -> None:
        feed = _Feed(self, stop)
        with bound:
            while not stop.is_set():
                try:
                    feed.take(bound.recv(_READ))
                except TimeoutError:
                    pass
                except OSError as error:  # told of a peer that is gone, on some systems
                    self._told(f"datagram lost ({error.strerror or error})")
                feed.flush(if_due=True)
        feed.flush()
