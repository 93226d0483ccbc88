"""Jumps of position, pump angle and pressures, held against what pump, piston and oil can do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.sensors import jumps
from fdd.sensors.cells import BESIDE_CELLS, CELL_S, COUNTS, STRIDES, cells_of
from fdd.sensors.explained import ANGLE, POSITION, explained
from fdd.sensors.jumps import NOISE_REACH, Jump
from fdd.sensors.limits import CHAMBERS, INDEX, NAMES, Limits
from fdd.sensors.memory import Memory
from fdd.sensors.sensor_findings import SensorFindings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DIFFERENCE, SPEED = INDEX["pressure_difference"], INDEX["pump_speed"]
JUDGED = tuple(
    INDEX[n] for n in ("pump_angle", "position", *CHAMBERS, "pressure_difference", "pressure_accumulator")
)
IS_JUDGED = np.isin(np.arange(len(NAMES)), JUDGED)
DEFERRED_S = 0.1
"""s, delay of the judgement of a row, so that the level after it is known."""
TAIL_S = 0.3
HELD_ROWS = 8
"""Rows of one position before a jump, from which on it may have been held."""


@dataclass(frozen=True)
class Rows:
    """Rows under judgement.

    Attributes
    ----------
    time : (n,) s. values : (12, n) in the order of `NAMES`. noise : (12,) of a row, see `spread`.
    swept : (n,) m³ that the pump displaced, from an arbitrary zero; (0,) without angle and speed.
    """

    time: Array
    values: Array
    noise: Array
    swept: Array

    def difference(self) -> Array | None:
        """Δp, measured or from both chambers, (n,) Pa."""
        one, two, found = (self.values[INDEX[n]] for n in (*CHAMBERS, "pressure_difference"))
        if np.isnan(found).all():
            found = one - two
        return None if np.isnan(found).all() else np.asarray(found)


def swept_volume(time: Array, values: Array, limits: Limits, memory: Memory) -> Array:
    """As `Rows.swept`, from `values` (12, n)."""
    for k in (ANGLE, SPEED):
        there = np.isfinite(values[k])
        known = np.count_nonzero(there)
        if known < 2 or not np.isnan(memory.failed_since[k]):
            continue
        column = values[k] if known == time.size else np.interp(time, time[there], values[k, there])
        if k == SPEED:
            column = np.concatenate(([0.0], np.cumsum(0.5 * (column[1:] + column[:-1]) * np.diff(time))))
        return np.asarray(limits.displacement * column)
    return np.empty(0)


class JumpWatch:
    """Look for jumps in each frame.

    Parameters
    ----------
    limits : of the unit. memory : what is kept. findings : where they go.
    """

    def __init__(self, limits: Limits, memory: Memory, findings: SensorFindings) -> None:
        self.limits, self.memory, self.findings = limits, memory, findings

    def judge(self, rows: Rows, seen: Array, start: float, end: float, failing: Mask) -> None:
        """Judge what came `DEFERRED_S` earlier than the frame from `start` to `end`.

        Parameters
        ----------
        seen : (12,) values of each channel among the rows. failing : (12,) channels with a failure, added to.
        """
        limits, memory, time = self.limits, self.memory, rows.time
        # A loose contact's jumps are reported as such; a biased pressure is still watched, for the step back.
        judged = IS_JUDGED & (seen > 0.0) & ~failing & (memory.held_until <= time[0])
        judged &= np.isnan(memory.failed_since) | (memory.biased != 0.0)
        judged[DIFFERENCE] &= memory.derived[0] != 1.0
        judged[POSITION] &= rows.swept.size > 0
        if time.size < 8 or not judged.any():
            return
        start, stop = start - DEFERRED_S, end - DEFERRED_S
        origin, cells = start - BESIDE_CELLS * CELL_S, round((stop - start) / CELL_S) + 2 * BESIDE_CELLS
        peaks, means, over, limit = cells_of(
            time, rows.values, rows.swept, judged, rows.noise, origin, cells, limits, memory
        )
        floor = COUNTS * limits.resolution + NOISE_REACH * np.maximum(rows.noise, limits.noise)
        sharp, inner = peaks > floor, slice(BESIDE_CELLS, -BESIDE_CELLS)
        slow = (np.abs(over[:, inner]) > limit[:, inner]).any(axis=1)
        # Most frames end here: nothing in a channel is beyond its noise.
        odd = slow | sharp.any(axis=0)
        for k in (k for k in JUDGED if odd[k]):
            found: list[Jump] = []
            for stride, is_sharp in zip(STRIDES, sharp[:, k], strict=True):
                if is_sharp and not found:
                    most = floor[k] + explained(k, time, rows.values, rows.swept, stride, limits)
                    over_rows = jumps.excess(time, rows.values[k], stride)
                    found = jumps.jumps(time, rows.values[k], over_rows, most, start, stop)
            if slow[k]:
                found += self._slow_jumps(means[k], over[k], limit[k], origin, found)
            period = float(time[-1] - time[0]) / (time.size - 1)
            for jump in found:
                self._tell(k, jump, rows, period, end, failing)

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

    def _tell(self, k: int, jump: Jump, rows: Rows, period: float, end: float, failing: Mask) -> None:
        name, until = NAMES[k], jump.time + jump.rows * period
        scale, unit = {ANGLE: (1.0, "rad"), POSITION: (1e3, "mm")}.get(k, (1e-6, "MPa"))
        message = f"{name} jumps by {scale * jump.peak:.4g} {unit} at {jump.time:.3f} s"
        if k == ANGLE:
            message += f", {abs(jump.peak) / period * 60.0 / (2.0 * np.pi):.0f} rpm"
        if jump.net == 0.0 and k in (ANGLE, POSITION):
            message += ", and comes back"
            self.findings.report(name, "spikes", jump.time, until, end, float(jump.rows), message)
        elif k == ANGLE:
            message += f", and stays {jump.net:.3g} rad off"
            self.findings.report(name, "slip", jump.time, None, end, abs(jump.net), message)
        elif k == POSITION and (held := self._held(jump, rows)) is not None:
            lost = f"position stood for {jump.time - held:.3f} s while the pump turned"
            message = f"{lost}, then caught up by {1e3 * jump.net:.3f} mm"
            self.findings.report(name, "dropout", held, jump.time, end, jump.time - held, message)
        elif k == POSITION and self._reads_nothing(jump, rows):
            failing[k], self.memory.failed_since[k] = True, jump.time
            self.findings.report(
                name, "dead", jump.time, None, end, 0.0, f"{message} to exactly 0: no signal"
            )
        elif k == POSITION:
            message += f", and stays {scale * jump.net:.3f} mm off, which neither pump nor pressure explain"
            self.findings.report(name, "slip", jump.time, None, end, abs(jump.net), message)
        elif jump.net != 0.0 and self._outside(k, rows, jump):
            self._tell_step(k, jump, end, failing)

    def _held(self, jump: Jump, rows: Rows) -> float | None:
        """Since when the position was held, if its jump is what the pump displaced meanwhile; else None."""
        row = int(np.searchsorted(rows.time, jump.time))
        position = rows.values[POSITION, :row]
        other = np.flatnonzero(position != position[-1]) if row else np.empty(0, np.intp)
        first = int(other[-1]) + 1 if other.size else 0
        if not rows.swept.size or row - first < HELD_ROWS:
            return None
        since, moved = float(rows.time[first]), float(rows.swept[row] - rows.swept[first])
        stood = self.memory.stood
        if first == 0 and abs(stood[1] - jump.time) < DEFERRED_S:  # it stood longer than there are rows
            since, moved = float(stood[0]), float(stood[2])
        return since if abs(moved / self.limits.area - jump.net) < 0.3 * abs(jump.net) else None

    def _reads_nothing(self, jump: Jump, rows: Rows) -> bool:
        """Whether the position is exactly 0 from a jump on: no piston stops just there."""
        after = rows.values[POSITION, int(np.searchsorted(rows.time, jump.time)) :]
        return after.size >= HELD_ROWS and bool((np.abs(after) <= self.limits.resolution[POSITION]).all())

    def _outside(self, k: int, rows: Rows, jump: Jump) -> bool:
        """Whether a pressure's new level is beyond all that an opening valve could bring."""
        if self.memory.biased[k] * jump.net < 0.0:
            return True
        near = np.abs(rows.time - jump.time) < DEFERRED_S
        levels = [0.0, jump.before]
        signs = (1.0, -1.0) if k == DIFFERENCE else (1.0,)
        for other in (INDEX[n] for n in (*CHAMBERS, "pressure_accumulator")):
            found = rows.values[other, near]
            if other != k and np.isfinite(found).any() and np.isnan(self.memory.failed_since[other]):
                levels += [s * float(np.nanmedian(found)) for s in signs]
        after, slack = jump.before + jump.net, 4.0 * max(rows.noise[k], self.limits.noise[k])
        return bool(after > max(levels) + slack or after < min(levels) - slack)

    def _tell_step(self, k: int, jump: Jump, end: float, failing: Mask) -> None:
        memory, name = self.memory, NAMES[k]
        after = memory.biased[k] + jump.net
        if memory.biased[k] != 0.0 and abs(after) < 0.3 * abs(jump.net):
            memory.biased[k] = 0.0
            return
        memory.biased[k] = after
        message = (
            f"{name} steps by {1e-6 * jump.net:.3g} MPa at {jump.time:.3f} s, where neither pump nor piston "
            f"moves oil for it"
        )
        failing[k] = True
        if np.isnan(memory.failed_since[k]):
            memory.failed_since[k] = jump.time
        self.findings.report(name, "step", jump.time, None, end, jump.net, message)
