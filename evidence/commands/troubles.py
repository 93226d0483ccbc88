"""``python -m evidence troubles``: faults of the service's own, tried on the real `fdd serve`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "troubles.md"


def troubles(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for troubles.md.")] = Path("reports"),
    kills: Annotated[int, typer.Option(min=0, max=10_000, help="SIGKILLs; 0 leaves them out.")] = 500,
    seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of the instants of the kills.")] = 7,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Try this one, `mistakes` or `kills`; may be repeated.", show_default=False
        ),
    ] = None,
) -> None:
    """Try every trouble of the service itself, and report what was said and lost."""
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)

    from evidence.troubles.report import TROUBLES, report_text, try_all
    from fdd.cli.console import progress
    from fdd.errors import InputError

    known = {*(t.tried for t in TROUBLES), "mistakes", "kills"}
    if unknown := set(only or ()) - known:
        raise InputError(f"no trouble {min(unknown)!r}", mend=f"give one of {', '.join(sorted(known))}")
    with progress("troubling the service", 1.0) as advance:
        outcomes, without = try_all(only or (), kills, seed, advance)
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / REPORT, report_text(outcomes, without))
    wrong = [o.tried for o in outcomes if o.wrong or o.lost]
    print(
        f"{len(outcomes) - len(wrong)} of {len(outcomes)} as they should be"
        + "".join(f"; not {w}" for w in wrong)
    )
    print(f"Written to {out / REPORT}")
