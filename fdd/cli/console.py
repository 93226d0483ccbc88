"""What a person sees: consoles, and progress of what takes longer than two seconds."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from rich.console import Console

from fdd.progress import Advance

PATIENCE_S = 2.0
"""Nothing is shown of what is done sooner."""


class _Pipe(Console):
    """A console whose reader may go away: that ends the command, with its own exit status."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError


def output() -> Console:
    """Console on standard output, as it stands now."""
    return _Pipe(file=sys.stdout, highlight=False, emoji=False)


def messages() -> Console:
    """Console on standard error, for progress and remarks."""
    return Console(file=sys.stderr, highlight=False, emoji=False)


def remark(text: str) -> None:
    """One line on standard error that is no error."""
    print(f"fdd: {' '.join(text.split())}", file=sys.stderr)


@contextmanager
def progress(title: str, total: float | None = None) -> Iterator[Advance]:
    """Show progress on standard error where that is a terminal.

    Parameters
    ----------
    title : what is being done.
    total : of what the function given is told; None shows a spinner only.

    Yields
    ------
    Function to call with how much is done in all.
    """
    console = messages()
    if not console.is_terminal:
        yield lambda done: None
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    bars = (BarColumn(), TimeRemainingColumn()) if total else ()
    shown = Progress(
        SpinnerColumn(), TextColumn("{task.description}"), *bars, console=console, transient=True
    )
    task = shown.add_task(title, total=total)
    timer = threading.Timer(PATIENCE_S, shown.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda done: shown.update(task, completed=done)
    finally:
        timer.cancel()
        timer.join()
        shown.stop()
