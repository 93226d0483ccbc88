"""Normal equations of all balances over a window of frames, and the reference learnt from older ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import COLUMNS, FRAME_BINS, FRAME_S, STOP_S, TAIL_BINS
from fdd.residuals.compiled import Array, Indices
from fdd.residuals.effects import Effects, LogConditions, viscous_change, with_logs
from fdd.residuals.epochs import Epochs
from fdd.residuals.normal_equations import RECENT_FRAMES, NormalEquations, RegressionAccumulator, marginalised
from fdd.residuals.quantities import Quantities, Scales, settled
from fdd.restorable import Restorable
from fdd.unit import Unit

HISTORY = 7200
"""Frames whose misfit is remembered: an hour."""
LEAST_INFORMATION = 1e-3
"""Least information of a frame on all coefficients together, over that of their prior."""
HEAT_K = 10.0
"""K, unit of `LogConditions.heat`."""
SURROUNDINGS, DUTY = 5, 2
"""Numbers in `BalanceHistory.surroundings` of a frame, and those of them, the last, that are its duty."""
MOST_FRAMES = 20
"""Frames that are computed at a time: their columns still fit the processor's cache."""


class BalanceHistory(Restorable):
    """All balances of an axis: a window of frames, the reference before it, and the epochs of its life.
    `effects` has this unit's by balance."""

    STATE = (
        "regressions", "tail", "frames", "equations", "surroundings", "reference", "epochs", "last",
        "folded", "taken", "_misfits", "_accumulator",
    )  # fmt: skip
    STATE_CLASSES = (NormalEquations, Effects)

    def __init__(self, unit: Unit, effects: dict[str, Effects]) -> None:
        self.unit = unit
        self.scales = Scales.of(unit)
        self.effects = effects
        self.regressions = {name: RegressionAccumulator(b, effects[name]) for name, b in BALANCES.items()}
        self.tail = np.full((TAIL_BINS, len(COLUMNS)), np.nan)
        self.frames: list[int] = []
        self.equations: dict[str, list[NormalEquations]] = {name: [] for name in BALANCES}
        self._marginal: dict[str, list[tuple[Array, Array]]] = {name: [] for name in BALANCES}
        self.surroundings: list[list[float]] = []
        """Of each frame kept, the last three of `LogConditions`, and its duty: mean drop over relief
        pressure, mean size of the pump's speed over the drive's largest."""
        self.reference = effects
        """Prior of the coefficients at the first frame kept: the unit's baseline, updated by older frames."""
        self.epochs = Epochs()
        self.last = -1
        """The frame taken last."""
        self.folded = self.taken = 0
        """Frames learnt into the reference since the axis last started, and all frames that ever came."""
        self._misfits: list[list[float]] = []
        self._accumulator = np.nan
        """Its pressure as last known, Pa."""

    def sums(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """Information (h, n, n), vector (h, n), rows (h,) and variance (h,) of each balance."""
        out = {}
        for name, balance in BALANCES.items():
            m, v, rows, variance = (np.array([e[i] for e in self._settled(name)]) for i in range(4))
            n = len(balance.columns)
            out[name] = m.reshape(-1, n, n), v.reshape(-1, n), rows, variance
        return out

    def marginalised(self) -> dict[str, tuple[Array, Array]]:
        """Information (h, n, n) and vector (h, n) of each informative balance, the wander marginalised."""
        out = {}
        for name in BALANCES:
            wide = self._marginalised(name)
            if any(e.rows for e in self.equations[name]):
                out[name] = np.array([m for m, _ in wide]), np.array([v for _, v in wide])
        return out

    def conditions(self, name: str) -> LogConditions | None:
        """Mean conditions of the frames in which a balance has information; None without any."""
        seen = [k for k, frame in enumerate(self.equations[name]) if frame.rows]
        if not seen:
            return None
        around = np.mean([self.surroundings[k][:-DUTY] for k in seen], axis=0).tolist()
        rows = float(np.mean([self.equations[name][k].variance for k in seen]))
        return LogConditions(1.0, rows, *around)

    @property
    def duty(self) -> Array:
        """Load and speed (h, 2) of the frames kept, see `duty_profiles`."""
        return np.array(self.surroundings).reshape(-1, SURROUNDINGS)[:, -DUTY:]

    def held_against(self) -> dict[str, Effects]:
        """Prior of the frames kept: the reference once older frames were learnt, else `expected`."""
        return self.reference if self.folded else self.expected()

    def expected(self) -> dict[str, Effects]:
        """The unit's effects with the log-to-log variance under the conditions of the frames kept."""
        return {
            name: with_logs(e, c, viscous_change(name, e.mean)) if (c := self.conditions(name)) else e
            for name, e in self.effects.items()
        }

    def _marginalised(self, name: str) -> list[tuple[Array, Array]]:
        """Information and vector of every frame, the wander marginalised; worked out once."""
        wide = self._marginal[name]
        fresh = self._settled(name)[len(wide) :]
        if fresh:
            information, vector = np.array([e[0] for e in fresh]), np.array([e[1] for e in fresh])
            wide.extend(zip(*marginalised(information, vector, self.reference[name].wander), strict=True))
        return wide

    def push(self, first: int, bins: Array) -> None:
        """Take bins of complete frames (see `BinMaker.push`); the result does not depend on their cut."""
        if first != self.last + 1:
            self.tail = np.full_like(self.tail, np.nan)
        for start in range(0, len(bins), MOST_FRAMES * FRAME_BINS):
            here = np.concatenate([self.tail, bins[start : start + MOST_FRAMES * FRAME_BINS]])
            self._take(first + start // FRAME_BINS, here)
            self.tail = here[-TAIL_BINS:]

    def _take(self, first: int, bins: Array) -> None:
        """Frames from an index on: bins with `TAIL_BINS` before them."""
        q = Quantities(bins, self.unit, self.scales, self._accumulator)
        self._accumulator = q.accumulator_before
        count = (len(bins) - TAIL_BINS) // FRAME_BINS
        self.frames += range(first, first + count)
        off = q.take["temperature"] - self.unit.oil.reference_temperature
        heat = np.nan_to_num(np.square(off / HEAT_K))
        duty = q.drop_measured / self.scales.pressure, np.abs(q.speed) / self.scales.speed
        each = np.column_stack([~q.chambers_measured, heat, np.isnan(off), *map(np.nan_to_num, duty)])
        each = each[TAIL_BINS:]
        self.surroundings += each.reshape(count, FRAME_BINS, SURROUNDINGS).mean(axis=1).tolist()
        self.last = self.frames[-1]
        self.taken += count
        misfits = np.full((count, len(BALANCES)), np.nan)
        for b, (name, balance) in enumerate(BALANCES.items()):
            blocks = []
            for s in balance.blocks(q):
                good = s.valid & np.isfinite(s.y) & np.isfinite(s.x).all(axis=1)
                blocks.append(s._replace(valid=settled(good, balance.settle)))
            early = self._early(name)
            equations = self.regressions[name].equations(blocks)
            self.equations[name] += equations
            if early:
                self._marginal[name] = []
                if not self._early(name):
                    self.equations[name] = self._shared(name)
            misfits[:, b] = self._misfit(name, equations)
        self._misfits = [*self._misfits, *misfits.tolist()][-HISTORY:]

    def _early(self, name: str) -> bool:
        """Whether the noise of a balance rests on fewer frames than `RECENT_FRAMES`."""
        return BALANCES[name].bins_per_row > 1 and self.regressions[name].seen < RECENT_FRAMES

    def _settled(self, name: str) -> list[NormalEquations]:
        return self._shared(name) if self._early(name) else self.equations[name]

    def _shared(self, name: str) -> list[NormalEquations]:
        """The log's first frames reweighted by the noise of the first ten seconds together."""
        equations = list(self.equations[name])
        first = [k for k, frame in enumerate(equations) if frame.rows][:RECENT_FRAMES]
        for k in first[:-1]:
            information, vector, rows, own = equations[k]
            variance = equations[first[-1]].variance
            share = own / variance
            equations[k] = NormalEquations(share * information, share * vector, rows, variance)
        return equations

    def _misfit(self, name: str, equations: list[NormalEquations]) -> Array:
        """Root of the frames' reduced chi-square about the unit's baseline, (h,), over that of its own
        healthy stretches: about 1 while healthy; NaN without information."""
        e = self.effects[name]
        spread = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
        information, vector, rows = (np.array([x[i] for x in equations]) for i in range(3))
        wide, kept = marginalised(information, vector, spread)
        chi_square = np.sum(np.square(spread * (kept - wide @ e.mean)), axis=1)
        expected = np.einsum("i,hii->h", spread**2, wide)
        healthy, seen = (float(np.diag(m) @ spread**2) for m in (e.information, e.scatter))
        expected *= seen / healthy if healthy > 0.0 else 1.0
        informative = (rows > 0.0) & (expected > LEAST_INFORMATION)
        return np.where(informative, np.sqrt(chi_square / np.where(informative, expected, 1.0)), np.nan)

    def misfits(self) -> tuple[Array, list[str], Array]:
        """Ends of the last frames (m,), balances' names and how badly each closed (m, balances)."""
        seen = np.array(self._misfits).reshape(-1, len(BALANCES))
        last = self.frames[-1] if len(seen) else 0
        ends = (last - np.arange(len(seen))[::-1] + 1) * FRAME_S
        used = np.isfinite(seen).any(axis=0)
        names = [n for n, u in zip(BALANCES, used, strict=True) if u]
        return np.asarray(ends, dtype=np.float64), names, np.asarray(np.nan_to_num(seen[:, used]))

    def fold(self, window: int, fault_intervals: Sequence[tuple[float, float]] = ()) -> int:
        """Learn frames beyond a window into the reference, a fifth of the window at a time; returns how many
        were learnt in all.

        A reference made of older frames is what the unit was like then; its covariance grows by
        the changes within a healthy log. What came while a fault was active is no reference: of that the
        latest frames are kept, and some from before its onset for comparison. `fault_intervals` (s) are
        onset and end of faults; inf for active ones.
        """
        part = window // 5
        while len(self.frames) > window + part:
            at = FRAME_S * np.array(self.frames)
            faulty, before = np.zeros((2, at.size), dtype=np.bool_)
            for onset, end in fault_intervals:
                faulty |= (onset <= at) & (at < end)
                before |= np.isinf(end) & (onset - part * FRAME_S <= at) & (at < onset)
            healthy = np.flatnonzero(~before & ~faulty)[:part]
            if healthy.size and not faulty[: healthy[0]].any():
                self._learn(healthy)
                self.folded += healthy.size
            else:
                healthy = np.flatnonzero(~before)[:part]
            self._retire(healthy if healthy.size else np.arange(part))
        return self.folded

    def stopped(self, first: int) -> bool:
        """Whether the pause before this frame was so long (`STOP_S`) that another log begins."""
        return self.last >= 0 and (first - self.last) * FRAME_S > STOP_S

    def begin_anew(self, fault_intervals: Sequence[tuple[float, float]], together: int) -> None:
        """After a stop start from the unit's baseline again, as at the start of a log.

        The log before the stop says no more than other logs of the unit. With an active fault
        (`fault_intervals` as for `fold`), or without a baseline, the reference stays. The next frame is the
        first of `together` that are looked at together.
        """
        self.taken += -self.taken % together
        if any(np.isinf(end) for _, end in fault_intervals):
            self.epochs.stop()
            return
        at = FRAME_S * np.array(self.frames)
        healthy = np.ones(at.size, dtype=np.bool_)
        for onset, end in fault_intervals:
            healthy &= (at < onset) | (end <= at)
        self._learn(np.flatnonzero(healthy))
        self._retire(np.arange(at.size))
        self.epochs.stop()
        if self.unit.baseline is not None:
            self.reference, self.folded = self.effects, 0

    def _learn(self, places: Indices) -> None:
        """Update the reference by frames (Bayesian update of mean and covariance)."""
        reference = {}
        for name, e in self.held_against().items():
            wide = self._marginalised(name)
            prior = np.linalg.inv(e.covariance)
            covariance = np.linalg.inv(prior + sum(wide[k][0] for k in places))
            mean = covariance @ (prior @ e.mean + sum(wide[k][1] for k in places))
            covariance = 0.5 * (covariance + covariance.T) + np.diag(np.square(e.within))
            reference[name] = replace(e, mean=mean, covariance=covariance)
        self.reference = reference

    def _retire(self, places: Indices) -> None:
        """Move frames from the window to the epochs, with or without an active fault."""
        if places.size:
            wide = {name: [self._marginalised(name)[k] for k in places] for name in BALANCES}
            sums = {name: (sum(m for m, _ in w), sum(v for _, v in w)) for name, w in wide.items()}
            self.epochs.add([self.frames[k] for k in places.tolist()], sums)
        self._drop(places)

    def forget(self, start: float, end: float) -> None:
        """Leave out the frames of a stretch of time, s."""
        at = FRAME_S * np.array(self.frames)
        self._drop(np.flatnonzero((start <= at) & (at < end)))

    def _drop(self, places: Indices) -> None:
        kept = np.delete(np.arange(len(self.frames)), places).tolist()
        for name in BALANCES:
            wide = self._marginalised(name)
            self.equations[name] = [self.equations[name][k] for k in kept]
            self._marginal[name] = [wide[k] for k in kept]
        self.frames = [self.frames[k] for k in kept]
        self.surroundings = [self.surroundings[k] for k in kept]

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Restorable`; what is worked out once is worked out again."""
        super().restore(state)
        self._marginal = {name: [] for name in BALANCES}
