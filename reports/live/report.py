"""``python -m reports load``: how many axes one core watches in real time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from fdd.cli.console import progress, remark
from fdd.errors import InputError
from reports.live.inside import Inside, inside, logs
from reports.live.ramp import LAG_S, SETTLE_S, Overload, Stage, harder, overload, ramp, why_not
from reports.writing import FOLDER, OutOption, load_now, made_by, require_folder, template, write_report

GOAL_AXES, GOAL_BYTES = 100, 20e6
"""Axes on a core, and memory of each, that were asked for."""
HARDER_AXES = 40
"""Of the cases in which each axis costs more."""
FLEET_AXES, FLEET_SHARDS = 1000, 16


def load(
    out: OutOption = FOLDER,
    axes: Annotated[
        str, typer.Option(help="Numbers of axes that are tried, rising.", metavar="N,N,...")
    ] = "20,40,60,80,90,100,120,140",
    seconds: Annotated[float, typer.Option(min=20.0, max=3600.0, help="With each number of axes.")] = 60.0,
    repeats: Annotated[int, typer.Option(min=1, max=100, help="Runs of the fleet that are timed.")] = 3,
    aged: Annotated[
        float, typer.Option(min=0.0, max=36_000.0, help="s of data by which memory is told.")
    ] = 660.0,
    quick: Annotated[bool, typer.Option("--quick", help="A few minutes instead of twenty: rough.")] = False,
) -> None:
    """Measure fdd serve on one core: axes in real time, lag, processor time, memory (20 min)."""
    require_folder(out)
    numbers = sorted({int(n) for n in axes.split(",")}) if axes.replace(",", "").isdecimal() else []
    if not numbers or not 0 < numbers[0] <= numbers[-1] <= 1000:
        raise InputError(f"--axes {axes!r} are no numbers from 1 to 1000", mend="write e.g. 20,40,60")
    watched, span, missing = 10, 60.0, why_not()
    if quick:
        watched, span, seconds, repeats, aged = 4, 20.0, min(seconds, 25.0), 1, 0.0
    with progress("simulating logs"):
        recorded = logs(max(aged, 60.0, 0.0 if missing else seconds * len(numbers)))
    with progress("measuring the fleet's thread"):
        cost = inside(recorded, watched, span, repeats, aged)
    stages, cases, over = [], {}, None
    if missing is None:
        stages = ramp(recorded, numbers, seconds, remark)
        cases = harder(recorded, min(HARDER_AXES, numbers[-1]), seconds, remark)
        over = overload(recorded, 2 * max(_most(stages), 1), 2.0 * seconds)
    write_report(out / "live.md", report_lines(cost, stages, seconds, missing, cases, over))
    print(f"{cost.whole:.1f} µs a sample, of which {cost.alone:.1f} are the pipeline's")
    print(f"{_most(stages)} axes in real time on one core" if stages else f"not in real time: {missing}")


def _most(stages: Sequence[Stage]) -> int:
    return max((s.axes for s in stages if s.in_time), default=0)


def report_lines(
    cost: Inside, stages: Sequence[Stage], seconds: float, why: str | None = None,
    cases: Mapping[str, Stage] | None = None, over: Overload | None = None,
) -> list[str]:  # fmt: skip
    """The whole report; `why` says what hindered the measurement in real time."""
    each = math.ceil(FLEET_AXES / FLEET_SHARDS)
    near = min(stages, key=lambda s: abs(s.axes - each), default=None)
    # Bytes of a service without axes, by the line through the stages.
    base = stages[0].rss if stages else 0.0
    if len(stages) > 1:
        base = max(float(np.polyfit([s.axes for s in stages], [s.rss for s in stages], 1)[1]), 0.0)
    page = template(Path(__file__).with_name("live.md.j2"))
    text = page.render(
        made_by=made_by("load"), load_now=load_now(), cost=cost, stages=stages, seconds=seconds, why=why,
        best=_most(stages), goal_axes=GOAL_AXES, goal_bytes=GOAL_BYTES, settle=SETTLE_S, lag=LAG_S,
        each=each, near=near, us=cost.whole if near is None else near.cpu_us, base=base, fleet=FLEET_AXES,
        shards=FLEET_SHARDS, cases=cases or {}, over=over, aged=math.isfinite(cost.axis_bytes),
    )  # fmt: skip
    return text.splitlines()
