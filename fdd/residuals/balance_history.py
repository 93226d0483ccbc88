"""What each frame tells of each balance's coefficients, and what older ones have made of the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import COLUMNS, FRAME_BINS, FRAME_S, STOP_S, TAIL_BINS
from fdd.residuals.effects import Effects, LogConditions, viscous_change, with_logs
from fdd.residuals.epochs import Epochs
from fdd.residuals.normal_equations import NormalEquations, marginalised
from fdd.residuals.quantities import Quantities, Scales, settled
from fdd.residuals.regression_accumulator import RECENT_FRAMES, RegressionAccumulator
from fdd.unit import Unit

Array = NDArray[np.float64]

HISTORY = 7200
"""Frames whose misfit is remembered: an hour."""
LEAST_INFORMATION = 1e-3
"""Of a coefficient's prior, what a frame must tell of all of them together."""
HEAT_K = 10.0
"""K that `LogConditions.heat` counts in."""
SURROUNDINGS = 3
MOST_FRAMES = 20
"""Frames whose quantities are worked out at a time: their columns still fit the processor's memory."""


class BalanceHistory:
    """All balances of an axis, frame by frame.

    Parameters
    ----------
    unit : profile. effects : balance name to the effects of this unit.
    """

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
        """Of each frame kept, the last three of `LogConditions`."""
        self.reference = effects
        """What the first of the frames kept is held against: the unit's baseline, or what older frames have
        made of it."""
        self.epochs = Epochs()
        self.last = -1
        """The frame taken last."""
        self.folded = self.taken = 0
        """Frames that became the reference since the axis last began to work, and all that ever came."""
        self._misfits: list[list[float]] = []
        self._accumulator = np.nan
        """Its pressure as last known, Pa."""

    def sums(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """Information (h, n, n), vector (h, n), rows (h,) and variance (h,) of each balance."""
        return {name: _stacked(self._settled(name), len(BALANCES[name].columns)) for name in BALANCES}

    def marginalised(self) -> dict[str, tuple[Array, Array]]:
        """Information (h, n, n) and vector (h, n) of each informative balance, the coefficients' wander from
        frame to frame marginalised."""
        out = {}
        for name in BALANCES:
            wide = self._marginalised(name)
            if any(e.rows for e in self.equations[name]):
                out[name] = np.array([m for m, _ in wide]), np.array([v for _, v in wide])
        return out

    def conditions(self, name: str) -> LogConditions | None:
        """Those of the frames kept, as a balance sees them; None where it tells nothing."""
        seen = [k for k, frame in enumerate(self.equations[name]) if frame.rows]
        if not seen:
            return None
        around = np.mean([self.surroundings[k] for k in seen], axis=0).tolist()
        rows = float(np.mean([self.equations[name][k].variance for k in seen]))
        return LogConditions(1.0, rows, *around)

    def held_against(self) -> dict[str, Effects]:
        """What the frames kept are held against: what older ones have made of the unit, or its effects with
        what a log like theirs may differ by."""
        return self.reference if self.folded else self.expected()

    def expected(self) -> dict[str, Effects]:
        """The unit's effects, with what a log like that of the frames kept may differ by."""
        found = {name: self.conditions(name) for name in self.effects}
        return {
            name: with_logs(e, c, viscous_change(name, e.mean)) if (c := found[name]) else e
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
        """Take the bins of complete frames (see `BinMaker.push`); nothing depends on how many at a time."""
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
        each = np.column_stack([~q.chambers_measured, heat, np.isnan(off)])[TAIL_BINS:]
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
        """Whether the noise of a balance is not yet known by as many frames as it is judged by later."""
        return BALANCES[name].bins_per_row > 1 and len(self.regressions[name].recent) < RECENT_FRAMES

    def _settled(self, name: str) -> list[NormalEquations]:
        return self._shared(name) if self._early(name) else self.equations[name]

    def _shared(self, name: str) -> list[NormalEquations]:
        """A log's first frames know little of their noise: what ten seconds show of it holds for them too."""
        equations = list(self.equations[name])
        first = [k for k, frame in enumerate(equations) if frame.rows][:RECENT_FRAMES]
        for k in first[:-1]:
            frame, variance = equations[k], equations[first[-1]].variance
            share = frame.variance / variance
            equations[k] = NormalEquations(
                share * frame.information, share * frame.vector, frame.rows, variance
            )
        return equations

    def _misfit(self, name: str, equations: list[NormalEquations]) -> Array:
        """Root of the frames' reduced chi-square about the unit's baseline, (h,), over that of its own
        healthy stretches: about 1 while healthy; NaN of those that tell nothing."""
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
        ends = np.empty(0)
        if len(seen):
            ends = np.asarray((self.frames[-1] - np.arange(len(seen))[::-1] + 1) * FRAME_S, dtype=np.float64)
        used = np.isfinite(seen).any(axis=0)
        names = [n for n, u in zip(BALANCES, used, strict=True) if u]
        return np.asarray(ends, dtype=np.float64), names, np.asarray(np.nan_to_num(seen[:, used]))

    def fold(self, window: int, fault_intervals: Sequence[tuple[float, float]] = ()) -> int:
        """Let frames beyond a window become the reference, a fifth of it at a time; how many have in all.

        A reference made of older frames is what the unit was like then; it may have moved since by what
        coefficients change within a healthy log. What came while a fault stood is no reference: of that the
        latest frames are kept, and some from before it to hold them against.

        Parameters
        ----------
        fault_intervals : s, when faults began and ended; inf for those that stand.
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
        """Whether an axis that goes on with this frame had stopped: long enough to be like another log."""
        return self.last >= 0 and (first - self.last) * FRAME_S > STOP_S

    def begin_anew(self, fault_intervals: Sequence[tuple[float, float]], together: int) -> None:
        """After a stop hold the axis against its unit's baseline again, as the start of a log.

        What it was like before says no more than other logs of the unit do. Where a fault stands, or nothing
        else is known of the unit, it goes on as it was.

        Parameters
        ----------
        fault_intervals : as for `fold`. together : frames that are looked at together; the next one is the
            first of them.
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

    def _learn(self, places: NDArray[np.int64]) -> None:
        """Take frames into the reference."""
        before = self.held_against()
        for name, e in before.items():
            wide = self._marginalised(name)
            prior = np.linalg.inv(e.covariance)
            covariance = np.linalg.inv(prior + sum(wide[k][0] for k in places))
            mean = covariance @ (prior @ e.mean + sum(wide[k][1] for k in places))
            covariance = 0.5 * (covariance + covariance.T) + np.diag(np.square(e.within))
            self.reference = {**self.reference, name: replace(e, mean=mean, covariance=covariance)}

    def _retire(self, places: NDArray[np.int64]) -> None:
        """Frames that are looked at no longer stay in the sums of the axis's life, whatever stood
        meanwhile."""
        if places.size:
            wide = {name: [self._marginalised(name)[k] for k in places] for name in BALANCES}
            sums = {name: (sum(m for m, _ in w), sum(v for _, v in w)) for name, w in wide.items()}
            self.epochs.add([self.frames[k] for k in places.tolist()], sums)
        self._drop(places)

    def forget(self, start: float, end: float) -> None:
        """Leave out the frames of a stretch of time, s."""
        at = FRAME_S * np.array(self.frames)
        self._drop(np.flatnonzero((start <= at) & (at < end)))

    def _drop(self, places: NDArray[np.int64]) -> None:
        gone = set(places.tolist())
        kept = [k for k in range(len(self.frames)) if k not in gone]
        for name in BALANCES:
            wide = self._marginalised(name)
            self.equations[name] = [self.equations[name][k] for k in kept]
            self._marginal[name] = [wide[k] for k in kept]
        self.frames = [self.frames[k] for k in kept]
        self.surroundings = [self.surroundings[k] for k in kept]

    def state(self) -> dict[str, Array]:
        """Everything as flat named arrays."""
        out: dict[str, Array] = {
            "frames": np.array(self.frames), "tail": self.tail,
            "folded": np.array([self.folded, self.taken, self.last]),
            "accumulator": np.array(self._accumulator),
            "surroundings": np.array(self.surroundings).reshape(-1, SURROUNDINGS),
            "misfits": np.array(self._misfits).reshape(-1, len(BALANCES)),
        }  # fmt: skip
        for name, regression in self.regressions.items():
            sums = _stacked(self.equations[name], len(BALANCES[name].columns))
            for k, part in zip("mvrs", sums, strict=True):
                out[f"{name}/{k}"] = part
            out[f"{name}/noise"] = np.array([regression.weight, regression.variance_sum])
            out[f"{name}/level"] = regression.level
            out[f"{name}/lengths"] = np.array([len(r) for r in regression.recent])
            out[f"{name}/recent"] = (
                np.concatenate(regression.recent) if regression.recent else np.empty((0, 0))
            )
            out[f"{name}/mean"], out[f"{name}/covariance"] = (
                self.reference[name].mean,
                self.reference[name].covariance,
            )
        out |= {f"epochs/{k}": v for k, v in self.epochs.state().items()}
        return {k: np.array(v) for k, v in out.items()}

    def restore(self, state: dict[str, Array]) -> None:
        """Go on from what `state` gave for the same unit."""
        self.frames = [int(h) for h in state["frames"]]
        self.tail = state["tail"].copy()
        epochs = {k.removeprefix("epochs/"): v for k, v in state.items() if k.startswith("epochs/")}
        self.epochs.restore(epochs)
        self.folded, self.taken, self.last = (int(x) for x in state["folded"])
        self._accumulator = float(state["accumulator"])
        self.surroundings = state["surroundings"].tolist()
        self._misfits = [[float(x) for x in row] for row in state["misfits"]]
        for name, regression in self.regressions.items():
            m, v, r, s = (state[f"{name}/{k}"] for k in "mvrs")
            self.equations[name] = [
                NormalEquations(m[i], v[i], float(r[i]), float(s[i])) for i in range(len(self.frames))
            ]
            self._marginal[name] = []
            regression.weight, regression.variance_sum = (float(x) for x in state[f"{name}/noise"])
            regression.level = state[f"{name}/level"].copy()
            ends = np.cumsum(state[f"{name}/lengths"]).astype(np.int64)
            regression.recent = np.split(state[f"{name}/recent"], ends[:-1]) if ends.size else []
            mean, covariance = state[f"{name}/mean"].copy(), state[f"{name}/covariance"].copy()
            self.reference = {
                **self.reference,
                name: replace(self.effects[name], mean=mean, covariance=covariance),
            }


def _stacked(equations: list[NormalEquations], n: int) -> tuple[Array, Array, Array, Array]:
    m, v, rows, variance = (np.array([e[i] for e in equations]) for i in range(4))
    return m.reshape(-1, n, n), v.reshape(-1, n), rows, variance
