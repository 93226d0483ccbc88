"""One axis under watch: its blocks in order, its pipeline, and what it looked like lately."""

from __future__ import annotations

import hashlib
import json
import logging
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.findings import Estimate, FaultFinding
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.log_scales import STREAM_S, StreamScales
from fdd.logs.quality import check_magnitudes
from fdd.residuals.bins import FRAME_S
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.life import HEALTHY_LEAKAGE, LEAKAGE_FACTOR
from fdd.service.order import Order
from fdd.service.profiles import Learning
from fdd.service.recent import FRESH_S, LOOK_S, Recent
from fdd.service.store import Checkpoint, Rollup, joined, parted
from fdd.unit import Unit

Array = NDArray[np.float64]

LOG = logging.getLogger("fdd.service")
VERSION = "3"
"""Of a checkpoint's form."""
MOST_TOGETHER = 64
"""Blocks of a frame that are worked together, however short."""
CHECKED_S = 5.0
"""s of data by which the units of measure are checked: once, and again after they were wrong."""
SCALES_TURNS = 64
"""Times at which axes that began together are held against their profiles, over as long as that takes."""
CLOCK_GAP_S = 2.0
"""s by which the clock times of a stream from any start may be off before they are corrected."""
REST_S = 60.0
"""s of data after a fault of fdd itself, before the axis is tried again."""


@dataclass(frozen=True)
class Look:
    """What one look at the evidence gave.

    Attributes
    ----------
    time : s of the stream's clock. fresh : findings that began with it. standing : all that stand.
    """

    time: float
    fresh: list[FaultFinding]
    standing: list[FaultFinding]


