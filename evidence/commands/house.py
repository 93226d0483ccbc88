"""``python -m evidence house``: size, structure and start of two commits side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "house.md"


def house(
    before: Annotated[str, typer.Option(help="Commit to compare with.", show_default=False)],
    after: Annotated[str, typer.Option(help="Commit.")] = "HEAD",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for house.md.")] = Path("reports"),
) -> None:
    """Measure the code's size, structure and start."""
    from evidence.house import report_text
    from fdd.cli.console import progress
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)
    with progress("measuring both", 1.0) as advance:
        text = report_text(before, after, advance)
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / REPORT, text)
    print(f"Written to {out / REPORT}")
