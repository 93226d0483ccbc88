"""``python -m evidence soak``: two lives of an axis in compressed time, one of which wears."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

REPORT = "soak.md"


def soak(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for soak.md.")] = Path("reports"),
    days: Annotated[int, typer.Option(min=3, max=365, help="Of each life.")] = 30,
    flights: Annotated[int, typer.Option(min=1, max=24, help="A day.")] = 6,
    minutes: Annotated[float, typer.Option(min=1.0, max=50.0, help="Of each flight.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 1,
) -> None:
    """Let an axis live for weeks at 100 Hz through the fleet and its store, with restarts."""
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)

    from evidence.live.soak import Plan, lived
    from evidence.live.soak_report import report_text
    from fdd.cli.console import progress

    plan = Plan(days=days, flights=flights, minutes=minutes, onset=days / 3.0)
    lives = []
    with progress("two lives", 2.0) as advance:
        for number, each in enumerate((plan, replace(plan, severity=0.0))):
            with tempfile.TemporaryDirectory(prefix="fdd-soak-") as folder:
                lives.append(lived(each, seed + number, Path(folder), advance))
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / REPORT, report_text(plan, lives))
    for life in lives:
        print(f"{life.hours:.0f} hours in motion: {len(life.alarms)} alarms")
    print(f"Written to {out / REPORT}")
