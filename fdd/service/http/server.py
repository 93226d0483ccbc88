"""The service on a port, by uvicorn in a thread of its own."""

from __future__ import annotations

import logging
import socket
import ssl
import threading

import uvicorn
from starlette.types import ASGIApp

from fdd.bounds import MAX_HEAD_BYTES, MOST_HTTP_CONNECTIONS
from fdd.errors import InputError
from fdd.service.config import Listen


class Server:
    """uvicorn on a socket of its own.

    Parameters
    ----------
    app : of `fdd.service.http.web`. listen : where.

    Attributes
    ----------
    address : what a browser opens.

    Raises
    ------
    InputError : the port is taken, or the certificate cannot be used.
    """

    def __init__(self, app: ASGIApp, listen: Listen) -> None:
        tls = listen.tls
        config = uvicorn.Config(
            app, http="h11", ws="none", lifespan="off", interface="asgi3",
            log_config=None, log_level=logging.ERROR, access_log=False, server_header=False,
            proxy_headers=False, limit_concurrency=MOST_HTTP_CONNECTIONS, timeout_keep_alive=5,
            timeout_graceful_shutdown=3, h11_max_incomplete_event_size=MAX_HEAD_BYTES,
            ssl_certfile=None if tls is None else tls.cert, ssl_keyfile=None if tls is None else tls.key,
        )  # fmt: skip
        try:
            config.load()
        except (OSError, ssl.SSLError) as error:
            where = "listen: tls" if tls is None else f"{tls.cert}, {tls.key}"
            raise InputError(f"cannot be used for TLS ({error.strerror or error})", where=where) from None
        self._server = uvicorn.Server(config)
        self._socket = _bound(listen)
        host, port = self._socket.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        self.address = f"{'http' if tls is None else 'https'}://{shown}:{port}/"

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
        where = f"listen {listen.host}:{listen.port}"
        raise InputError(
            f"cannot be listened on ({error.strerror or error})", where=where,
            mend="give a free port (--port) and an address of this machine",
        ) from None  # fmt: skip
    return made
