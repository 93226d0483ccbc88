"""Jumps of position, pump angle and pressures, held against what pump, piston and oil can do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.sensors import jumps
from fdd.sensors.jumps import CELL_S, COUNTS, NOISE_REACH, Jump
from fdd.sensors.ledger import Ledger
from fdd.sensors.limits import CHAMBERS, INDEX, NAMES, Limits
from fdd.sensors.memory import CELL_HISTORY, Memory

Array = NDArray[np.float64]

ANGLE, POSITION, DIFFERENCE = INDEX["pump_angle"], INDEX["position"], INDEX["pressure_difference"]
JUDGED = tuple(
    INDEX[n] for n in ("pump_angle", "position", *CHAMBERS, "pressure_difference", "pressure_accumulator")
)
SPEED = INDEX["pump_speed"]
DEFERRED_S = 0.1
"""Rows are judged so much after they came, when the level after them is known."""
TAIL_S = 0.3
STRIDES = (1, 2)
CELL_REACH = 12.0
"""Standard deviations of a cell's mean: as `jumps.NOISE_REACH`, less since the history counts as well."""
LEARNT_CELLS = 25
HELD_ROWS = 8
"""Rows of one position before a jump, from which on it may have been held."""
BREAKS_LOOSE = 0.75
"""Of a·w², what the mean rate over w can be beyond those before and after, where a piston speeds up and slows
down at a: at the peak, (V w - a w²/4) - (V w - a w²). Less than a quarter where it all happens within w."""
PUMP_DOUBT = 0.5
"""Share of the pump's own change that the piston need not follow: leakage, unequal areas, an open valve."""


@dataclass(frozen=True)
class Rows:
    """Rows under judgement.

    Attributes
    ----------
    time : (n,) s. values : (n, 12) in the order of `NAMES`. noise : (12,) of a row, see `jumps.spread`.
    swept : (n,) m³ that the pump displaced, from an arbitrary zero; None without angle and speed.
    """

    time: Array
    values: Array
    noise: Array
    swept: Array | None

    @classmethod
    def of(cls, time: Array, values: Array, limits: Limits, memory: Memory) -> Rows:
        """With noise and swept volume worked out."""
        return cls(time, values, jumps.spread(values), _swept(time, values, limits, memory))

    def difference(self) -> Array | None:
        """Δp, measured or from both chambers, (n,) Pa."""
        one, two = (self.values[:, INDEX[n]] for n in CHAMBERS)
        for found in (self.values[:, DIFFERENCE], one - two):
            if np.isfinite(found).any():
                return np.asarray(found)
        return None


def _swept(time: Array, values: Array, limits: Limits, memory: Memory) -> Array | None:
    for k in (ANGLE, SPEED):
        there = np.isfinite(values[:, k])
        if there.sum() < 2 or not np.isnan(memory.failed_since[k]):
            continue
        column = values[:, k] if there.all() else np.interp(time, time[there], values[there, k])
        if k == SPEED:
            column = np.concatenate(([0.0], np.cumsum(0.5 * (column[1:] + column[:-1]) * np.diff(time))))
        return np.asarray(limits.displacement * column)
    return None


