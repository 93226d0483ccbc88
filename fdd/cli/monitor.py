"""``fdd monitor``: a stream or a replayed log, diagnosed as it comes."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.failures import stopped_by_signals
from fdd.cli.options import AxisOption, MapOption, ModelOption, UnitOption, argument, option
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.logs import ChannelMap, Log
    from fdd.monitor import JsonLines, Replay
    from fdd.monitor.clock import Clock
    from fdd.unit import Unit

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

    from fdd.cli.monitor_view import TextView, View
    from fdd.diagnosis.model import Model
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.monitor import JsonLines, watch
    from fdd.monitor.clock import WallClock
    from fdd.monitor.state import load_state, save_state

    classifier = Model.load(model)
    opened = _open(source, unit, map_, axis)
    pipeline = Pipeline(opened.unit, classifier, axis=opened.axis, log=opened.name, keep_trajectories=False)
    after = offset = float("nan")
    if state is not None and state.exists():
        after, offset = load_state(state, pipeline)
    stop = threading.Event()
    clock = WallClock(stop)
    stream = opened.stream(clock, rate, after, offset)
    view = View() if json_ else TextView()

    def keep(last_time: float) -> None:
        assert state is not None
        known = stream.offset if isinstance(stream, JsonLines) else 0.0
        save_state(state, pipeline, last_time=last_time, offset=known)

    with stopped_by_signals(stop), view:
        if opened.note:
            view.remark(opened.note)
        try:
            answer = watch(
                stream,
                pipeline,
                view.show,
                clock=clock,
                stopped=stop.is_set,
                duration=duration,
                status_every=STATUS_S if view.shows_status else None,
                save=keep if state is not None else None,
            )
        except InputError as error:
            raise error.at(opened.name) from None
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


@dataclass(frozen=True)
class _Input:
    """What is watched: a log that was read, or standard input where `log` is None."""

    name: str
    axis: str
    unit: Unit
    note: str | None
    log: Log | None
    channel_map: ChannelMap | None

    def stream(self, clock: Clock, speed: float | None, after: float, offset: float) -> JsonLines | Replay:
        """The source of samples, going on from where an earlier run was."""
        from fdd.monitor import JsonLines, LineParser, Replay
        from fdd.offline.diagnoser import quality_of

        if self.log is not None:
            quality = quality_of(self.log.quality)
            return Replay(self.log.samples, quality, speed=speed, clock=clock, after=after)
        parser = LineParser(self.channel_map, after=after, offset=offset)
        return JsonLines(_standard_input(), parser, clock=clock)


def _open(source: str, unit: str | None, map_: Path | None, axis: str | None) -> _Input:
    from fdd.cli.console import progress
    from fdd.logs import ChannelMap, read_log
    from fdd.offline.unit_of_log import unit_of

    channel_map = None if map_ is None else ChannelMap.load(map_)
    if source == "-":
        profile, note = unit_of(None, unit)
        mapped = channel_map.axis if channel_map else None
        return _Input("standard input", axis or mapped or profile.axis, profile, note, None, channel_map)
    path = Path(source)
    with progress(f"reading {path.name}"):
        log = read_log(path, channel_map, axis)
    profile, note = unit_of(log, unit)
    return _Input(path.name, log.axis or profile.axis, profile, note, log, channel_map)


def _standard_input() -> Callable[[int], bytes]:
    """Read what is there, without waiting for a whole buffer."""
    try:
        number = sys.stdin.fileno()
    except (OSError, ValueError):  # replaced by an object in memory
        return sys.stdin.buffer.read
    return lambda most: os.read(number, most)
