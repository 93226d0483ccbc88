"""Jumps of position, pump angle and pressures, held against what pump, piston and oil can do.

Steps of single rows are judged by `jumps`; slower ones by the means of cells of 20 ms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.finding import CELL_HISTORY, Memory, SensorFindings, njit
from fdd.sensors.jumps import NOISE_REACH, STAYS, Jump, Rows, excess, explained, jumps, moved_oil, widest
from fdd.sensors.limits import ACCUMULATOR, ANGLE, DIFFERENCE, NAMES, ONE, POSITION, TWO, Array, Limits, Mask
from fdd.sensors.scan import FRAME_S, GAUSS_90, LEAK_MARGIN, place, smallest

JUDGED = (ANGLE, POSITION, ONE, TWO, DIFFERENCE, ACCUMULATOR)
IS_JUDGED = np.isin(np.arange(len(NAMES)), JUDGED)
DEFERRED_S = 0.1
"""s, delay of the judgement of a row, so that the level after it is known."""
HELD_ROWS = 8
"""Rows of one position before a jump, from which on it may have been held."""
STRIDES = (1, 2)
CELL_S = 0.02
BESIDE_CELLS = 3
"""Cells on either side that a cell's step is compared with."""
COUNTS = 6.0
"""Allowance in counts: rounding gives an excess of up to 2, hysteresis and unevenness of a plain scale as
much each."""
CELL_REACH = 12.0
"""Standard deviations of a cell's mean: as `jumps.NOISE_REACH`, less since the history counts as well."""
LEARNT_CELLS = 25
PUMP_DOUBT = 0.5
"""Share of the pump's own change that the piston need not follow: leakage, unequal areas, an open valve."""
LOADED = (ONE, TWO, DIFFERENCE)


