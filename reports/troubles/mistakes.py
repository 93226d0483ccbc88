"""What a user gets wrong before the service even runs: one clear line each, and status 2."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from reports.service import Process
from reports.troubles.trial import Outcome, process_in

HEAD = "schema: fdd.serve/1\nfallback: axis_a\nlisten: {port: 0}\n"
UDP = "sources: [{type: udp, port: 0}]\n"
FILES: dict[str, str] = {
    "an empty file": "",
    "no YAML": "sources: [",
    "a tab": "schema: fdd.serve/1\n\tsources: []\n",
    "a key twice": HEAD + UDP + UDP,
    "no schema": UDP,
    "another schema": "schema: fdd.serve/2\n" + UDP,
    "no source": HEAD + "sources: []\n",
    "a misspelt key": HEAD + "sorces: []\n",
    "a source of no kind": HEAD + "sources: [{type: modbus}]\n",
    "a source without its port": HEAD + "sources: [{type: tcp}]\n",
    "a port beyond all": HEAD + "sources: [{type: tcp, port: 99999}]\n",
    "a name twice": HEAD + "sources: [{type: udp, port: 0}, {type: udp, port: 0}]\n",
    "an axis's name": HEAD + "sources: [{type: udp, port: 0, axis: ../x}]\n",
    "no such profile": "schema: fdd.serve/1\nfallback: axis_z\n" + UDP,
    "no such map": HEAD + "sources: [{type: udp, port: 0, map: none.yaml}]\n",
    "no such folder": HEAD + "sources: [{type: folder, folder: none}]\n",
    "no such model": HEAD + "model: none.json\n" + UDP,
    "no such tokens": HEAD + "tokens: none\n" + UDP,
    "open to others without tokens": "schema: fdd.serve/1\nlisten: {host: 0.0.0.0}\n" + UDP,
    "an address not its own": HEAD.replace("port: 0", "host: 192.0.2.1") + "tokens: serve.yaml\n" + UDP,
    "TLS without its files": HEAD.replace("port: 0", "port: 0, tls: {cert: a.pem, key: b.pem}") + UDP,
    "no such kind of store": HEAD + "store: mysql://host/x\n" + UDP,
    "a store's folder that is missing": HEAD + "store: sqlite:////none/fdd.db\n" + UDP,
    "a webhook that is no address": HEAD + UDP + "outputs: {webhooks: [{url: nowhere}]}\n",
    "retention of nothing": HEAD + UDP + "retention: {minutes: 0}\n",
    "a topic that is no filter": HEAD + "sources: [{type: mqtt, host: a, topics: ['a#']}]\n",
    "a password file that is missing":
        HEAD + "sources: [{type: mqtt, host: a, user: u, password_file: none, topics: [a]}]\n",
    "a broker that does not exist's TLS":
        HEAD + "sources: [{type: mqtt, host: a, tls: {ca: none.pem}, topics: [a]}]\n",
}  # fmt: skip


def mistakes() -> Iterator[Outcome]:
    """Each mistake in a folder of its own."""
    for what, text in FILES.items():
        yield _refused(f"`serve.yaml`: {what}", partial(_write, text))
    yield _refused("no `serve.yaml`", lambda process: (process.folder / "serve.yaml").unlink())
    yield _refused("a second service on one state folder", lambda process: None, twice=True)
    yield _refused("a read-only state folder", _read_only)
    yield _refused("a file where the state folder should be", lambda process: process.state.write_text(""))
    yield _refused("a store that is no database", _no_database)


def _write(text: str, process: Process) -> None:
    (process.folder / "serve.yaml").write_text(text)


def _read_only(process: Process) -> None:
    process.state.mkdir(mode=0o555)
    if os.getuid() == 0:  # whom no mode keeps out
        subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(process.state)], check=True)


def _no_database(process: Process) -> None:
    process.state.mkdir()
    (process.state / "fdd.db").write_text("time,position\n" * 100)


def _refused(what: str, make: Callable[[Process], object], twice: bool = False) -> Outcome:
    with tempfile.TemporaryDirectory(prefix="fdd-troubles-") as folder:
        first = process_in(Path(folder), [{"type": "udp", "port": 0}])
        make(first)
        if twice:
            first.start()
        second = process_in(Path(folder), first.sources) if twice else first
        second.log = Path(folder) / "second.txt"
        second.spawn()
        try:
            status: int | None = second.popen.wait(60.0)
        except subprocess.TimeoutExpired:
            status = None
        for process in (first, second) if twice else (second,):
            process.kill()
        if first.state.is_mount():
            subprocess.run(["umount", str(first.state)], check=True)
        said = [line for line in second.log.read_text().splitlines() if " INFO " not in line]
    shown = "; ".join(said).replace(folder, "…").removeprefix("fdd: error: ")
    wrong = [] if status == 2 and len(said) == 1 else [f"exit status {status}, {len(said)} lines"]
    return Outcome(what, "started once", shown[:300] or "nothing", 0, 0, 0, wrong)
