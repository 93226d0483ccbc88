"""One axis under watch: its blocks in order, its pipeline, the baseline that it learns, its state."""

from __future__ import annotations

import hashlib
import logging
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fdd.diagnosis.baseline import baseline_of
from fdd.diagnosis.findings import Estimate, FaultFinding
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.log_scales import STREAM_S, StreamScales
from fdd.logs.quality import check_magnitudes
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S, BinMaker
from fdd.residuals.effects import first_effects
from fdd.restorable import Restorable, packed, unpacked
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.order import Order
from fdd.service.queues import Bus, Event
from fdd.service.status import FRESH_S, HEALTHY_LEAKAGE, LEAKAGE_FACTOR, LOOK_S, Recent
from fdd.service.store import Checkpoint, Rollup
from fdd.unit import Unit

LOG = logging.getLogger("fdd.service")
VERSION = "4"
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
MOVES = 0.2
"""Share of frames whose oil tells anything, below which an axis has hardly worked yet."""


@dataclass(frozen=True)
class Look:
    """What one look at the evidence gave at a time, s of the stream's clock: findings that began with it, and
    all that stand."""

    time: float
    fresh: list[FaultFinding]
    standing: list[FaultFinding]


class Learning(Restorable):
    """Gather the balances of a unit without baseline, until it has worked for so many seconds; its state is
    in `bins` and `history`.
    """

    STATE = ("bins", "history")

    def __init__(self, unit: Unit, seconds: float) -> None:
        self.unit, self.seconds = unit, seconds
        self.forget()

    def forget(self) -> None:
        """Something is wrong with it: what came so far is no baseline."""
        effects = {name: first_effects(name, unit=self.unit) for name in BALANCES}
        self.bins, self.history = BinMaker(self.unit), BalanceHistory(self.unit, effects)

    def push(self, samples: Samples) -> None:
        """Take samples of a unit that nothing is known to be wrong with."""
        for first, bins in self.bins.stretches(samples):
            self.history.push(first, bins)

    def learnt(self) -> Unit | None:
        """The profile with its baseline, once it has worked for long enough."""
        worked = FRAME_S * sum(frame.rows > 0.0 for frame in self.history.equations["volume"])
        if worked < MOVES * self.seconds or FRAME_S * len(self.history.frames) < self.seconds:
            return None
        out = self.unit.model_copy(deep=True)
        out.baseline = baseline_of([self.history])
        return out


