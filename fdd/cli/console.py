"""What a person sees: consoles, and progress of what takes longer than two seconds."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from rich import box
from rich.console import Console, OverflowMethod
from rich.table import Table
from rich.text import Text

from fdd.engines import Advance

PATIENCE_S = 2.0
"""Nothing is shown of what is done sooner."""
NARROW: dict[str, Any] = {"show_edge": False, "pad_edge": False}
"""Shape of a table without margins."""


class _Pipe(Console):
    """A console whose reader may go away: that ends the command, with its own exit status."""

    def on_broken_pipe(self) -> NoReturn:
        raise BrokenPipeError


def output() -> Console:
    """Console on standard output, as it stands now; what comes from logs is plain text, never markup."""
    return _Pipe(file=sys.stdout, highlight=False, emoji=False, markup=False)


def remark(text: str) -> None:
    """One line on standard error that is no error."""
    print(f"fdd: {' '.join(text.split())}", file=sys.stderr)


@contextmanager
def progress(title: str, total: float | None = None) -> Iterator[Advance]:
    """Show progress on standard error where that is a terminal; gives the function to call with how much is
    done in all, of `total`. None shows a spinner only."""
    console = Console(file=sys.stderr, highlight=False, emoji=False, markup=False)
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


@contextmanager
def counted(title: str) -> Iterator[Callable[[int, int], None]]:
    """`progress` for work that tells (done, total)."""
    with progress(title, 1.0) as advance:
        yield lambda done, total: advance(done / max(total, 1))


def grid(
    columns: Iterable[str],
    rows: Iterable[Sequence[str]] = (),
    *,
    numbers: Collection[str] = (),
    whole: Collection[str] = (),
    **shape: Any,
) -> Table:
    """A table of plain text, of that `shape` of rich's.

    `numbers` are the columns that stand to the right, `whole` those beside them that are never wrapped.
    """
    table = Table(box=box.SIMPLE_HEAD, **shape)
    for name in columns:
        tight = name in numbers or name in whole
        overflow: OverflowMethod = "ellipsis" if tight else "fold"
        table.add_column(
            name, justify="right" if name in numbers else "left", no_wrap=tight, overflow=overflow
        )
    for row in rows:
        table.add_row(*map(Text, row))
    return table