class JumpWatch:
    """Look for jumps in each frame; see `FrameJudge`."""

    def __init__(self, limits: Limits, findings: SensorFindings) -> None:
        self.limits, self.findings = limits, findings

    def judge(self, rows: Rows, seen: Array, end: float) -> None:
        """Judge what came `DEFERRED_S` before the frame until `end` (s); `seen` (12,) counts the values."""
        limits, memory, time = self.limits, self.findings.memory, rows.time
        # A loose contact's jumps are reported as such; a biased pressure is still watched, for the step back.
        judged = IS_JUDGED & (seen > 0.0) & ~self.findings.failing & (memory.held_until <= time[0])
        judged &= np.isnan(memory.failed_since) | (memory.biased != 0.0)
        judged[DIFFERENCE] &= memory.derived[0] != 1.0
        judged[POSITION] &= rows.swept.size > 0
        if time.size < 8 or not judged.any():
            return
        start, stop = end - FRAME_S - DEFERRED_S, end - DEFERRED_S
        origin, cells = start - BESIDE_CELLS * CELL_S, round((stop - start) / CELL_S) + 2 * BESIDE_CELLS
        peaks, means, over, limit = cells_of(
            time, rows.values, rows.swept, judged, rows.noise, origin, cells, limits, memory
        )
        floor = COUNTS * limits.resolution + NOISE_REACH * np.maximum(rows.noise, limits.noise)
        sharp, inner = peaks > floor, slice(BESIDE_CELLS, -BESIDE_CELLS)
        slow = (np.abs(over[:, inner]) > limit[:, inner]).any(axis=1)
        # Most frames end here: nothing in a channel is beyond its noise.
        odd = slow | sharp.any(axis=0)
        period = float(time[-1] - time[0]) / (time.size - 1)
        for k in (k for k in JUDGED if odd[k]):
            found: list[Jump] = []
            for stride, is_sharp in zip(STRIDES, sharp[:, k], strict=True):
                if is_sharp and not found:
                    most = floor[k] + explained(k, time, rows.values, rows.swept, stride, limits)
                    over_rows = excess(time, rows.values[k], stride)
                    found = jumps(time, rows.values[k], over_rows, most, start, stop)
            if slow[k]:
                found += _slow_jumps(means[k], over[k], limit[k], origin, found)
            for jump in found:
                self._tell(k, jump, rows, period)

    def _tell(self, k: int, jump: Jump, rows: Rows, period: float) -> None:
        report, until = self.findings.report, jump.time + jump.rows * period
        scale, unit = {ANGLE: (1.0, "rad"), POSITION: (1e3, "mm")}.get(k, (1e-6, "MPa"))
        if k == POSITION:
            self.findings.jumps.append((jump.time, until, self.findings.end))
        message = f"{NAMES[k]} jumps by {scale * jump.peak:.4g} {unit} at {jump.time:.3f} s"
        if k == ANGLE:
            message += f", {abs(jump.peak) / period * 60.0 / (2.0 * np.pi):.0f} rpm"
        if jump.net == 0.0 and k in (ANGLE, POSITION):
            report(k, "spikes", jump.time, until, float(jump.rows), f"{message}, and comes back")
        elif k == ANGLE:
            message += f", and stays {jump.net:.3g} rad off"
            report(k, "slip", jump.time, None, abs(jump.net), message)
        elif k == POSITION and (held := self._held(jump, rows)) is not None:
            lost = f"position stood for {jump.time - held:.3f} s while the pump turned"
            message = f"{lost}, then caught up by {1e3 * jump.net:.3f} mm"
            report(k, "dropout", held, jump.time, jump.time - held, message)
        elif k == POSITION and self._reads_nothing(jump, rows):
            self.findings.fail(k, "dead", jump.time, 0.0, f"{message} to exactly 0: no signal")
        elif k == POSITION:
            message += f", and stays {scale * jump.net:.3f} mm off, which neither pump nor pressure explain"
            report(k, "slip", jump.time, None, abs(jump.net), message)
        elif jump.net != 0.0 and self._outside(k, rows, jump):
            self._tell_step(k, jump)

    def _held(self, jump: Jump, rows: Rows) -> float | None:
        """Since when the position was held, if its jump is what the pump displaced meanwhile; else None."""
        row = int(np.searchsorted(rows.time, jump.time))
        position = rows.values[POSITION, :row]
        other = np.flatnonzero(position != position[-1]) if row else np.empty(0, np.intp)
        first = int(other[-1]) + 1 if other.size else 0
        if not rows.swept.size or row - first < HELD_ROWS:
            return None
        since, moved = float(rows.time[first]), float(rows.swept[row] - rows.swept[first])
        stood = self.findings.memory.stood
        if first == 0 and abs(stood[1] - jump.time) < DEFERRED_S:  # it stood longer than there are rows
            since, moved = float(stood[0]), float(stood[2])
        caught_up = abs(moved / self.limits.area - jump.net) < 0.3 * abs(jump.net)
        return since if caught_up and not self._may_stand(rows, first, row, moved) else None

    def _may_stand(self, rows: Rows, first: int, row: int, moved: float) -> bool:
        """Whether the piston stood until a jump, which is a slip then: it stands on, and what the pump
        displaced since the `first` row (m³) leaks."""
        after, pressure = rows.values[POSITION, row : row + HELD_ROWS], rows.difference()
        if pressure is None or after.size < HELD_ROWS:
            return False
        leaks = np.nansum(np.abs(pressure[first:row]) * np.diff(rows.time[first : row + 1]))
        stands = np.ptp(after) <= 2.0 * self.limits.resolution[POSITION]
        return bool(stands and abs(moved) <= LEAK_MARGIN * self.limits.leakage * leaks)

    def _reads_nothing(self, jump: Jump, rows: Rows) -> bool:
        """Whether the position is exactly 0 from a jump on: no piston stops just there."""
        after = rows.values[POSITION, int(np.searchsorted(rows.time, jump.time)) :]
        return after.size >= HELD_ROWS and bool((np.abs(after) <= self.limits.resolution[POSITION]).all())

    def _outside(self, k: int, rows: Rows, jump: Jump) -> bool:
        """Whether a pressure's new level is beyond all that an opening valve could bring."""
        if self.findings.memory.biased[k] * jump.net < 0.0:
            return True
        near = np.abs(rows.time - jump.time) < DEFERRED_S
        levels = [0.0, jump.before]
        signs = (1.0, -1.0) if k == DIFFERENCE else (1.0,)
        for other in (ONE, TWO, ACCUMULATOR):
            found = rows.values[other, near]
            if other != k and np.isfinite(found).any() and np.isnan(self.findings.memory.failed_since[other]):
                levels += [s * float(np.nanmedian(found)) for s in signs]
        after, slack = jump.before + jump.net, 4.0 * max(rows.noise[k], self.limits.noise[k])
        return bool(after > max(levels) + slack or after < min(levels) - slack)

    def _tell_step(self, k: int, jump: Jump) -> None:
        memory = self.findings.memory
        after = memory.biased[k] + jump.net
        if memory.biased[k] != 0.0 and abs(after) < 0.3 * abs(jump.net):
            memory.biased[k] = 0.0
            return
        memory.biased[k] = after
        self.findings.failing[k] = True
        if np.isnan(memory.failed_since[k]):
            memory.failed_since[k] = jump.time
        self.findings.report(
            k, "step", jump.time, None, jump.net,
            f"{NAMES[k]} steps by {1e-6 * jump.net:.3g} MPa at {jump.time:.3f} s, where neither pump nor "
            "piston moves oil for it",
        )  # fmt: skip


