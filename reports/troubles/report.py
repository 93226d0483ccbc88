"""``python -m reports troubles``: faults of the service's own, tried on the real `fdd serve`."""

from __future__ import annotations

import os
import resource
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.markdown import table
from reports.service import MOSQUITTO, Process
from reports.troubles.trial import Mqtt, Outcome, Sender, Trouble, shifted
from reports.writing import FOLDER, OutOption, made_by, require_folder, write_report


@contextmanager
def locked(process: Process, sender: Sender) -> Iterator[None]:
    """Another program holds the store's lock."""
    other = sqlite3.connect(process.state / "fdd.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.execute("ROLLBACK")
        other.close()


@contextmanager
def full(process: Process, sender: Sender) -> Iterator[None]:
    """A file fills the disk (a small tmpfs) that the state folder is on."""
    filler = process.state / "filler"
    with filler.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        filler.unlink()


@contextmanager
def no_growth(process: Process, sender: Sender) -> Iterator[None]:
    """No file of the process may grow beyond 64 KiB (RLIMIT_FSIZE), as with a quota."""
    pid, kind = process.popen.pid, resource.RLIMIT_FSIZE
    soft, hard = resource.prlimit(pid, kind)
    resource.prlimit(pid, kind, (1 << 16, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, kind, (soft, hard))


@contextmanager
def renamed_file(process: Process, sender: Sender) -> Iterator[None]:
    """The store's file is moved away, and later back."""
    path = process.state / "fdd.db"
    path.rename(away := path.with_name("away.db"))
    try:
        yield
    finally:
        away.rename(path)


@contextmanager
def broker_away(process: Process, sender: Sender) -> Iterator[None]:
    """The broker is stopped, and started again."""
    assert isinstance(sender, Mqtt)
    sender.broker.stop()
    try:
        yield
    finally:
        sender.broker.start()


@contextmanager
def clock_ahead(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is an hour ahead, and set back."""
    with _clock(process.clock, 3600):
        yield


@contextmanager
def clock_back(process: Process, sender: Sender) -> Iterator[None]:
    """The host's clock is set back by an hour, and is set right."""
    with _clock(process.clock, -3600):
        yield


@contextmanager
def _clock(clock: Path, off: int) -> Iterator[None]:
    for seconds in (off, 0):
        (new := clock.with_name("clock.new")).write_text(str(seconds))
        new.rename(clock)
        if seconds:
            yield


@contextmanager
def set_in_the_middle(process: Process, sender: Sender) -> Iterator[None]:
    """From the middle of the run on its stamps are an hour off."""
    yield


HOUR_S = 3600.0
TROUBLES = (
    Trouble("broker restarted", broker_away, "not connected", mqtt=True),
    Trouble("disk full", full, "disk is full", disk=12),
    Trouble("quota reached", no_growth, "cannot be read or written"),
    Trouble("store locked", locked, "is locked"),
    Trouble("store's file gone", renamed_file, "file is gone"),
    Trouble("host's clock ahead", clock_ahead),
    Trouble("host's clock back", clock_back),
    Trouble(
        "sender's clock ahead",
        set_in_the_middle,
        change=lambda b: [*b[:300], *shifted(b[300:], HOUR_S)],
    ),
    Trouble(
        "sender's clock back",
        set_in_the_middle,
        change=lambda b: [*b[:300], *shifted(b[300:], -HOUR_S)],
    ),
)


def left_out(trouble: Trouble) -> str | None:
    """Why a trouble cannot be tried on this machine; None where it can."""
    if trouble.mqtt and MOSQUITTO is None:
        return "no mosquitto here"
    return "needs root, to mount a small disk" if trouble.disk is not None and os.getuid() != 0 else None


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
    without, outcomes = {}, []
    with progress("troubling the service", 1.0) as advance:
        for number, trouble in enumerate(TROUBLES, 1):
            if trouble.tried in wanted and (why := left_out(trouble)):
                without[trouble.tried] = why
            elif trouble.tried in wanted:
                outcomes.append(trouble.attempt())
            advance(number / len(TROUBLES))
    wrong = [o.tried for o in outcomes if o.wrong or o.lost]
    told = "".join(f"; not {name}" for name in wrong)
    print(f"{len(outcomes) - len(wrong)} of {len(outcomes)} as they should be{told}")
    write_report(out / "troubles.md", report_lines(outcomes, without))


def report_lines(outcomes: Sequence[Outcome], without: dict[str, str]) -> list[str]:
    """The report as Markdown."""
    lines = [
        "# What troubles the service itself, and what is lost",
        "",
        f"{made_by('troubles')}. "
        "Each is tried on the real `fdd serve`: a run of a minute that "
        "leaks from its middle on is sent, a third before the trouble, a third while it lasts, a third after "
        "it; then the service is killed (SIGKILL) and started again. *Accepted* are the samples it had taken "
        "before the kill, *lost* those of them that are not there after it. The leak must be found and its "
        "alarm raised once, health must say what is wrong and then nothing, and page, API and metrics must "
        "answer meanwhile.",
        "",
        *table(
            ["tried", "how", "what the service said", "sent", "accepted", "lost", "verdict"],
            [[o.tried, _cell(o.how), _cell(o.said), str(o.sent), str(o.accepted), str(o.lost), _verdict(o)]
             for o in outcomes],
            "lllrrrl",
        ),
    ]  # fmt: skip
    return lines + [f"Left out: {name} ({why})." for name, why in without.items()]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _verdict(outcome: Outcome) -> str:
    if outcome.wrong or outcome.lost:
        return f"WRONG: {_cell('; '.join(outcome.wrong))}"
    return "as it should be"
