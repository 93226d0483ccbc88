"""``python -m evidence mutations``: small slips in the product's code, and which of them no test notices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "mutations.md"


def mutations(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for mutations.md.")] = Path("reports"),
    each: Annotated[int, typer.Option(min=1, max=1000, help="Slips a module.")] = 5,
    seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of the draw of slips.")] = 7,
    room: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A folder of fdd/; may be repeated.", show_default=False),
    ] = None,
    kept: Annotated[Path | None, typer.Option(help="File of what was tried already; grows.")] = None,
) -> None:
    """Put small slips into the code one at a time, and report those that no test notices."""
    import tempfile

    from evidence.mutations.report import report_text
    from evidence.mutations.trying import ROOMS, UNNOTICED, all_tried
    from fdd.errors import InputError
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)
    if unknown := set(room or ()) - set(ROOMS):
        raise InputError(f"no room {min(unknown)!r}", mend=f"give one of {', '.join(ROOMS)}")
    with tempfile.TemporaryDirectory() as scratch:
        tried = list(all_tried(room or ROOMS, each, seed, kept or Path(scratch) / "tried.jsonl"))
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / REPORT, report_text(tried, seed=seed, each=each))
    print(f"{sum(by not in UNNOTICED for _, by in tried)} of {len(tried)} slips noticed")
    print(f"Written to {out / REPORT}")
