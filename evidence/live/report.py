"""The measured figures as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from evidence.live.inside import Inside
from evidence.live.ramp import LAG_S, SETTLE_S, Stage
from evidence.machine import load_now, machine
from fdd import __version__
from fdd.markdown import table

GOAL_AXES, GOAL_BYTES = 100, 20e6
"""Axes on a core, and memory of each, that were asked for."""
FLEET_AXES, FLEET_SHARDS = 1000, 16


def report_text(cost: Inside, stages: Sequence[Stage], seconds: float, why: str | None = None) -> str:
    """The whole report.

    Parameters
    ----------
    cost : of the fleet's thread. stages : of the service in real time. seconds : of each stage.
    why : what hindered the measurement in real time.
    """
    parts = [
        "# fdd serve on one core",
        "",
        f"Made by `python -m evidence load` of fdd {__version__} on {machine()}; {load_now()}",
        "An axis sends time and eleven channels (all but a load cell) at 1 kHz, a block of 100 ms (Arrow, "
        "`fdd.block/1`) at a time.",
        "",
        *(_real_time(stages, seconds) if stages else [f"Not measured in real time: {why}.", ""]),
        *_inside(cost),
        *_calculated(cost, stages),
    ]
    return "\n".join(parts).rstrip() + "\n"


def _real_time(stages: Sequence[Stage], seconds: float) -> list[str]:
    best = max((s.axes for s in stages if s.in_time), default=0)
    rows = [
        [
            str(s.axes), f"{s.cpu_us:.1f}", f"{100 * s.busy:.0f} %", f"{s.lag:.2f}", f"{s.lag_99:.2f}",
            f"{s.findings} ({s.finding_lag:.2f})" if s.findings else "0", str(s.dropped), f"{s.behind:.1f}",
            f"{s.late:.2f}", f"{s.rss / 1e6:.0f}", f"{60 * s.rss_growth / s.axes / 1e6:.2f}",
        ]
        for s in stages
    ]  # fmt: skip
    verdict = "met" if best >= GOAL_AXES else "missed"
    return [
        "## In real time",
        "",
        "`fdd serve` with an MQTT source, its store on disk and its page, pinned to one core; mosquitto "
        f"and the sender on the others. {seconds:g} s with each number of axes, of which at most "
        f"{SETTLE_S:g} are for the new ones to start. *Lag* is from the sending of a look's last sample "
        "until the page's stream of events has the look, its findings stored; the block after that sample is "
        "part of it, 0.1 s. The last row is where 99 % of the "
        f"looks take longer than {LAG_S:g} s or a sample is lost.",
        "",
        *table(
            [
                "axes", "µs a sample", "of the core", "lag (s)", "lag, 99 % (s)", "findings (latest, s)",
                "samples lost", "s waiting at the end", "sender late, 99 % (s)", "RSS (MB)",
                "growth, MB/min an axis",
            ],
            rows, "lr",
        ),
        f"In real time on one core: {best} axes; asked for were {GOAL_AXES}: {verdict}."
        + (f" {_by_the_processor(stages)}" if stages[-1].in_time else ""),
        "",
    ]  # fmt: skip


def _by_the_processor(stages: Sequence[Stage]) -> str:
    return (
        f"By its share of the core the last row's cost would carry {stages[-1].axes / stages[-1].busy:.0f}."
    )


def _inside(cost: Inside) -> list[str]:
    top = sum(us for label, us in cost.items.items() if not label.startswith("—"))
    rows = [[label, f"{us:.2f}", f"{100 * us / top:.0f} %"] for label, us in cost.items.items()]
    lines = [
        "## Where the time goes",
        "",
        f"The fleet's own work, message to finding, in one thread: {cost.axes} axes, {cost.seconds:g} s "
        f"each, as fast as it goes. {cost.whole:.1f} µs of processor time a sample, {cost.alone:.1f} µs of "
        "it the pipeline's (measured alone, in blocks of half a second): the service adds "
        f"{cost.whole - cost.alone:.1f} µs. The table is of one more run in which these functions are "
        "timed; lines with — are parts of the one above.",
        "",
        *table(["", "µs a sample", "share"], rows, "lr"),
    ]
    if math.isfinite(cost.axis_bytes):
        verdict = "met" if cost.axis_bytes <= GOAL_BYTES else "missed"
        lines += [
            f"Memory: {cost.axis_bytes / 1e6:.1f} MB an axis after {cost.aged_s:g} s of data, when the "
            "page's ten minutes and the window of onsets are full; asked for were "
            f"{GOAL_BYTES / 1e6:.0f} MB: {verdict}.",
            "",
        ]
    return lines


def _calculated(cost: Inside, stages: Sequence[Stage]) -> list[str]:
    """What a larger fleet takes, by what was measured."""
    mine = math.ceil(FLEET_AXES / FLEET_SHARDS)
    near = min(stages, key=lambda s: abs(s.axes - mine), default=None)
    us = cost.whole if near is None else near.cpu_us
    of = "the fleet's thread" if near is None else f"the whole process with {near.axes} axes"
    lines = [
        f"## {FLEET_AXES} axes in {FLEET_SHARDS} shards, calculated",
        "",
        "A shard is a process of its own with its own store, and shares nothing with the others but the "
        f"broker. Each has {mine} axes: {mine} × 1000 samples a second × {us:.1f} µs ({of}) = "
        f"{100e-3 * mine * us:.0f} % of a core; all together {1e-3 * FLEET_AXES * us:.1f} cores.",
    ]
    if math.isfinite(cost.axis_bytes):
        base = _base(stages)
        lines.append(
            f"Memory of a shard: {base / 1e6:.0f} MB that hang on no axis + {mine} × "
            f"{cost.axis_bytes / 1e6:.1f} MB = {(base + mine * cost.axis_bytes) / 1e9:.2f} GB; all together "
            f"{FLEET_SHARDS * (base + mine * cost.axis_bytes) / 1e9:.1f} GB."
        )
    return [
        *lines,
        "",
        "It assumes that each shard has a core like this one, that disk and broker keep up with "
        f"{FLEET_AXES * 10:,} blocks, some {FLEET_AXES * 0.11:.0f} MB, a second, and that axes are dealt "
        "evenly; it was not run.",
        "",
    ]


def _base(stages: Sequence[Stage]) -> float:
    """Bytes of a service without axes, by the line through the stages; 0 where there are not two."""
    if len(stages) < 2:
        return stages[0].rss if stages else 0.0
    return max(float(np.polyfit([s.axes for s in stages], [s.rss for s in stages], 1)[1]), 0.0)
