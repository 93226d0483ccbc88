"""``python -m evidence plant``: speed and numerics of the plant, measured beside peers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "performance.md"


def plant(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for performance.md and its picture.")
    ] = Path("reports"),
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of each that is timed.")] = 5,
    wild: Annotated[
        int, typer.Option(min=0, max=100_000, help="Random scenarios; 0 leaves them out.")
    ] = 2000,
    halving: Annotated[
        float, typer.Option(min=0.0, max=600.0, help="Seconds run with half steps; 0 leaves them out.")
    ] = 60.0,
    radau: Annotated[
        float, typer.Option(min=0.0, max=60.0, help="Seconds run beside Radau; 0 leaves them out.")
    ] = 2.0,
    quick: Annotated[bool, typer.Option("--quick", help="A minute instead of ten: rough figures.")] = False,
) -> None:
    """Measure how fast, exact and robust the plant is, beside SciPy's solvers."""
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)

    from evidence.plant.pictures import draw_work
    from fdd.pictures import require_matplotlib

    require_matplotlib()

    from evidence.plant.measure import Plan, measure
    from evidence.plant.report import PICTURE, report_text
    from fdd.cli.console import progress

    plan = Plan(repeats=repeats, wild=wild, halving_duration=halving, radau_duration=radau)
    if quick:
        plan = Plan(
            speed_duration=5.0, repeats=2, work_duration=0.1, halving_duration=min(halving, 3.0),
            radau_duration=min(radau, 0.05), wild=min(wild, 20),
        )  # fmt: skip
    with progress("measuring the plant", 1.0) as advance:
        found = measure(plan, advance)
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    draw_work(found.work, out / PICTURE)
    write_text(out / REPORT, report_text(found))
    slowest = min(found.real_time, key=lambda each: each.whole)
    print(f"Slowest case, {slowest.case}: {slowest.whole:.0f} times real time")
    if found.wild:
        print(f"{sum(bool(o.failures) for o in found.wild)} of {len(found.wild)} random runs left physics")
    print(f"Written to {out / REPORT}")
