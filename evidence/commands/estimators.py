"""``python -m evidence estimators``: how well they do, beside the bound, least squares and filterpy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "estimators.md"
PICTURES = "estimators"


def estimators(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for estimators.md and its pictures.")
    ] = Path("reports"),
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Runs of each case.")] = 100,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 0,
    still: Annotated[
        int, typer.Option(min=0, max=1000, help="Runs of an hour at standstill; 0 leaves them out.")
    ] = 10,
    peers: Annotated[
        int, typer.Option(min=0, max=1000, help="Runs of each case beside filterpy; 0 leaves them out.")
    ] = 3,
    speed: Annotated[bool, typer.Option(help="Measure speed too.")] = True,
) -> None:
    """Measure how well the EHA estimators do: errors, consistency, speed of response, standstill."""
    from fdd.errors import InputError
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)

    from fdd.pictures import require_matplotlib

    require_matplotlib()

    from importlib.util import find_spec

    if peers and find_spec("filterpy") is None:
        raise InputError("filterpy, the peer, is not installed", mend="install fdd[test], or give --peers 0")

    from evidence.estimators.measure import Plan, measure
    from evidence.estimators.pictures import draw_pictures
    from evidence.estimators.report import report_text
    from evidence.estimators.run import WORLDS
    from evidence.estimators.speed_section import measure_speed
    from evidence.estimators.summary import goals
    from fdd.cli.console import progress

    plan = Plan(runs=runs, still=still, peers=peers, seed=seed)
    # First, while nothing of this command runs beside it.
    with progress("measuring speed"):
        table = measure_speed() if speed else None
    with progress("measuring the estimators", 1.0) as advance:
        found = measure(plan, workers, advance)
    found.speed = table
    with written(out):
        (out / PICTURES).mkdir(parents=True, exist_ok=True)
    draw_pictures(found, out / PICTURES)
    write_text(out / REPORT, report_text(found))
    for world in WORLDS:
        for goal in goals(found, world):
            print(f"{world}: {goal.name}: {goal.met} of {goal.total}")
    print(f"Written to {out / REPORT}")
