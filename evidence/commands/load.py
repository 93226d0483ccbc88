"""``python -m evidence load``: how many axes one core watches in real time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "live.md"


def load(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for live.md.")] = Path("reports"),
    axes: Annotated[
        str, typer.Option(help="Numbers of axes that are tried, rising.", metavar="N,N,...")
    ] = "20,40,60,80,90,100,120,140",
    seconds: Annotated[
        float, typer.Option(min=20.0, max=3600.0, help="In real time, with each number of axes.")
    ] = 60.0,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of the fleet that are timed.")] = 3,
    aged: Annotated[
        float, typer.Option(min=0.0, max=36_000.0, help="Seconds of data by which memory is told.")
    ] = 660.0,
    quick: Annotated[bool, typer.Option("--quick", help="Two minutes instead of fifteen: rough.")] = False,
) -> None:
    """Measure fdd serve on one core: axes in real time, lag, processor time, memory."""
    from fdd.cli.console import progress, remark
    from fdd.errors import InputError
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)
    try:
        numbers = sorted({int(n) for n in axes.split(",")})
    except ValueError:
        numbers = []
    if not numbers or not 0 < numbers[0] <= numbers[-1] <= 1000:
        raise InputError(f"--axes {axes!r} are no numbers from 1 to 1000", mend="write e.g. 20,40,60")

    from evidence.live.inside import inside
    from evidence.live.messages import logs
    from evidence.live.processes import why_not
    from evidence.live.ramp import ramp
    from evidence.live.report import report_text

    missing = why_not()
    watched, span = (10, 60.0)
    if quick:
        watched, span, seconds, repeats, aged = 4, 20.0, min(seconds, 25.0), 1, 0.0
    with progress("simulating logs"):
        recorded = logs(max(aged, 60.0, 0.0 if missing else seconds * len(numbers)))
    with progress("measuring the fleet's thread"):
        cost = inside(recorded, watched, span, repeats, aged)
    stages = []
    if missing:
        remark(f"not measured in real time: {missing}")
    else:
        stages = ramp(recorded, numbers, seconds, remark)
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / REPORT, report_text(cost, stages, seconds, missing))
    best = max((s.axes for s in stages if s.in_time), default=0)
    print(f"{cost.whole:.1f} µs a sample, of which {cost.alone:.1f} are the pipeline's")
    if stages:
        print(f"{best} axes in real time on one core")
    print(f"Written to {out / REPORT}")