def _slow_jumps(level: Array, over: Array, limit: Array, origin: float, sharp: list[Jump]) -> list[Jump]:
    """Jumps between cells, but for those that single rows have shown."""
    wild = np.flatnonzero(np.abs(over[3:-3]) > limit[3:-3]) + 3
    found: list[Jump] = []
    for group in np.split(wild, np.flatnonzero(np.diff(wild) > 3) + 1) if wild.size else ():
        at = int(group[np.argmax(np.abs(over[group]))])
        when = origin + CELL_S * at
        before, after = level[at - 3 : at], level[at + 1 : at + 4]
        net = float(np.median(after) - np.median(before))
        near = any(abs(when - j.time) < 3.0 * CELL_S for j in sharp)
        if not near and abs(net) > max(limit[at], STAYS * abs(over[at])):
            found.append(Jump(float(when), net, float(over[at]), float(np.median(before)), 1))
    return found


@njit(nogil=True)
def cells_of(
    time: Array, values: Array, swept: Array, judged: Mask, noise: Array, origin: float, cells: int,
    limits: Limits, memory: Memory,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Look at `values` (12, n) of the judged channels in `cells` cells from `origin` (s) on.

    `swept` (n,) or (0,) as in `Rows`, `noise` (12,) of a row; what the memory's cells showed before goes on.
    Gives (2, 12) the largest excess of a row for either of `STRIDES`, 0 of channels that are not judged; and
    (12, cells) each: the cell's mean (NaN of those), how far its step exceeds its neighbours', and what that
    may be, inf for a channel in which nothing is beyond its noise.
    """
    channels, fresh = values.shape[0], cells - 2 * BESIDE_CELLS
    edges = np.empty(cells + 1, np.int64)
    for c in range(edges.size):
        edges[c] = place(time, origin + CELL_S * (c - 1e-6))
    peaks, means = np.zeros((len(STRIDES), channels)), np.full((channels, cells), np.nan)
    over, limit = np.zeros((channels, cells)), np.full((channels, cells), np.inf)
    per_cell = max(CELL_S * (time.size - 1) / (time[-1] - time[0]), 1.0)
    pumped, moved = np.empty(0), np.empty(0)
    for k in range(channels):
        if judged[k]:
            for s in range(len(STRIDES)):
                for x in excess(time, values[k], STRIDES[s]):
                    if abs(x) > peaks[s, k]:  # which no NaN is
                        peaks[s, k] = abs(x)
            means[k] = _cell_means(values[k], edges)
            over[k] = _cell_excess(means[k])
    if judged[POSITION]:
        pumped = _cell_means(swept / limits.area, edges)
        # It has to show in the position alone and against the pump: an angle that jumps is no slip.
        relative = _cell_excess(means[POSITION] - pumped)
        for c in range(cells):
            if abs(relative[c]) < abs(over[POSITION, c]):
                over[POSITION, c] = relative[c]
    for k in range(channels):
        if not judged[k]:
            continue
        past, usual = int(memory.cell_count[k]), 0.0
        if past:
            usual = smallest(memory.cells[k, CELL_HISTORY - past :].copy(), int(0.9 * (past - 1))) / GAUSS_90
        of_noise = max(noise[k], limits.noise[k]) / np.sqrt(per_cell)
        floor = COUNTS * limits.resolution[k] + CELL_REACH * max(usual, of_noise)
        beyond = False
        memory.cells[k, :-fresh] = memory.cells[k, fresh:].copy()
        for c in range(fresh):
            size = abs(over[k, BESIDE_CELLS + c])
            memory.cells[k, CELL_HISTORY - fresh + c] = min(size, floor)
            beyond = beyond or size > floor
        memory.cell_count[k] = min(past + fresh, CELL_HISTORY)
        if past < LEARNT_CELLS or not beyond:
            continue
        # What physics explains.
        if k == ANGLE:
            limit[k] = floor + limits.pump_speed * 2.0 * CELL_S
        elif k == POSITION:
            limit[k] = floor + PUMP_DOUBT * _cell_range(pumped)
            taken = 0
            for j in LOADED:
                if judged[j] and taken < 2:
                    limit[k] += limits.softness * _cell_range(means[j])
                    taken += 1
            if limits.loose > 0.0:
                # Where the load changes sides a single rod's piston runs freely for millimetres.
                drop = means[DIFFERENCE] if judged[DIFFERENCE] else means[ONE] - means[TWO]
                least = -widest(-np.abs(drop), BESIDE_CELLS)
                for c in range(cells):
                    if least[c] < limits.loose:
                        limit[k, c] = np.inf
        else:
            if not moved.size:
                oil = moved_oil(values[POSITION], swept, limits)
                for i in range(1, oil.size):
                    oil[i] += oil[i - 1]
                moved = _cell_range(_cell_means(oil, edges))
            limit[k] = floor + limits.stiffness * moved
    return peaks, means, over, limit


@njit(nogil=True)
def _cell_means(values: Array, edges: NDArray[np.int64]) -> Array:
    """Mean of the rows between `edges`, (cells,); NaN where rows or values lack."""
    out = np.full(edges.size - 1, np.nan)
    if edges[-1] > edges[0]:
        # Summed about the first row: the angle of a long log is large, a slip small.
        base = values[edges[0]]
        for c in range(out.size):
            total = 0.0
            for i in range(edges[c], edges[c + 1]):
                total += values[i] - base
            if edges[c + 1] > edges[c]:
                out[c] = total / (edges[c + 1] - edges[c]) + base
    return out


@njit(nogil=True)
def _cell_excess(means: Array) -> Array:
    """Step over two cells around each cell, beyond what the two steps before and after show, like `means`."""
    number, out = np.zeros(means.size), np.zeros(means.size)
    for c in range(means.size):
        number[c] = c
    over = excess(number, means, 2)
    for c in range(BESIDE_CELLS, means.size - BESIDE_CELLS):
        if not np.isnan(over[c + 1]):
            out[c] = over[c + 1]
    return out


@njit(nogil=True)
def _cell_range(means: Array) -> Array:
    """Highest less lowest of each cell and three on either side, (cells,); NaN where one of them is."""
    return widest(means, BESIDE_CELLS) + widest(-means, BESIDE_CELLS)
