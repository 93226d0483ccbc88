"""``python -m reports troubles``: faults of the service's own, tried on the real `fdd serve`.

One trouble tried: a third of a leaking run before it, a third while it lasts, the rest after it.
"""

from __future__ import annotations

import os
import resource
import socket
import sqlite3
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block, encode_json
from fdd.unit import Unit
from reports.service import AXIS, Process, free_port, until
from reports.writing import FOLDER, OutOption, made_by, render, require_folder, write_report

ARRIVED_S = 120.0
ROWS = 100
RUN_S = 60.0
Undo = Callable[[], object]


def _locked(process: Process) -> Undo:
    other = sqlite3.connect(process.state / "fdd.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    return other.close


def _full(process: Process) -> Undo:
    filler = process.state / "filler"
    with filler.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    return filler.unlink


def _no_growth(process: Process) -> Undo:
    pid, kind = process.popen.pid, resource.RLIMIT_FSIZE
    soft, hard = resource.prlimit(pid, kind)
    resource.prlimit(pid, kind, (1 << 16, hard))
    return lambda: resource.prlimit(pid, kind, (soft, hard))


def _renamed_file(process: Process) -> Undo:
    path = process.state / "fdd.db"
    path.rename(away := path.with_name("away.db"))
    return lambda: away.rename(path)


class Trouble(NamedTuple):
    """What is tried: `words` are of the line that `/api/health` must say meanwhile."""

    tried: str
    how: str
    begin: Callable[[Process], Undo]
    words: str
    own_disk: bool = False


TROUBLES = (
    Trouble("disk full", "A file fills the disk (a small tmpfs) that the state folder is on.", _full,
            "disk is full", own_disk=True),
    Trouble("quota reached", "No file of the process may grow beyond 64 KiB (RLIMIT_FSIZE), as with a quota.",
            _no_growth, "cannot be written"),
    Trouble("store locked", "Another program holds the store's lock.", _locked, "is locked"),
    Trouble("store's file gone", "The store's file is moved away, and later back.", _renamed_file,
            "file is gone"),
)  # fmt: skip


class Outcome(NamedTuple):
    """What became of one trouble: what the service said meanwhile, samples, and what is not as wanted."""

    tried: str
    how: str
    said: str
    sent: int
    accepted: int
    lost: int
    wrong: Sequence[str] = ()


def leaking() -> Samples:
    """A run of a shipped axis that leaks from its middle on, 1 kHz."""
    leak = {"fault": "internal_leakage", "severity": 0.8, "onset": RUN_S / 2}
    scenario = Scenario(duration=RUN_S, load={"name": "spring"}, faults=[leak], seed=5)
    return simulate(Unit.load("axis_a"), scenario).samples


def attempt(trouble: Trouble, run: Samples) -> Outcome:
    """Try a trouble in a folder of its own, sending a run in lines over TCP."""
    blocks = (Block(AXIS, block, number, 0.0) for number, block in enumerate(run.blocks(ROWS)))
    lines = [encode_json(block) + b"\n" for block in blocks]
    with ExitStack() as kept:
        folder = Path(kept.enter_context(tempfile.TemporaryDirectory(prefix="fdd-troubles-")))
        if trouble.own_disk:
            (folder / "state").mkdir()
            subprocess.run(["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", folder / "state"], check=True)
            kept.callback(lambda: subprocess.run(["umount", "-l", folder / "state"], check=True))
        port = free_port()
        process = Process(folder, [{"type": "tcp", "port": port}])
        return _attempt(trouble, process, port, lines, len(run))


def _attempt(trouble: Trouble, process: Process, port: int, lines: list[bytes], sent: int) -> Outcome:
    """`sent`: samples in all `lines`."""
    third, wrong = len(lines) // 3, list[str]()
    try:
        process.start()
        with socket.create_connection(("127.0.0.1", port), 10.0) as link:
            link.settimeout(300.0)  # it waits where the service does not take more
            link.sendall(b"".join(lines[:third]))
            until(lambda: process.samples() >= ROWS * third, ARRIVED_S)
            with ExitStack() as lasting:
                lasting.callback(trouble.begin(process))
                part = (b"".join(lines[third : 2 * third]),)
                meanwhile = threading.Thread(target=link.sendall, args=part, daemon=True)
                meanwhile.start()
                until(process.problems, 20.0)
                said, slowest = "; ".join(process.problems()) or "ok", 0.0
                for path in ("/api/axes", "/metrics", "/"):
                    begun = time.monotonic()
                    if process.get(path) is None:
                        wrong.append(f"{path} is not answered meanwhile")
                    slowest = max(slowest, time.monotonic() - begun)
                if trouble.words not in said:
                    wrong.append(f"health should say {trouble.words!r}")
                errors = process.metric("fdd_store_errors_total")
                if process.popen.poll() is not None:
                    wrong.append(f"it ended with status {process.popen.poll()}")
            meanwhile.join(ARRIVED_S)
            link.sendall(b"".join(lines[2 * third :]))
            until(lambda: process.samples() >= sent, ARRIVED_S)
            if not until(lambda: not process.problems(), 30.0):
                wrong.append(f"afterwards health says {'; '.join(process.problems())!r}")
            time.sleep(2.0)
            accepted = process.samples()
    finally:
        process.kill()
    said = f"{said}; {errors:.0f} store errors; slowest answer {slowest:.1f} s"
    # What is there after a kill and another start.
    process.start()
    # What the journal has of an unfinished frame is counted once the axis is silent.
    until(lambda: process.samples() >= accepted, 20.0)
    found = process.samples()
    if (status := process.end()) != 0:
        wrong.append(f"SIGTERM ends it with status {status}")
    findings, actions = process.told()
    if [fault for fault, _ in findings] != ["internal_leakage"] or actions.count("RAISED") != 1:
        wrong.append(f"findings {findings}, alarms {actions}")
    if accepted != sent:
        wrong.append(f"{sent - accepted} samples were never taken")
    wrong += [f"its log: {line[:200]}" for line in process.lines("Traceback|internal error")]
    said = said.replace(str(process.folder), "…")
    return Outcome(trouble.tried, trouble.how, said, sent, accepted, accepted - found, wrong)


def troubles(
    out: OutOption = FOLDER,
    only: Annotated[list[str] | None, typer.Option(metavar="NAME", help="This one; may be repeated.")] = None,
) -> None:
    """Try every trouble of the service itself, and report what was said and lost (Linux, some need root)."""
    require_folder(out)
    known = {t.tried for t in TROUBLES}
    wanted = set(only or known)
    if unknown := wanted - known:
        raise InputError(f"no trouble {min(unknown)!r}", mend=f"give one of {', '.join(sorted(known))}")
    possible = [t for t in TROUBLES if t.tried in wanted and not (t.own_disk and os.getuid() != 0)]
    without, outcomes = sorted(wanted - {t.tried for t in possible}), list[Outcome]()
    run = leaking()
    with progress("troubling the service", float(len(possible))) as advance:
        for number, trouble in enumerate(possible, 1):
            outcomes.append(attempt(trouble, run))
            advance(float(number))
    wrong = [o.tried for o in outcomes if o.wrong or o.lost]
    told = "".join(f"; not {name}" for name in wrong)
    print(f"{len(outcomes) - len(wrong)} of {len(outcomes)} as they should be{told}")
    write_report(out / "troubles.md", report_text(outcomes, without))


def report_text(outcomes: Sequence[Outcome], without: Sequence[str]) -> str:
    """The report as Markdown."""
    page = Path(__file__).with_name("troubles.md.j2")
    return render(page, made_by=made_by("troubles"), outcomes=outcomes, without=without)