class AxisWatch:
    """Watch one axis.

    Parameters
    ----------
    unit : profile. One without a baseline is learnt while nothing is found. hold : s, see `Order`.
    learn_s : s of work after which a baseline is learnt. measured : takes its samples in the order of time.

    Attributes
    ----------
    failed : why it is not watched now; what comes is checked, and once it is sound the axis begins anew.
    rollups : parts of minutes that are not stored yet.
    """

    def __init__(
        self, name: str, unit: Unit, model: Model, hold: float = 0.5, learn_s: float = 3600.0,
        measured: Callable[[Samples], None] = lambda samples: None,
    ) -> None:  # fmt: skip
        self.name, self.model, self._measured, self._learn_s = name, model, measured, learn_s
        self.order = Order(hold)
        self.recent = Recent()
        self.failed: str | None = None
        self.rollups: list[Rollup] = []
        self.samples = 0
        self.rate_hz: float | None = None
        self.last_wall: float | None = None
        self.estimates: dict[str, Estimate] = {}
        self.probabilities: dict[str, float] = {}
        self.standing: list[FaultFinding] = []
        self._unchecked: list[Samples] | None = []
        self._wrong_scales = False
        self._rests_until = self._start_wall = -np.inf
        self._waiting: list[Block] = []
        self._frame: float | None = None
        self._learnt: str | None = None
        self.profile_sha256 = hashlib.sha256(unit.model_dump_json().encode()).hexdigest()
        self._take_over(unit)

    def _take_over(self, unit: Unit) -> None:
        self.unit = unit
        self.learning = Learning(unit, self._learn_s) if unit.baseline is None else None
        self.pipeline = Pipeline(unit, self.model, axis=self.name, keep_trajectories=False)
        self._scales = self._fresh_scales()

    def _fresh_scales(self) -> StreamScales:
        """It takes a fifth of a second of work: axes that began together do not do it together."""
        turn = zlib.crc32(self.name.encode()) % SCALES_TURNS / SCALES_TURNS
        return StreamScales(self.unit, f"axis {self.name}", STREAM_S * (1.0 + turn))

    def push(self, *blocks: Block) -> list[Look]:
        """Take blocks that came together; what the looks that fell due gave."""
        self._waiting += [block for block in blocks if len(block.samples)]
        if not self._waiting:
            return []
        self.last_wall = self._waiting[-1].received
        # A frame is over with the first row of the next one: a look need not wait for more. Another frame,
        # not a later one: the sender's clock may have been set.
        stamp = self._waiting[-1].samples.time[-1] + np.nan_to_num(self.order.clock.offset)
        frame, self._frame = self._frame, stamp // FRAME_S
        if frame == self._frame and len(self._waiting) < MOST_TOGETHER:
            return []
        return self._taken(self._in_order(), self.last_wall)

    def flush(self, wall: float) -> list[Look]:
        """Take what waits now, for blocks before it or for more (Unix seconds)."""
        return self._taken(Samples.concatenate([self._in_order(), self.order.flush()]), wall)

    def settle(self, wall: float) -> list[Look]:
        """Take what waits for more (Unix seconds); what is held for a block before it stays held."""
        return self._taken(self._in_order(), wall)

    @property
    def waits(self) -> bool:
        """Whether blocks are in no state yet."""
        return bool(self._waiting)

    @property
    def is_new(self) -> bool:
        """Whether so little has come that not even its units of measure are known."""
        return self._unchecked is not None and self.failed is None

    def wall_of(self, time: float) -> float | None:
        """Unix seconds of a time (s) of the stream's clock: by the sender's stamps, or by when they came."""
        last, offset = self.order.clock.last_time, self.order.clock.offset
        if self.last_wall is None or not np.isfinite(last + offset):
            return None
        if abs(self.last_wall - (last - offset)) < FRESH_S:
            return float(time - offset)
        # Blocks come sooner or later: what was told must not change with each.
        if abs(self.last_wall - last - self._start_wall) > CLOCK_GAP_S:
            self._start_wall = self.last_wall - last
        return self._start_wall + time

    def _in_order(self) -> Samples:
        """The blocks that waited: some at a time cost little more than one."""
        blocks, self._waiting = self._waiting, []
        return self.order.take(blocks)

    def _taken(self, samples: Samples, wall: float) -> list[Look]:
        """The looks of samples that go on from the last ones."""
        if not len(samples):
            return []
        self.samples += len(samples)
        self._measured(samples)
        if len(samples) > 1:
            self.rate_hz = float((len(samples) - 1) / samples.duration)
        looks: list[Look] = []
        try:
            self._check(samples)
            if self.failed is None:
                for part in _parts(samples):
                    looks += self._worked(part, wall)
        except InputError as error:
            self._fail(str(error))
        except Exception as error:  # a fault of fdd: the other axes go on
            LOG.exception("axis %s", self.name)
            self._fail(f"internal error: {type(error).__name__}: {error}")
            self._rests_until = float(samples.time[-1]) + REST_S
        return looks

    def _check(self, samples: Samples) -> None:
        """Refuse channels in a wrong unit of measure, by some seconds; after a failure begin anew."""
        if samples.time[0] < self._rests_until:
            return
        if self._unchecked is not None:
            self._unchecked.append(samples)
            if samples.time[-1] - self._unchecked[0].time[0] < CHECKED_S:
                return
            check_magnitudes(Samples.concatenate(self._unchecked).columns)
            self._unchecked = None
        self._hold_scales(samples)
        if self.failed is not None and (self._scales.done or not self._wrong_scales):
            LOG.info("axis %s begins anew, it had failed: %s", self.name, self.failed)
            self.failed, self._wrong_scales = None, False
            self._take_over(self.unit)

    def _hold_scales(self, samples: Samples) -> None:
        """Hold them against the profile; a unit that is still learnt has none of its own."""
        if self.learning is not None:
            return
        try:
            for note in self._scales.push(samples):
                LOG.warning("axis %s: %s", self.name, note)
        except InputError:
            self._wrong_scales = True
            raise

    def _fail(self, why: str) -> None:
        if self.failed != why:
            LOG.warning("axis %s: %s", self.name, why)
        self.failed, self._unchecked, self.standing = why, [], []
        self._scales = self._fresh_scales()

    def _worked(self, samples: Samples, wall: float) -> Iterator[Look]:
        before = self.pipeline.looked_at
        fresh = self.pipeline.push(samples)
        self.recent.add(samples)
        if self.learning is not None:
            self.learning.push(samples)
        looked = self.pipeline.looked_at > before
        if not fresh and not looked:
            return
        # The same however the stream was cut into blocks.
        time = self.pipeline.looked_at if looked else max(f.detected_s for f in fresh)
        self.standing = self.pipeline.standing
        self.probabilities, self.estimates, misfits = self.pipeline.now()
        self.recent.look(time, self.estimates, misfits, self.probabilities)
        self._roll_up(wall)
        yield Look(time, fresh, self.standing)
        self._learn()

    def _learn(self) -> None:
        if self.learning is None:
            return
        if self.standing:
            self.learning.forget()
        elif (unit := self.learning.learnt()) is not None:
            self._learnt = unit.to_yaml()
            self._take_over(unit)

    def _roll_up(self, wall: float) -> None:
        values = {n: (e.value, e.std) for n, e in self.estimates.items() if e.observable}
        e = self.estimates.get("leakage")
        if e is not None and e.observable and e.value is not None and e.baseline:
            values[HEALTHY_LEAKAGE] = (e.baseline, None)
            values[LEAKAGE_FACTOR] = (e.value / e.baseline, (e.std or 0.0) / e.baseline)
        values["probability_of_a_fault"] = (1.0 - self.probabilities.get("healthy", 1.0), None)
        for name, (value, std) in values.items():
            if value is not None:
                self.rollups.append(Rollup(self.name, name, wall, 1, value, std or 0.0, value, value))

    def quality(self) -> dict[str, int]:
        """Counts since the axis began."""
        gaps, counts = self.order.gaps, self.order.counts
        names = ("late", "repeated", "reordered", "missing_blocks")
        return {"dropped": gaps.dropped, "gaps": gaps.jumps} | {name: counts[name] for name in names}

    def checkpoint(self, wall: float, sequence: int = 0) -> Checkpoint:
        """All that it takes to go on (wall: Unix seconds); while nothing `waits`."""
        scalars = {
            "version": VERSION, "samples": self.samples, "rate_hz": self.rate_hz, "failed": self.failed,
            "last_wall": self.last_wall, "learnt": self._learnt, "checked": self._unchecked is None,
        }  # fmt: skip
        arrays: dict[str, NDArray[Any]] = {
            "axis": np.frombuffer(json.dumps(scalars).encode(), dtype=np.uint8)
        }
        parts = {"order": self.order.state(), "pipeline": self.pipeline.state()}
        if self.learning is not None:
            parts["learning"] = self.learning.state()
        for prefix, state in parts.items():
            arrays |= {f"{prefix}|{k}": v for k, v in state.items()}
        time = float(self.order.clock.last_time)
        return Checkpoint(
            axis=self.name, time=time if np.isfinite(time) else 0.0, wall=wall, sequence=sequence,
            profile_sha256=self.profile_sha256, model_sha256=self.model.sha256, version=VERSION,
            body=joined(arrays),
        )  # fmt: skip

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint. Raises InputError: of another profile, model or version."""
        ours = (self.profile_sha256, self.model.sha256, VERSION)
        if (checkpoint.profile_sha256, checkpoint.model_sha256, checkpoint.version) != ours:
            raise InputError(
                "its saved state is of another profile, model or version of fdd",
                where=f"axis {self.name}", mend="it starts anew",
            )  # fmt: skip
        try:
            arrays = parted(checkpoint.body)
            scalars = json.loads(bytes(arrays["axis"]))
            self._learnt = scalars["learnt"]
            if self._learnt is not None:
                self._take_over(Unit.from_yaml(self._learnt, where=f"axis {self.name}"))
            self.order.restore(_below(arrays, "order"))
            self.pipeline.restore(_below(arrays, "pipeline"))
            if self.learning is not None:
                self.learning.restore(_below(arrays, "learning"))
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"its saved state is damaged ({type(error).__name__})",
                where=f"axis {self.name}", mend="it starts anew",
            ) from None  # fmt: skip
        self.samples, self.rate_hz, self.failed = (scalars[k] for k in ("samples", "rate_hz", "failed"))
        self.last_wall = scalars["last_wall"]
        self._unchecked = None if scalars.get("checked", self.failed is None) else []
        self.standing = [] if self.failed else self.pipeline.standing
        self.probabilities, self.estimates, _ = self.pipeline.now()


def _parts(samples: Samples) -> Iterator[Samples]:
    """No longer than a look each, so that what a look finds is told at its own time."""
    edges = np.arange(samples.time[0] + LOOK_S, samples.time[-1], LOOK_S)
    places = [0, *np.searchsorted(samples.time, edges).tolist(), len(samples)]
    for a, b in pairwise(places):
        if b > a:
            yield samples.rows(a, b)


def _below(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    return {k.removeprefix(f"{prefix}|"): v for k, v in arrays.items() if k.startswith(f"{prefix}|")}
