"""Lines over TCP, datagrams over UDP, and lines on standard input."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from fdd.bounds import MAX_BLOCK_BYTES
from fdd.errors import InputError
from fdd.service.config_sources import StdinSource, TcpSource, UdpSource
from fdd.service.sources.intake import Intake, Put, Window
from fdd.service.sources.lines import GATHERED_S, LineFeed

_READ = 1 << 16
_RECEIVED_BYTES = 8 << 20
_ON_THEIR_WAY = 32
"""Blocks of one connection that may wait for the fleet."""


class _Lines:
    """Cuts a stream of bytes to lines of bounded length."""

    def __init__(self, feed: LineFeed, intake: Intake) -> None:
        self._feed, self._intake = feed, intake
        self._tail = bytearray()
        self._overlong = False

    def take(self, chunk: bytes) -> None:
        *whole, rest = chunk.split(b"\n")
        for line in whole:
            self._line(line)
            self._end()
        self._line(rest)

    def end(self) -> None:
        self._end()
        self._feed.flush()

    def _line(self, part: bytes) -> None:
        if not self._overlong:
            self._tail += part
            # The rest of a line without end is read and forgotten.
            self._overlong = len(self._tail) > MAX_BLOCK_BYTES
            if self._overlong:
                self._tail.clear()

    def _end(self) -> None:
        if self._overlong:
            self._intake.refuse(
                InputError(
                    f"a line of more than {MAX_BLOCK_BYTES} bytes", mend="end each message with a line feed"
                )
            )
        elif self._tail.strip():
            self._feed.take(bytes(self._tail))
        self._tail.clear()
        self._overlong = False


def _bound(kind: socket.SocketKind, config: TcpSource | UdpSource) -> socket.socket:
    """A socket that is bound as the configuration says.

    Raises
    ------
    InputError : the port is taken, or the address not this machine's.
    """
    try:
        family = socket.getaddrinfo(config.host, config.port, type=kind)[0][0]
        bound = socket.socket(family, kind)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1 if kind is socket.SOCK_STREAM else 0)
        bound.bind((config.host, config.port))
    except OSError as error:
        raise InputError(
            f"cannot be listened on ({error.strerror or error})",
            where=f"{config.type} {config.host}:{config.port}",
            mend="name a free port and an address of this machine",
        ) from None
    bound.settimeout(GATHERED_S)
    return bound


class TcpLines:
    """A TCP port that takes JSON lines; a sender that is too fast is made to wait.

    Parameters
    ----------
    config : host, port, how many connections and how long a silent one may last. intake : takes the blocks.

    Examples
    --------
    >>> source = TcpLines(TcpSource(type="tcp", port=9001), Intake("rig"))
    >>> source.start(inbox.put, stop)  # doctest: +SKIP
    """

    def __init__(self, config: TcpSource, intake: Intake) -> None:
        self._config, self._intake = config, intake
        self._open: set[socket.socket] = set()
        self.port = config.port

    def start(self, put: Put, stop: threading.Event) -> None:
        """Listen, and serve each connection in a thread of its own.

        Raises
        ------
        InputError : the port cannot be listened on.
        """
        listener = _bound(socket.SOCK_STREAM, self._config)
        listener.listen()
        self.port = listener.getsockname()[1]
        self._intake.set(connected=True)
        self._intake.start(put, self._accept, listener, stop)

    def status(self) -> dict[str, Any]:
        """How it stands; `connections` are those that are open now."""
        return {**self._intake.status(), "port": self.port, "connections": len(self._open)}

    def _accept(self, listener: socket.socket, stop: threading.Event) -> None:
        with listener:
            while not stop.is_set():
                try:
                    connection, peer = listener.accept()
                except TimeoutError:
                    continue
                except OSError as error:  # no file numbers left: others may close theirs
                    self._intake.told(f"no connection ({error.strerror})")
                    stop.wait(1.0)
                    continue
                if len(self._open) >= self._config.connections:
                    self._intake.refuse(
                        InputError(f"{peer[0]}: more than {self._config.connections} connections")
                    )
                    connection.close()
                    continue
                self._open.add(connection)
                self._intake.spawn(self._serve, connection, peer[0], stop)

    def _serve(self, connection: socket.socket, peer: str, stop: threading.Event) -> None:
        feed = LineFeed(self._intake, self._config.axis, stop, Window(_ON_THEIR_WAY))
        lines, heard = _Lines(feed, self._intake), time.monotonic()
        try:
            connection.settimeout(GATHERED_S)
            while not stop.is_set():
                try:
                    chunk = connection.recv(_READ)
                except TimeoutError:
                    feed.flush_if_due()
                    if time.monotonic() - heard > self._config.idle:
                        self._intake.told(f"{peer}: silent for {self._config.idle:g} s, closed")
                        break
                    continue
                if not chunk:
                    break
                lines.take(chunk)
                feed.flush_if_due()
                heard = time.monotonic()
        except OSError as error:
            self._intake.told(f"{peer}: connection lost ({error.strerror or error})")
        finally:
            lines.end()
            self._open.discard(connection)
            connection.close()


class Datagrams:
    """A UDP port that takes a message, a block or a sample, in each datagram.

    Examples
    --------
    >>> source = Datagrams(UdpSource(type="udp", port=9001), Intake("rig"))
    >>> source.start(inbox.put, stop)  # doctest: +SKIP
    """

    def __init__(self, config: UdpSource, intake: Intake) -> None:
        self._config, self._intake = config, intake
        self.port = config.port

    def start(self, put: Put, stop: threading.Event) -> None:
        """Listen in a thread of its own.

        Raises
        ------
        InputError : the port cannot be listened on.
        """
        bound = _bound(socket.SOCK_DGRAM, self._config)
        # A hundred axes may send in one instant; the system grants what it allows.
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVED_BYTES)
        self.port = bound.getsockname()[1]
        self._intake.set(connected=True)
        self._intake.start(put, self._receive, bound, stop)

    def status(self) -> dict[str, Any]:
        """How it stands."""
        return {**self._intake.status(), "port": self.port}

    def _receive(self, bound: socket.socket, stop: threading.Event) -> None:
        feed = LineFeed(self._intake, self._config.axis, stop)
        with bound:
            while not stop.is_set():
                try:
                    feed.take(bound.recv(_READ))
                except TimeoutError:
                    pass
                except OSError as error:  # told of a peer that is gone, on some systems
                    self._intake.told(f"datagram lost ({error.strerror or error})")
                feed.flush_if_due()
        feed.flush()


class StandardInput:
    """JSON lines on standard input, to its end.

    Parameters
    ----------
    fileno : gives the number of the file to read.

    Examples
    --------
    >>> source = StandardInput(StdinSource(type="stdin"), Intake("stdin"), sys.stdin.fileno)  # doctest: +SKIP
    """

    def __init__(self, config: StdinSource, intake: Intake, fileno: Callable[[], int]) -> None:
        self._config, self._intake, self._fileno = config, intake, fileno

    def start(self, put: Put, stop: threading.Event) -> None:
        """Read in a thread of its own."""
        self._intake.set(connected=True, ended=False)
        self._intake.start(put, self._read, stop)

    def status(self) -> dict[str, Any]:
        """How it stands; `ended` tells that all was read."""
        return self._intake.status()

    def _read(self, stop: threading.Event) -> None:
        number = self._fileno()
        feed = LineFeed(self._intake, self._config.axis, stop, Window(_ON_THEIR_WAY))
        lines = _Lines(feed, self._intake)
        while not stop.is_set():
            # Not a plain read: a silent stream would hold the last samples back, and the end of the service.
            if select.select([number], [], [], GATHERED_S)[0]:
                chunk = os.read(number, _READ)
                if not chunk:
                    self._intake.set(ended=True)
                    break
                lines.take(chunk)
            feed.flush_if_due()
        lines.end()
