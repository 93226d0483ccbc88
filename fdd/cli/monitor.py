"""``fdd monitor``: a stream or a replayed log, diagnosed as it comes.

With ``--json`` each line carries ``event``: ``finding`` (with ``time_s`` and the finding's fields as in the
answer), ``note`` (``time_s``, ``text``) and, last of all, ``summary`` (``diagnosis``: the answer).
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fdd.cli.command import (
    AxisOption,
    MapOption,
    ModelOption,
    SpeedOption,
    UnitOption,
    argument,
    option,
    stopped_by_signals,
)
from fdd.errors import InputError

if TYPE_CHECKING:
    from rich.text import Text

    from fdd.logs import Log
    from fdd.monitor import Event, Found, Noted, Status

STATUS_S = 0.5
SHORT = {
    "leakage": "leakage", "bulk_modulus": "bulk modulus", "coulomb_friction": "Coulomb",
    "viscous_friction": "viscous",
}  # fmt: skip


def monitor(
    source: Annotated[str, argument("A log to replay, or - for JSON lines on standard input.", "SOURCE")],
    unit: UnitOption = None,
    map_: MapOption = None,
    model: ModelOption = None,
    axis: AxisOption = None,
    speed: SpeedOption = "1",
    json_: Annotated[bool, typer.Option("--json", help="Print events as JSON lines.")] = False,
    duration: Annotated[float | None, option("End after so many seconds of data.", min=0.0)] = None,
) -> None:
    """Watch one axis: findings as they come, a summary at the end (or at Ctrl-C)."""
    rate = replay_speed(speed)

    from rich.live import Live

    from fdd.cli.console import diagnosis_view, output, progress, remark
    from fdd.diagnosis.model import Model
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.identification.log_scales import StreamScales
    from fdd.logs import ChannelMap, read_log
    from fdd.monitor import JsonLines, LineParser, Noted, Replay, Status, WallClock, watch
    from fdd.offline import quality_of, unit_of

    classifier = Model.load(model)
    channel_map = None if map_ is None else ChannelMap.load(map_)
    stop = threading.Event()
    clock = WallClock(stop)
    log: Log | None = None
    name, given = "standard input", axis or (channel_map.axis if channel_map else None)
    if source != "-":
        name = Path(source).name
        with progress(f"reading {name}"):
            log = read_log(Path(source), channel_map, axis)
        given = log.axis
    profile, note = unit_of(log, unit)
    pipeline = Pipeline(profile, classifier, axis=given or profile.axis, log=name, keep_trajectories=False)
    stream: JsonLines | Replay
    if log is None:
        stream = JsonLines(_standard_input(), LineParser(channel_map), clock=clock)
    else:
        stream = Replay(log.samples, quality_of(log.quality), speed=rate, clock=clock)
    console = output()
    live = Live(console=console, transient=True, auto_refresh=False)
    shows_status = console.is_terminal and not json_

    def show(event: Event) -> None:
        if isinstance(event, Status):
            live.update(status_line(event), refresh=True)
        elif json_:
            print(json.dumps(_data(event), ensure_ascii=False), flush=True)
        else:
            for line in _lines(event):
                console.print(line, soft_wrap=True)
            sys.stdout.flush()

    with stopped_by_signals(stop), live if shows_status else nullcontext():
        if note and json_:
            remark(note)
        elif note:
            show(Noted(math.nan, note))
        try:
            answer = watch(
                stream, pipeline, show, clock=clock, stopped=stop.is_set, duration=duration,
                status_every=STATUS_S if shows_status else None, scales=StreamScales(profile, name),
            )  # fmt: skip
        except InputError as error:
            raise (error if error.where == name else error.at(name)) from None
    if json_:
        summary = {"event": "summary", "diagnosis": json.loads(answer.model_dump_json(by_alias=True))}
        print(json.dumps(summary, ensure_ascii=False), flush=True)
    else:
        console.print(diagnosis_view(answer))


def replay_speed(text: str) -> float | None:
    """Times real time; None for ``max``."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not 0.0 < speed < math.inf:
        raise InputError(f"--speed {text!r} is no speed", mend="give a positive number, or max")
    return speed


def _standard_input() -> Callable[[int], bytes]:
    """Read what is there, without waiting for a whole buffer."""
    try:
        number = sys.stdin.fileno()
    except (OSError, ValueError):  # replaced by an object in memory
        return sys.stdin.buffer.read
    return lambda most: os.read(number, most)


def _data(event: Found | Noted) -> dict[str, Any]:
    from fdd.monitor import Noted

    if isinstance(event, Noted):
        time = None if math.isnan(event.time) else event.time
        return {"event": "note", "time_s": time, "text": event.text}
    return {"event": "finding", "time_s": event.time, **json.loads(event.finding.model_dump_json())}


def _lines(event: Found | Noted) -> list[Text]:
    from rich.text import Text

    from fdd.monitor import Noted
    from fdd.report.words import finding_words

    if isinstance(event, Noted):
        return [Text(f"{_stamp(event.time)} {event.text}", style="yellow")]
    words = finding_words(event.finding)
    lines = [Text(f"{_stamp(event.time)} {words.headline}", style="bold red")]
    return [*lines, Text(f"{' ' * 12} {words.alternatives}")] if words.alternatives else lines


def _stamp(time: float) -> str:
    return "[      start]" if math.isnan(time) else f"[{time:8.2f} s]"


def status_line(status: Status) -> Text:
    """Time, the likeliest families and the estimates that the data pin down, in one line."""
    from rich.text import Text

    from fdd.cli.console import COLOURS
    from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED
    from fdd.report.tables import with_std
    from fdd.report.words import family_title, percent

    line = Text(f"{_stamp(status.time)} ", no_wrap=True, overflow="ellipsis")
    line.append(status.verdict, style=COLOURS[status.verdict])
    ordered = sorted(status.probabilities.items(), key=lambda item: -item[1])
    top = [(name, p) for k, (name, p) in enumerate(ordered[:2]) if k == 0 or p >= 0.05]
    line.append("".join(f"  {family_title(name).lower()} {percent(p)}" for name, p in top))
    for name, estimate in status.estimates.items():
        if estimate.value is not None and estimate.observable:
            scale, unit = DISPLAY_SCALE[name], ESTIMATED[name][1]
            std = None if estimate.std is None else estimate.std * scale
            line.append(f"  {SHORT[name]} {with_std(estimate.value * scale, std)} {unit}")
    return line
