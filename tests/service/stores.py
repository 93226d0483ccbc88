"""What tests of the store share: a time, and a PostgreSQL server that a test may kill."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text

from reports.service import free_port

WALL = 1_700_000_000.0
PATH = os.pathsep.join([os.environ.get("PATH", ""), *map(str, Path("/usr/lib/postgresql").glob("*/bin"))])
"""Debian has the server's programs beside the path."""
USER = "postgres" if os.geteuid() == 0 else None
"""Whom it runs as: it refuses root."""


class PostgresServer:
    """Made and started; `url` names an empty database on it."""

    def __init__(self) -> None:
        # Not below pytest's folders: the server's user could not enter them.
        self._folder = Path(tempfile.mkdtemp(prefix="fdd-postgres-", dir="/tmp"))
        atexit.register(self._remove)
        if USER is not None:
            shutil.chown(self._folder, USER)
        self._port = free_port()
        self._run("initdb", "--auth=trust", "--username=postgres", "--no-sync")
        self.start()
        self.url = f"postgresql://postgres@127.0.0.1:{self._port}/postgres"

    def start(self) -> None:
        """Start, and wait until it answers."""
        settings = f"-p {self._port} -c listen_addresses=127.0.0.1 -c unix_socket_directories='' -F"
        self._run("pg_ctl", "start", "--wait", f"--options={settings}", f"--log={self._folder / 'log'}")

    def kill(self) -> None:
        """End at once: no connection is told, nothing is written out; it must recover when it starts."""
        self._run("pg_ctl", "stop", "--mode=immediate")

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [shutil.which(program, path=PATH) or "", f"--pgdata={self._folder / 'data'}", *arguments],
            user=USER, cwd="/", check=True, stdout=subprocess.DEVNULL, timeout=60,
        )  # fmt: skip

    def _remove(self) -> None:
        self.kill()
        shutil.rmtree(self._folder)


@cache
def postgres_server() -> PostgresServer:
    """The one of this process; without its programs, or the driver, the test is skipped."""
    pytest.importorskip("psycopg", reason="no driver of PostgreSQL here: the extra postgres")
    if shutil.which("initdb", path=PATH) is None:
        pytest.skip("no server of PostgreSQL here: Debian's package postgresql")
    return PostgresServer()


def postgres_url() -> str:
    """An emptied database on a server of our own, or the test is skipped."""
    url = postgres_server().url
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url
