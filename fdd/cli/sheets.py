"""What ``fdd compare`` and ``fdd trend`` print and write alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

if TYPE_CHECKING:
    from pydantic import BaseModel

    from fdd.report.sheet import Table


def print_tables(console: Console, tables: Sequence[Table], notes: Sequence[str]) -> None:
    """Tables and notes; what comes from logs is shown as plain text, never as markup."""
    for table in tables:
        grid = Grid(box=box.SIMPLE_HEAD, title=Text(table.title), title_justify="left", title_style="bold")
        for k, title in enumerate(table.columns):
            grid.add_column(
                title, justify="right" if k and table.numbers else "left", no_wrap=bool(k and table.numbers)
            )
        for k, row in enumerate(table.rows):
            grid.add_row(*(Text(cell) for cell in row), style="bold" if k in table.marked else "")
        console.print(grid)
        if table.note:
            console.print(Text(f"  {table.note}\n", style="dim"))
    for note in notes:
        console.print(Text(f"• {note}", style="yellow"))


def require_outputs(json_: str | None, *files: Path | None) -> None:
    """Refuse outputs before minutes are spent on them.

    Raises
    ------
    InputError : one cannot be written.
    """
    from fdd.files import require_writable

    for path in (None if json_ in (None, "-") else Path(str(json_)), *files):
        if path is not None:
            require_writable(path)


def write_json(target: str | None, answer: BaseModel) -> None:
    """The answer as JSON to a file or, for ``-``, standard output; nowhere for None.

    Raises
    ------
    InputError : it cannot be written.
    """
    if target is None:
        return
    text = answer.model_dump_json(by_alias=True, indent=2) + "\n"
    if target == "-":
        print(text, end="")
    else:
        from fdd.files import write_text

        write_text(Path(target), text)
