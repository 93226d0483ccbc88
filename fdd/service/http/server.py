"""The service on a port, by uvicorn in a thread of its own."""

from __future__ import annotations

import ipaddress
import logging
import socket
import ssl
import threading
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp

from fdd.bounds import MAX_HEAD_BYTES, MOST_HTTP_CONNECTIONS
from fdd.errors import InputError
from fdd.service.http.connections import BoundedProtocol

KEEP_ALIVE_S, SHUTDOWN_S = 5, 3
ACCEPTED_AT_ONCE = 128
"""Connections before those that are too many are closed: else a burst would take all file numbers."""


@dataclass(frozen=True)
class Listen:
    """Where the service listens.

    Attributes
    ----------
    host, port : this machine alone unless told otherwise; port 0 takes a free one.
    cert, key : PEM files; both make it TLS.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    cert: Path | None = None
    key: Path | None = None

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches it.

        Examples
        --------
        >>> Listen("127.0.0.1").is_local, Listen("::1").is_local, Listen("0.0.0.0").is_local
        (True, True, False)
        """
        try:
            return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


class Server:
    """uvicorn with every bound set.

    Parameters
    ----------
    app : of `fdd.service.http.web`. listen : where. has_tokens : whether callers are asked who they are.

    Raises
    ------
    InputError : the port is taken, the certificate cannot be used, or without tokens others could reach it.

    Examples
    --------
    >>> server = Server(app, Listen(port=0), has_tokens=False)  # doctest: +SKIP
    >>> thread = server.start(stop)  # doctest: +SKIP
    """

    def __init__(self, app: ASGIApp, listen: Listen, *, has_tokens: bool) -> None:
        if not has_tokens and not listen.is_local:
            raise InputError(
                "others could reach the service and no tokens are set", where=f"listen {listen.host}",
                mend="give a file of tokens, or listen on 127.0.0.1",
            )  # fmt: skip
        if (listen.cert is None) != (listen.key is None):
            raise InputError("TLS needs both cert and key", where=f"listen {listen.host}")
        config = uvicorn.Config(
            app, http=BoundedProtocol, ws="none", lifespan="off", interface="asgi3",
            log_config=None, log_level=logging.ERROR, access_log=False, server_header=False,
            proxy_headers=False, backlog=ACCEPTED_AT_ONCE,
            limit_concurrency=MOST_HTTP_CONNECTIONS, timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=SHUTDOWN_S, h11_max_incomplete_event_size=MAX_HEAD_BYTES,
            ssl_certfile=listen.cert, ssl_keyfile=listen.key,
        )  # fmt: skip
        try:
            config.load()
        except (OSError, ssl.SSLError) as error:
            where = f"{listen.cert}, {listen.key}"
            raise InputError(f"cannot be used for TLS ({error.strerror or error})", where=where) from None
        self._server = uvicorn.Server(config)
        self._socket = _bound(listen)
        self.scheme = "https" if listen.cert else "http"
        self.host, self.port = self._socket.getsockname()[:2]

    @property
    def address(self) -> str:
        """What a browser opens."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}/"

    def start(self, stop: threading.Event) -> threading.Thread:
        """Serve in a thread until `stop`."""
        serving = threading.Thread(target=self._server.run, args=([self._socket],), name="http", daemon=True)

        def end() -> None:
            stop.wait()
            self._server.should_exit = True

        serving.start()
        threading.Thread(target=end, name="http stop", daemon=True).start()
        return serving


def _bound(listen: Listen) -> socket.socket:
    where = f"listen {listen.host}:{listen.port}"
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            listen.host, listen.port, type=socket.SOCK_STREAM
        )[0]
        # asyncio sends small answers at once on sockets that say that they are TCP.
        made = socket.socket(family, kind, protocol)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(1024)
    except OSError as error:
        raise InputError(f"cannot be listened on ({error.strerror or error})", where=where) from None
    return made