class AxisWatch(Restorable):
    """Watch one axis, and tell the bus its samples in the order of time; `hold` (s) is that of `Order`. A
    profile without baseline gets one of `learn_s` (s) of work without a finding.

    Attributes
    ----------
    failed : why it is not watched now; what comes is checked, and once it is sound the axis begins anew.
    rollups : parts of minutes that are not stored yet.
    flushed, kept : for the fleet: whether it fell silent and gave what waits; monotonic s of its checkpoint.
    """

    STATE = ("samples", "rate_hz", "failed", "last_wall", "order", "pipeline", "learning")

    def __init__(
        self, name: str, unit: Unit, model: Model, hold: float = 0.5, learn_s: float = 3600.0,
        bus: Bus | None = None,
    ) -> None:  # fmt: skip
        self.name, self.model, self._bus, self._learn_s = name, model, bus or Bus(), learn_s
        self.order, self.recent = Order(hold), Recent()
        self.failed: str | None = None
        self.rollups: list[Rollup] = []
        self.samples, self.flushed, self.kept = 0, False, -np.inf
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
        self._shas = {"profile_sha256": self.profile_sha256, "model_sha256": model.sha256}
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
        self._waiting += blocks
        self.last_wall = self._waiting[-1].received
        # A frame is over with the first row of the next one: a look need not wait for more. Another frame,
        # not a later one: the sender's clock may have been set.
        stamp = self._waiting[-1].samples.time[-1] + np.nan_to_num(self.order.clock.offset)
        frame, self._frame = self._frame, stamp // FRAME_S
        if frame == self._frame and len(self._waiting) < MOST_TOGETHER:
            return []
        return self.settle(self.last_wall)

    def settle(self, wall: float, flush: bool = False) -> list[Look]:
        """Work what waits for more (Unix seconds); with `flush` what is held for a block before it too."""
        blocks, self._waiting = self._waiting, []
        samples = self.order.take(blocks)  # some at a time cost little more than one
        if flush:
            samples = Samples.concatenate([samples, self.order.flush()])
        if not len(samples):
            return []
        self.samples += len(samples)
        measured = {"samples": samples, "unit": self.unit}
        self._bus.publish(Event("samples", self.name, float(samples.time[-1]), measured))
        if len(samples) > 1:
            self.rate_hz = float((len(samples) - 1) / samples.duration)
        looks, last = list[Look](), float(samples.time[-1])
        try:
            samples = self._checked(samples)
            if self.failed is None and len(samples):
                # No longer than a look each, so that what a look finds is told at its own time.
                edges = np.arange(samples.time[0] + LOOK_S, samples.time[-1], LOOK_S)
                for a, b in pairwise([0, *samples.time.searchsorted(edges).tolist(), len(samples)]):
                    if b > a:
                        looks += self._worked(samples.rows(a, b), wall)
        except InputError as error:
            looks.append(self._failed(str(error), last))
        except Exception as error:  # a fault of fdd: the other axes go on
            LOG.exception("axis %s", self.name)
            looks.append(self._failed(f"internal error: {type(error).__name__}: {error}", last))
            self._rests_until = last + REST_S
        return looks

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

    def _checked(self, samples: Samples) -> Samples:
        """What may be worked now: samples wait until some seconds show that no channel is in a wrong unit of
        measure, which is raised. After a failure the axis begins anew with them."""
        if samples.time[0] < self._rests_until:
            return samples.rows(0, 0)
        if self._unchecked is not None:
            self._unchecked.append(samples)
            if samples.time[-1] - self._unchecked[0].time[0] < CHECKED_S:
                return samples.rows(0, 0)
            samples = Samples.concatenate(self._unchecked)
            check_magnitudes(samples.columns)
            self._unchecked = None
        if self.learning is None:  # a unit that is still learnt has no scales of its own
            try:
                for note in self._scales.push(samples):
                    LOG.warning("axis %s: %s", self.name, note)
            except InputError:
                self._wrong_scales = True
                raise
        if self.failed is not None and (self._scales.done or not self._wrong_scales):
            LOG.info("axis %s begins anew, it had failed: %s", self.name, self.failed)
            self.failed, self._wrong_scales = None, False
            self._take_over(self.unit)
        return samples

    def _failed(self, why: str, time: float) -> Look:
        """Stop at a time, s; the look that ends what stood."""
        if self.failed != why:
            LOG.warning("axis %s: %s", self.name, why)
        self.failed, self._unchecked, self.standing = why, [], []
        self._scales = self._fresh_scales()
        return Look(time, [], [])

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
        self.recent.looks.append((time, self.estimates, misfits, self.probabilities))
        self._roll_up(wall)
        yield Look(time, fresh, self.standing)
        if self.learning is not None:
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

    def about(self) -> dict[str, str]:
        """What the store keeps of it beside its state."""
        return {"unit": self.unit.name, **self._shas}

    def checkpoint(self, wall: float, sequence: int = 0) -> Checkpoint:
        """All that it takes to go on (wall: Unix seconds); while nothing `waits`."""
        arrays = self.state() | {"axis": packed([self._learnt, self._unchecked is None])}
        time = float(np.nan_to_num(self.order.clock.last_time))
        return Checkpoint(self.name, time, wall, sequence, **self._shas, version=VERSION, arrays=arrays)

    def go_on(self, kept: Checkpoint) -> None:
        """Go on from a checkpoint. Raises InputError: of another profile, model or version."""
        where, mend = f"axis {self.name}", "it starts anew"
        theirs = {"profile_sha256": kept.profile_sha256, "model_sha256": kept.model_sha256}
        if theirs != self._shas or kept.version != VERSION:
            problem = "its saved state is of another profile, model or version of fdd"
            raise InputError(problem, where=where, mend=mend)
        try:
            self._learnt, checked = unpacked(kept.arrays["axis"])
            if self._learnt is not None:
                self._take_over(Unit.from_yaml(self._learnt, where=where))
            self.restore(kept.arrays)
        except (ValueError, KeyError, TypeError) as error:
            problem = f"its saved state is damaged ({type(error).__name__})"
            raise InputError(problem, where=where, mend=mend) from None
        # Looks fall due at the same rows as without the restart.
        self._frame = self.order.clock.last_time // FRAME_S
        self._unchecked = None if checked else []
        self.standing = [] if self.failed else self.pipeline.standing
        self.probabilities, self.estimates, _ = self.pipeline.now()
