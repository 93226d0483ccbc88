"""What is known of the sensors so far: findings, and what is remembered of each channel from frame to frame.

A finding says the kind of failure, its time, its size and the reason. Memory is plain arrays, saved as such.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from estimators.compiled import compiler
from fdd.restorable import Restorable
from fdd.sensors.limits import NAMES, Array

njit = compiler(Path(__file__).parent)
"""What it compiles is kept on disk, and made anew when a source beside it changes."""

Kind = Literal[
    "dead", "stuck", "saturated", "out_of_range", "spikes", "step", "slip", "supply_loss", "noisy",
    "dropout", "clipped",
]  # fmt: skip
FAILING = ("dead", "stuck", "saturated", "out_of_range", "step", "supply_loss", "noisy", "dropout")
"""Kinds that take the channel out of what follows while they last; the others leave it usable."""
CONFIDENCE: dict[str, float] = {
    "dead": 0.99, "stuck": 0.97, "saturated": 0.99, "out_of_range": 0.97, "spikes": 0.98, "step": 0.95,
    "slip": 0.98, "supply_loss": 0.99, "noisy": 0.9, "dropout": 0.99, "clipped": 0.99,
}  # fmt: skip
"""How sure a finding of a kind is: not calibrated. Chance plays no part (see the thresholds); what is left is
that the profile is wrong."""
SAME_INSTANT_S = 0.05
COUNT = len(NAMES)
CELL_HISTORY = 250
"""Cells of 20 ms: the noise of the last five seconds."""
STILL, MOVING = 0, 1
"""Classes of frames, in which noise and repeats are compared: the pump turned less than once, or more."""
SHAPES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("frames", "repeat", "noisiest", "quietest"), (2, COUNT)),
    "volume": (5,), "stood": (4,), "stamps": (2,), "cells": (COUNT, CELL_HISTORY), "derived": (1,),
}  # fmt: skip
"""Of what is not (12,)."""
UNKNOWN = (
    "run_value", "run_since", "loud_since", "faint_since", "absent_since", "absent_first", "failed_since",
    "last_value", "good_value", "good_time", "doubtful_since", "previous", "stamps", "derived",
)  # fmt: skip
STARTS = {**dict.fromkeys(UNKNOWN, np.nan), "quietest": np.inf, "held_until": -np.inf}
"""What does not start at 0."""


@dataclass(frozen=True)
class SensorFinding:
    """One failure of one channel; events of one kind are one finding, of `count` events.

    `channel`: contract's name; of a lost supply the first of `channels`, all that are concerned. `until_s`:
    when the channel was good again, None while it is not, or where the kind has no end (a slip stays).
    `detected_s`: end of the frame in which it was decided. `confidence`: see `CONFIDENCE`. `size`: SI: metres
    or radians lost by an encoder (sum of magnitudes), pascals of a step, the value of a stuck channel, the
    factor of a noise, seconds lost by a dropout, rows of spikes. `evidence`: one sentence with figures and
    units.
    """

    channel: str
    kind: Kind
    onset_s: float
    until_s: float | None
    detected_s: float
    confidence: float
    size: float
    evidence: str
    count: int = 1
    channels: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether the sensor is sound: a pressure peak went beyond its range for a moment."""
        return self.kind == "clipped"

    @property
    def fault(self) -> str:
        """The catalogue's id."""
        if self.kind in ("slip", "step") and self.channel == "position":
            return "position_sensor_slip"
        if self.kind == "step" and self.channel.startswith("pressure"):
            return "pressure_sensor_bias"
        return "sensor_dropout"


class Memory(NamedTuple):
    """Per channel (12,), or per class of frame and channel (2, 12)."""

    rows: Array  # that came
    present: Array  # rows with a value
    run_value: Array  # that the channel shows
    run_since: Array  # s, since when it shows that
    run_rows: Array  # in how many rows
    changed: Array  # whether it ever changed
    frames: Array  # that were judged good
    repeat: Array  # the largest chance of a repeated value in these
    noisiest: Array  # the largest noise in these
    quietest: Array  # the least noise in these
    loud: Array  # frames in a row with far more noise
    loud_since: Array  # s, begin of the first of these
    faint: Array  # frames in a row with far less noise
    faint_since: Array  # s, begin of the first of these
    absent_since: Array  # s, a gap that is open
    absent_s: Array  # seconds missing lately
    absent_first: Array  # s, when that began
    held_until: Array  # s, until when repeats are taken for a loose contact's
    failed_since: Array  # s, since when it is not to be trusted, NaN if it is
    good: Array  # good frames since
    biased: Array  # sum of steps that a pressure made
    excited: Array  # frames with a turning pump since the channel changed last
    # (5,) m³ that the pump displaced since the position changed last: sum, least, most, what leakage allows;
    # and whether the position stopped in mid-motion.
    volume: Array
    # (4,) the position's last stand that a frame did not hold: since and until when (s), what the pump
    # displaced meanwhile (m³); and since when it stands now.
    stood: Array
    last_value: Array  # what the channel showed before `run_value`
    good_value: Array  # this and the next four are for the masks of rows
    good_time: Array
    doubtful_since: Array
    previous: Array
    stamps: Array
    cells: Array  # the last excesses of cells, newest last
    cell_count: Array  # how many there are
    derived: Array  # (1,) whether Δp is p1 - p2 to the last digit: 1, 0, NaN not known

    @classmethod
    def new(cls) -> Memory:
        """Of a log that has not begun."""
        return cls(*(np.full(SHAPES.get(n, (COUNT,)), STARTS.get(n, 0.0)) for n in cls._fields))


