"""The HTTP service around a fleet that is made up: in the process, or on a port."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from starlette.testclient import TestClient

from fdd.service.http import Hub, Listen, Server, Tokens, new_token, web
from fdd.service.http.uploads import Folders
from tests.service.fake import FakeBus, FakeFleet, FakeStore

HEALTH = {"status": "ok", "problems": [], "axes": 2}
METRICS = (b"fdd_axes 2\n", "text/plain; version=0.0.4; charset=utf-8")
PAGE = {"x-fdd": "1"}
"""What the page's own requests carry."""


class Trouble(Exception):
    """The store's, as the fleet raises it."""


def app_of(fleet: FakeFleet, store: FakeStore, bus: FakeBus, **given: Any) -> tuple[Any, Hub]:
    hub = Hub(bus)
    parts = {"health": lambda: HEALTH, "metrics": lambda accept: METRICS, "trouble": Trouble, **given}
    return web(fleet=fleet, store=store, hub=hub, **parts), hub


def client_of(world: tuple[FakeFleet, FakeStore, FakeBus], **given: Any) -> TestClient:
    app, _ = app_of(*world, **given)
    return TestClient(app, base_url="http://127.0.0.1:8080", raise_server_exceptions=False)


def three_tokens() -> tuple[Tokens, dict[str, str]]:
    made = {role: new_token(f"{role}-person", role) for role in ("view", "acknowledge", "admin")}
    return Tokens.parse("\n".join(line for _, line in made.values())), {r: t for r, (t, _) in made.items()}


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


@contextmanager
def on_a_port(world: tuple[FakeFleet, FakeStore, FakeBus], **given: Any) -> Iterator[Server]:
    stop = threading.Event()
    app, hub = app_of(*world, **given)
    server = Server(app, Listen(port=0), has_tokens=given.get("tokens") is not None)
    threads = [hub.start(stop), server.start(stop)]
    try:
        yield server
    finally:
        stop.set()
        for thread in threads:
            thread.join(15)
        assert not any(thread.is_alive() for thread in threads)


__all__ = [
    "HEALTH",
    "METRICS",
    "PAGE",
    "Folders",
    "app_of",
    "bearer",
    "client_of",
    "on_a_port",
    "three_tokens",
]