class JumpWatch:
    """Look for jumps in each hop.

    Parameters
    ----------
    limits : of the unit. memory, ledger : what is kept, and where findings go.
    """

    def __init__(self, limits: Limits, memory: Memory, ledger: Ledger) -> None:
        self.limits, self.memory, self.ledger = limits, memory, ledger

    def hop(self, rows: Rows, start: float, end: float, failing: set[int]) -> None:
        """Judge what came `DEFERRED_S` earlier than the hop from `start` to `end`."""
        span = start - DEFERRED_S, end - DEFERRED_S
        there = np.any(np.isfinite(rows.values), axis=0)
        judged = [k for k in JUDGED if there[k] and self._judged(k, rows, failing)]
        if not judged or rows.time.size < 8:
            return
        values = rows.values[:, judged]
        floor = COUNTS * self.limits.resolution + NOISE_REACH * np.maximum(rows.noise, self.limits.noise)
        overs = [jumps.excess(rows.time, values, stride) for stride in STRIDES]
        peaks = [np.fmax.reduce(np.abs(over), axis=0) for over in overs]
        found: dict[int, list[Jump]] = {k: [] for k in judged}
        for i, k in enumerate(judged):
            for stride, over, peak in zip(STRIDES, overs, peaks, strict=True):
                # Most hops end here: nothing in the channel is beyond its noise.
                if peak[i] > floor[k] and not found[k]:
                    limit = floor[k] + self._explained(k, rows, stride)
                    found[k] = jumps.jumps(rows.time, values[:, i], over[:, i], limit, *span)
        self._slow(judged, rows, span, found)
        period = float(rows.time[-1] - rows.time[0]) / (rows.time.size - 1)
        for k, of_channel in found.items():
            for jump in of_channel:
                self._tell(k, jump, rows, period, end, failing)

    def _judged(self, k: int, rows: Rows, failing: set[int]) -> bool:
        if k in failing or (k == DIFFERENCE and self.memory.derived[0] == 1.0):
            return False
        if self.memory.held_until[k] > rows.time[0]:
            # A loose contact: its jumps are told as that.
            return False
        # A biased pressure is still watched, for the step back.
        trusted = np.isnan(self.memory.failed_since[k]) or self.memory.biased[k] != 0.0
        return bool(trusted) and (k != POSITION or rows.swept is not None)

    def _explained(self, k: int, rows: Rows, stride: int) -> Array:
        """What of an excess physics and the recorder explain in each row, (n,); inf beside missing rows."""
        limits, time = self.limits, rows.time
        steps = np.diff(time, prepend=time[0])
        period = jumps.median(steps[1:])
        if k == ANGLE:
            # A row that came a whole period late shows no step and then two; one between two late ones is
            # short before and after, and seems to want three.
            late = jumps.widest(np.abs(steps - period), 2 * stride) > 0.25 * period
            usual = np.minimum(_usual_step(time, rows.values[:, k]), limits.pump_speed * period)
            out = np.where(late, 3.0, 2.0) * stride * usual + limits.acceleration * (stride * period) ** 2
        elif k == POSITION and rows.swept is not None:
            out = np.full(time.size, BREAKS_LOOSE * limits.release * (stride * period) ** 2)
            # Late and missing rows are late and missing in the pump's angle too.
            over = jumps.excess(time, rows.swept / limits.area, stride)
            out += 1.5 * jumps.widest(np.abs(over), 2 * stride)
            # A piston that its load moves while the pump stands: what it goes in the time that a row is late.
            waited = jumps.widest(np.abs(steps - period), 2 * stride) / period
            out += waited.clip(max=1.0) * stride * _usual_step(time, rows.values[:, k])
        else:
            out = limits.stiffness * stride * jumps.widest(self._moved_oil(rows), 3 * stride)
        out[jumps.widest(steps, stride) > 3.5 * period] = np.inf
        return np.asarray(out)

    def _moved_oil(self, rows: Rows) -> Array:
        """Oil that pump and piston move from row to row at most, (n,) m³."""
        flow = np.zeros(rows.time.size)
        if rows.swept is not None:
            flow += np.abs(np.diff(rows.swept, prepend=rows.swept[0]))
        position = rows.values[:, POSITION]
        return flow + self.limits.area * np.abs(np.nan_to_num(np.diff(position, prepend=np.nan)))

    def _slow(
        self, judged: list[int], rows: Rows, span: tuple[float, float], found: dict[int, list[Jump]]
    ) -> None:
        """Jumps that take up to two cells, and those that a row's noise hides."""
        memory, limits, time = self.memory, self.limits, rows.time
        origin = span[0] - 3.0 * CELL_S
        cells = round((span[1] - span[0]) / CELL_S) + 6
        means = jumps.cell_means(time, rows.values[:, judged], origin, cells)
        over = jumps.cell_excess(means)
        pumped = None
        if POSITION in judged and rows.swept is not None:
            pumped = jumps.cell_means(time, rows.swept[:, None] / limits.area, origin, cells)[:, 0]
            i = judged.index(POSITION)
            # It has to show in the position alone and against the pump: an angle that jumps is no slip.
            relative = jumps.cell_excess(means[:, i] - pumped)
            over[:, i] = np.where(np.abs(relative) < np.abs(over[:, i]), relative, over[:, i])
        per_cell = max(CELL_S * (time.size - 1) / float(time[-1] - time[0]), 1.0)
        for i, k in enumerate(judged):
            past = int(memory.cell_count[k])
            usual = 0.0
            if past:
                rank = int(0.9 * (past - 1))
                usual = float(np.partition(memory.cells[k, -past:], rank)[rank]) / jumps.GAUSS_90
            noise = max(rows.noise[k], limits.noise[k]) / np.sqrt(per_cell)
            floor = COUNTS * limits.resolution[k] + CELL_REACH * max(usual, noise)
            fresh = np.abs(over[3:-3, i])
            memory.cells[k] = np.concatenate((memory.cells[k], np.minimum(fresh, floor)))[-CELL_HISTORY:]
            memory.cell_count[k] = min(past + fresh.size, CELL_HISTORY)
            if past < LEARNT_CELLS or not (fresh > floor).any():
                continue
            limit = floor + self._explained_cells(k, rows, judged, means, pumped, origin)
            found[k] += self._slow_jumps(means[:, i], over[:, i], limit, origin, found[k])

    def _explained_cells(
        self, k: int, rows: Rows, judged: list[int], means: Array, pumped: Array | None, origin: float
    ) -> Array:
        """As `_explained`, for cells, (cells,)."""
        limits, cells = self.limits, means.shape[0]
        if k == ANGLE:
            return np.asarray(limits.pump_speed * 2.0 * CELL_S + np.zeros(cells))
        if k == POSITION and pumped is not None:
            out = PUMP_DOUBT * jumps.cell_range(pumped)
            pressures = [i for i, j in enumerate(judged) if NAMES[j] in (*CHAMBERS, "pressure_difference")]
            for i in pressures[:2]:
                out = out + limits.softness * jumps.cell_range(means[:, i])
            return np.asarray(out)
        pushed = jumps.cell_means(rows.time, np.cumsum(self._moved_oil(rows))[:, None], origin, cells)
        return np.asarray(limits.stiffness * jumps.cell_range(pushed[:, 0]))

    def _slow_jumps(
        self, level: Array, over: Array, limit: Array, origin: float, sharp: list[Jump]
    ) -> list[Jump]:
        wild = np.flatnonzero(np.abs(over[3:-3]) > limit[3:-3]) + 3
        found: list[Jump] = []
        for group in np.split(wild, np.flatnonzero(np.diff(wild) > 3) + 1) if wild.size else ():
            at = int(group[np.argmax(np.abs(over[group]))])
            when = origin + CELL_S * at
            before, after = level[at - 3 : at], level[at + 1 : at + 4]
            net = float(np.median(after) - np.median(before))
            near = any(abs(when - j.time) < 3.0 * CELL_S for j in sharp)
            if not near and abs(net) > max(limit[at], jumps.STAYS * abs(over[at])):
                found.append(Jump(float(when), net, float(over[at]), float(np.median(before)), 1))
        return found

    def _tell(self, k: int, jump: Jump, rows: Rows, period: float, end: float, failing: set[int]) -> None:
        name, until = NAMES[k], jump.time + jump.rows * period
        scale, unit = {ANGLE: (1.0, "rad"), POSITION: (1e3, "mm")}.get(k, (1e-6, "MPa"))
        told = f"{name} jumps by {scale * jump.peak:.4g} {unit} at {jump.time:.3f} s"
        if k == ANGLE:
            told += f", {abs(jump.peak) / period * 60.0 / (2.0 * np.pi):.0f} rpm"
        if jump.net == 0.0 and k in (ANGLE, POSITION):
            told += ", and comes back"
            self.ledger.report(name, "spikes", jump.time, until, end, float(jump.rows), told)
        elif k == ANGLE:
            told += f", and stays {jump.net:.3g} rad off"
            self.ledger.report(name, "slip", jump.time, None, end, abs(jump.net), told)
        elif k == POSITION and (held := self._held(jump, rows)) is not None:
            lost = f"position stood for {jump.time - held:.3f} s while the pump turned"
            told = f"{lost}, then caught up by {1e3 * jump.net:.3f} mm"
            self.ledger.report(name, "dropout", held, jump.time, end, jump.time - held, told)
        elif k == POSITION:
            told += f", and stays {scale * jump.net:.3f} mm off, which neither pump nor pressure explain"
            self.ledger.report(name, "slip", jump.time, None, end, abs(jump.net), told)
        elif jump.net != 0.0 and self._outside(k, rows, jump):
            self._tell_step(k, jump, end, failing)

    def _held(self, jump: Jump, rows: Rows) -> float | None:
        """Since when the position was held, if its jump is what the pump displaced meanwhile; else None."""
        row = int(np.searchsorted(rows.time, jump.time))
        position = rows.values[:row, POSITION]
        other = np.flatnonzero(position != position[-1]) if row else np.empty(0, np.intp)
        first = int(other[-1]) + 1 if other.size else 0
        if rows.swept is None or row - first < HELD_ROWS:
            return None
        moved = float(rows.swept[row] - rows.swept[first]) / self.limits.area
        return float(rows.time[first]) if abs(moved - jump.net) < 0.3 * abs(jump.net) else None

    def _outside(self, k: int, rows: Rows, jump: Jump) -> bool:
        """Whether a pressure's new level is beyond all that an opening valve could bring."""
        if self.memory.biased[k] * jump.net < 0.0:
            return True
        near = np.abs(rows.time - jump.time) < DEFERRED_S
        levels = [0.0, jump.before]
        signs = (1.0, -1.0) if k == DIFFERENCE else (1.0,)
        for other in (INDEX[n] for n in (*CHAMBERS, "pressure_accumulator")):
            found = rows.values[near, other]
            if other != k and np.isfinite(found).any() and np.isnan(self.memory.failed_since[other]):
                levels += [s * float(np.nanmedian(found)) for s in signs]
        after, slack = jump.before + jump.net, 4.0 * max(rows.noise[k], self.limits.noise[k])
        return bool(after > max(levels) + slack or after < min(levels) - slack)

    def _tell_step(self, k: int, jump: Jump, end: float, failing: set[int]) -> None:
        memory, name = self.memory, NAMES[k]
        after = memory.biased[k] + jump.net
        if memory.biased[k] != 0.0 and abs(after) < 0.3 * abs(jump.net):
            memory.biased[k] = 0.0
            return
        memory.biased[k] = after
        told = (
            f"{name} steps by {1e-6 * jump.net:.3g} MPa at {jump.time:.3f} s, where neither pump nor piston "
            f"moves oil for it"
        )
        failing.add(k)
        if np.isnan(memory.failed_since[k]):
            memory.failed_since[k] = jump.time
        self.ledger.report(name, "step", jump.time, None, end, jump.net, told)


def _usual_step(time: Array, values: Array) -> Array:
    """Median size of a row's step and two on either side, (n,): two wild rows cannot raise it.

    Between the measurements of a channel that is slower than the rows, its steps are those of a line.
    """
    there = np.isfinite(values)
    known = values if there.all() else np.interp(time, time[there], values[there])
    padded = np.pad(np.abs(np.diff(known, prepend=known[0])), 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5)
    return np.asarray(np.partition(windows, 2, axis=1)[:, 2])