class SensorFindings(Restorable):
    """Findings so far, by channel and kind, and which channels fail in the frame that is judged now.

    `end`: s, of the frame. `failing`: (12,) channels. `jumps`: begin, end and end of the frame in which it
    was decided (s) of the position's jumps.
    """

    STATE = ("memory", "_found", "jumps")
    STATE_CLASSES = (Memory, SensorFinding)

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self._found: dict[tuple[str, str], SensorFinding] = {}
        self.jumps: list[tuple[float, float, float]] = []
        self.begin_frame(np.nan)

    def begin_frame(self, end: float) -> None:
        """What is reported from now on was decided in the frame until `end` (s)."""
        self.end, self.failing = end, np.zeros(len(NAMES), np.bool_)

    def by_onset(self) -> list[SensorFinding]:
        """In the order of their onsets, the position's jumps taken together.

        An encoder that slips to either side may come back at once, and a loose contact stay off for a while:
        they are of the kind that more of the jumps are of. Of the pump angle both kinds are one fault.
        """
        out = dict(self._found)
        if ("position", "slip") in out and ("position", "spikes") in out:
            rare, often = sorted(("slip", "spikes"), key=lambda kind: out["position", kind].count)
            less, more = out.pop(("position", rare)), out["position", often]
            onset, detected = min(less.onset_s, more.onset_s), min(less.detected_s, more.detected_s)
            count = less.count + more.count
            out["position", often] = replace(more, onset_s=onset, detected_s=detected, count=count)
        return sorted(out.values(), key=lambda f: (f.onset_s, f.channel, f.kind))

    def fail(self, k: int, kind: Kind, onset: float, size: float, evidence: str) -> None:
        """A lasting failure of channel k: reported, and the channel is not trusted from now on."""
        self.failing[k] = True
        if np.isnan(self.memory.failed_since[k]):
            self.memory.failed_since[k] = onset
            slip = self._found.get((NAMES[k], "slip"))
            if slip is not None and slip.count == 1 and abs(slip.onset_s - onset) < SAME_INSTANT_S:
                # Its only slip turned out to be where it failed.
                del self._found[NAMES[k], "slip"]
                self._found[NAMES[k], kind] = replace(slip, kind=kind, size=size, evidence=evidence)
            self.report(k, kind, onset, None, size, evidence, adds=False)

    def report(
        self, k: int, kind: Kind, onset: float, until: float | None, size: float, evidence: str, *,
        adds: bool = True, count: int = 1, channels: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        """Enter an event of channel k; `adds` says whether its size adds to that of the events before."""
        channel = NAMES[k]
        known = self._found.get((channel, kind))
        if known is None:
            self._found[channel, kind] = SensorFinding(
                channel, kind, onset, until, self.end, CONFIDENCE[kind], size, evidence, count,
                channels or (channel,),
            )  # fmt: skip
            return
        again = known.until_s is not None or kind not in FAILING
        self._found[channel, kind] = replace(
            known,
            onset_s=min(known.onset_s, onset),
            until_s=until,
            size=known.size + size if adds else known.size,
            count=known.count + (count if again else 0),
        )

    def close(self, k: int, at: float) -> None:
        """Channel k is good again since `at`."""
        for key, found in self._found.items():
            if NAMES[k] in found.channels and found.kind in FAILING and found.until_s is None:
                lost = at - found.onset_s if found.kind == "dropout" and found.count == 1 else found.size
                self._found[key] = replace(found, until_s=at, size=lost)

    def was_dropout(self, k: int, onset: float, size: float) -> None:
        """What began at `onset` turned out to be a dropout."""
        for key, found in list(self._found.items()):
            if found.channel == NAMES[k] and found.onset_s == onset and found.kind != "dropout":
                del self._found[key]
                self._found[NAMES[k], "dropout"] = replace(found, kind="dropout", size=size)

    def lose_supply(self, channels: list[int], onset: float, evidence: str) -> None:
        """Make one lost supply of what these channels' own findings since `onset` say."""
        names = tuple(NAMES[k] for k in channels)
        for key, found in list(self._found.items()):
            if found.channel in names and found.onset_s >= onset - 0.2 and found.kind != "supply_loss":
                del self._found[key]
        self.report(
            channels[0], "supply_loss", onset, None, float(len(names)), evidence, adds=False, channels=names
        )
