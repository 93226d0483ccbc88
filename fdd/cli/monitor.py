"""``fdd monitor``: a stream or a replayed log, diagnosed as it comes."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.failures import stopped_by_signals
from fdd.cli.options import AxisOption, MapOption, ModelOption, UnitOption, argument, option
from fdd.errors import InputError

STATUS_S = 0.5


def monitor(
    source: Annotated[str, argument("A log to replay, or - for JSON lines on standard input.", "SOURCE")],
    unit: UnitOption = None,
    map_: MapOption = None,
    model: ModelOption = None,
    axis: AxisOption = None,
    speed: Annotated[str, typer.Option(help="Replay at so many times real time, or max.")] = "1",
    json_: Annotated[bool, typer.Option("--json", help="Print events as JSON lines.")] = False,
    duration: Annotated[float | None, option("End after so many seconds of data.", min=0.0)] = None,
    state: Annotated[
        Path | None, option("Keep the state in this file: go on from it, save it every minute.")
    ] = None,
) -> None:
    """Watch one axis: findings as they come, a summary at the end (or at Ctrl-C)."""
    rate = replay_speed(speed)
    if state is not None:
        from fdd.files import require_writable

        require_writable(state)

    from fdd.cli.console import progress
    from fdd.cli.monitor_view import TextView, View
    from fdd.diagnosis.model import Model
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.identification.log_scales import StreamScales
    from fdd.logs import ChannelMap, Log, read_log
    from fdd.monitor import JsonLines, LineParser, Replay, watch
    from fdd.monitor.clock import WallClock
    from fdd.monitor.state import load_state, save_state
    from fdd.offline.diagnoser import quality_of, unit_of

    classifier = Model.load(model)
    channel_map = None if map_ is None else ChannelMap.load(map_)
    log: Log | None = None
    name, given = "standard input", axis or (channel_map.axis if channel_map else None)
    if source != "-":
        name = Path(source).name
        with progress(f"reading {name}"):
            log = read_log(Path(source), channel_map, axis)
        given = log.axis
    profile, note = unit_of(log, unit)
    pipeline = Pipeline(profile, classifier, axis=given or profile.axis, log=name, keep_trajectories=False)
    after = offset = float("nan")
    if state is not None and state.exists():
        after, offset = load_state(state, pipeline)
    stop = threading.Event()
    clock = WallClock(stop)
    stream: JsonLines | Replay
    if log is None:
        parser = LineParser(channel_map, after=after, offset=offset)
        stream = JsonLines(_standard_input(), parser, clock=clock)
    else:
        quality = quality_of(log.quality)
        stream = Replay(log.samples, quality, speed=rate, clock=clock, after=after)
    view = View() if json_ else TextView()

    def keep(last_time: float) -> None:
        assert state is not None
        known = stream.offset if isinstance(stream, JsonLines) else 0.0
        save_state(state, pipeline, last_time=last_time, offset=known)

    with stopped_by_signals(stop), view:
        if note:
            view.remark(note)
        try:
            answer = watch(
                stream, pipeline, view.show, clock=clock, stopped=stop.is_set, duration=duration,
                status_every=STATUS_S if view.shows_status else None,
                save=None if state is None else keep, scales=StreamScales(profile, name),
            )  # fmt: skip
        except InputError as error:
            raise (error if error.where == name else error.at(name)) from None
    view.summary(answer)


def replay_speed(text: str) -> float | None:
    """Times real time; None for ``max``.

    Raises
    ------
    InputError : neither a positive number nor ``max``.

    Examples
    --------
    >>> replay_speed("2.5"), replay_speed("max")
    (2.5, None)
    """
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
