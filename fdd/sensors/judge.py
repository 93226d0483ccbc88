"""The verdict on a hop of half a second: each channel held against its limits and its own past."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors import constancy
from fdd.sensors.finding import Kind
from fdd.sensors.jumping import JumpWatch, Rows
from fdd.sensors.jumps import median
from fdd.sensors.ledger import Ledger
from fdd.sensors.limits import CHAMBERS, INDEX, NAMES, NOT_MEASURED, Limits, figure
from fdd.sensors.memory import MOVING, STILL, Memory
from fdd.sensors.supply import SAME_INSTANT_S, SupplyWatch

Array = NDArray[np.float64]

HOP_S = 0.5
LONG_GAP_S = 0.25
"""A gap in one channel is told from here on: eight times the longest burst that a healthy recorder loses."""
LOST_SHARE, LOST_WINDOW_S = 0.05, 10.0
"""Shorter gaps are told when they make up this share of the last ten seconds."""
BURST_S = 1.0
"""A value that stood for less is a loose contact's; a sensor that fails stays failed."""
SPARSE_SHARE = 0.8
"""A channel with fewer values than this is a slow one that stands between faster ones."""
NOISE_FACTOR, NOISE_HOPS = 5.0, 4
"""The scale of a hop's noise, from some 500 second differences, scatters by a tenth: five is no chance."""
FAINT_FACTOR = 0.1
WITHOUT_NOISE = ("oil_temperature", "motor_current")
"""A slow channel shows its noise too seldom, and that of a current is the drive's as well."""
GOOD_HOPS = 2
"""Hops without a complaint after which a channel is trusted again."""


class HopJudge:
    """Judge hop after hop.

    Parameters
    ----------
    limits : of the unit. memory, ledger : what is kept, and where findings go.
    """

    def __init__(self, limits: Limits, memory: Memory, ledger: Ledger) -> None:
        self.limits, self.memory, self.ledger = limits, memory, ledger
        self._jumps = JumpWatch(limits, memory, ledger)
        self._supply = SupplyWatch(limits, memory, ledger)

    def hop(self, rows: Rows, first: int, impossible: NDArray[np.bool_], end: float) -> None:
        """Judge rows ``first:`` of `rows`; those before are the tail of the hop before.

        Parameters
        ----------
        impossible : (m, 12) rows of this hop that `RowMasks` took out. end : s, of the hop.
        """
        memory, time, values = self.memory, rows.time[first:], rows.values[first:]
        finite = np.isfinite(values)
        memory.rows += time.size
        memory.present += finite.sum(axis=0)
        self._derived(values)
        swept = rows.swept
        turned = (
            0.0 if swept is None else float(np.abs(np.diff(swept[first:])).sum() / self.limits.displacement)
        )
        kind = MOVING if turned > 2.0 * np.pi else STILL
        failing: set[int] = set()
        for k in np.flatnonzero(memory.present > 0).tolist():
            if not memory.is_derived(k):
                self._absent(k, time, finite[:, k], end, failing)
            if finite[:, k].any() and NAMES[k] not in NOT_MEASURED and not memory.is_derived(k):
                t, v = (
                    (time, values[:, k])
                    if finite[:, k].all()
                    else (time[finite[:, k]], values[finite[:, k], k])
                )
                self._measured(k, kind, t, v, impossible[finite[:, k], k], rows, first, end, failing)
        self._jumps.hop(rows, end - HOP_S, end, failing)
        self._supply.silent_from_start(end, failing)
        self._supply.lost_together(end, failing)
        self._recover(end, failing)

    def _derived(self, values: Array) -> None:
        """Whether Δp carries nothing of its own, so that it fails with the chambers' pressures."""
        one, two = (values[:, INDEX[n]] for n in CHAMBERS)
        both = values[:, INDEX["pressure_difference"]] - (one - two)
        both = both[np.isfinite(both)]
        if both.size and self.memory.derived[0] != 0.0:
            self.memory.derived[0] = float(np.abs(both).max() < 1e-3)

    def _measured(
        self, k: int, kind: int, time: Array, values: Array, impossible: NDArray[np.bool_], rows: Rows,
        first: int, end: float, failing: set[int],
    ) -> None:  # fmt: skip
        before = len(failing)
        repeated = float((values[1:] == values[:-1]).mean()) if values.size > 1 else 0.0
        runs, longest = constancy.runs_of(time, values, k, self.memory)
        held = self._constant(k, kind, runs, end, failing)
        if k == INDEX["position"] and rows.swept is not None and k not in failing:
            self._standing(rows, rows.swept, first, end, failing)
        out = k in failing or self._range(k, time, values, impossible, end, failing)
        noise = float(rows.noise[k])
        odd = self._noise(k, kind, noise, end, failing)
        if kind == MOVING:
            whole = longest >= values.size
            self.memory.excited[k] = self.memory.excited[k] + 1.0 if whole else 0.0
        if len(failing) == before and not (held or out or odd) and np.isnan(self.memory.failed_since[k]):
            constancy.learn_repeats(k, kind, repeated, longest, int(self.memory.present[k]), self.memory)
            self.memory.hops[kind, k] += 1.0
            self.memory.noisiest[kind, k] = max(self.memory.noisiest[kind, k], noise)
            self.memory.quietest[kind, k] = min(self.memory.quietest[kind, k], noise)

    def _fail(
        self, k: int, kind: Kind, onset: float, now: float, size: float, evidence: str, failing: set[int]
    ) -> None:
        """A failure that lasts: told, and the channel not trusted from now on."""
        failing.add(k)
        if np.isnan(self.memory.failed_since[k]):
            self.memory.failed_since[k] = onset
            self.ledger.report(NAMES[k], kind, onset, None, now, size, evidence, adds=False)

    def _constant(self, k: int, kind: int, runs: list[constancy.Run], end: float, failing: set[int]) -> bool:
        memory, limits, name = self.memory, self.limits, NAMES[k]
        # A profile's noise of an encoder was taken in motion: only what moves at rest too has to move always.
        live = name in constancy.LIVE or constancy.shows_noise(k, memory, limits)
        held = False
        for run in runs:
            length = (end if run.until is None else run.until) - run.since
            reach = limits.resolution[k]
            at_rail = run.value >= limits.rail[k] - reach
            beyond = not limits.low[k] <= run.value <= limits.high[k]
            stuck = live and constancy.is_stuck(run, k, kind, end, memory, limits)
            if not (stuck or ((at_rail or beyond) and length >= constancy.RAIL_S)):
                continue
            held = True
            told = f"{name} shows exactly {figure(name, run.value)} in {run.rows} rows, {length:.2f} s"
            if run.until is not None and run.since == memory.failed_since[k]:
                # The end of what was told while it lasted; so short, it was a loose contact.
                if length < BURST_S:
                    memory.held_until[k] = run.until + LOST_WINDOW_S
                    self.ledger.rename(name, run.since, "dropout", length)
                continue
            if run.until is not None:
                memory.held_until[k] = run.until + LOST_WINDOW_S
                self.ledger.report(
                    name, "dropout", run.since, run.until, end, length, f"{told}, then goes on"
                )
                continue
            if memory.held_until[k] > run.since:
                self._fail(k, "dropout", run.since, end, length, told, failing)
                continue
            dead = abs(run.value) <= reach or abs(run.value - limits.dead[k]) <= reach
            if at_rail or (beyond and not dead):
                self._fail(
                    k, "saturated", run.since, end, run.value, f"{told}: the end of its range", failing
                )
            elif dead:
                self._fail(k, "dead", run.since, end, run.value, f"{told}: no signal", failing)
            else:
                need = constancy.rows_needed(k, kind, memory, limits)
                why = (
                    f"its noise lets it repeat for at most {need:.0f} rows" if memory.changed[k]
                    else "though the pump turns"
                )  # fmt: skip
                self._fail(k, "stuck", run.since, end, run.value, f"{told}; {why}", failing)
        return held

    def _standing(self, rows: Rows, swept: Array, first: int, end: float, failing: set[int]) -> None:
        k = INDEX["position"]
        pressure = rows.difference()
        if pressure is not None:
            since, count = float(self.memory.run_since[k]), float(self.limits.resolution[k])
            moving = constancy.stopped_in_motion(
                rows.time, rows.values[:, k], swept / self.limits.area, since, count
            )
            # From the last row of the hop before, so that no step of the angle is lost.
            part = slice(max(first - 1, 0), None)
            moved = constancy.standing_position(
                rows.time[part], swept[part], pressure[part], moving, self.memory, self.limits
            )
            if moved:
                volume = self.memory.volume[2] - self.memory.volume[1]
                told = (
                    f"position stands at {1e3 * self.memory.run_value[k]:.3f} mm while the pump displaces "
                    f"{1e6 * volume:.1f} cm³, {1e3 * volume / self.limits.area:.1f} mm of travel"
                )
                kind: Kind = "dead" if self.memory.run_value[k] == 0.0 else "stuck"
                self._fail(
                    k,
                    kind,
                    float(self.memory.run_since[k]),
                    end,
                    float(self.memory.run_value[k]),
                    told,
                    failing,
                )

    def _range(
        self, k: int, time: Array, values: Array, impossible: NDArray[np.bool_], end: float, failing: set[int]
    ) -> bool:
        low, high, name = self.limits.low[k], self.limits.high[k], NAMES[k]
        middle = median(values)
        if not low <= middle <= high:
            beyond = (values < low) | (values > high)
            told = (
                f"{name} is {figure(name, middle)} (median of {HOP_S:g} s), beyond what the unit can reach, "
                f"{figure(name, low)} to {figure(name, high)}"
            )
            self._fail(k, "out_of_range", float(time[np.argmax(beyond)]), end, middle, told, failing)
            return True
        if not impossible.any():
            return False
        wild = np.flatnonzero(((values < low) | (values > high)) & impossible)
        if wild.size:
            worst = float(values[wild][np.argmax(np.abs(values[wild]))])
            told = f"single rows of {name} are impossible, the first {figure(name, worst)}"
            self.ledger.report(
                name, "spikes", float(time[wild[0]]), float(time[wild[-1]]), end, float(wild.size), told,
                count=int(wild.size),
            )  # fmt: skip
        return bool(wild.size)

    def _noise(self, k: int, kind: int, noise: float, end: float, failing: set[int]) -> bool:
        memory, limits = self.memory, self.limits
        if memory.hops[kind, k] < constancy.LEARNT_HOPS or k in failing or NAMES[k] in WITHOUT_NOISE:
            return False
        usual = max(memory.noisiest[kind, k], limits.noise[k], limits.resolution[k])
        if NAMES[k] not in constancy.LIVE and limits.noise[k] == 0.0:
            # Counts follow the motion, whose curvature is no noise.
            return False
        least = memory.quietest[kind, k]
        loud = noise > NOISE_FACTOR * usual
        faint = least > 2.0 * limits.resolution[k] and noise < FAINT_FACTOR * least
        for is_so, hops, since in (
            (loud, memory.loud, memory.loud_since),
            (faint, memory.faint, memory.faint_since),
        ):
            hops[k] = hops[k] + 1.0 if is_so else 0.0
            if hops[k] == 1.0:
                since[k] = end - HOP_S
            if hops[k] >= NOISE_HOPS:
                told = (
                    f"noise of {NAMES[k]} is {figure(NAMES[k], noise)} rms for {hops[k] * HOP_S:g} s, "
                    f"it was {figure(NAMES[k], least)} to {figure(NAMES[k], usual)}"
                )
                self._fail(k, "noisy", float(since[k]), end, noise / max(usual, 1e-300), told, failing)
        return bool(loud or faint)

    def _absent(self, k: int, time: Array, there: NDArray[np.bool_], end: float, failing: set[int]) -> None:
        """Gaps of a channel that was there."""
        memory, name = self.memory, NAMES[k]
        memory.absent_s[k] *= np.exp(-HOP_S / LOST_WINDOW_S)
        if there.all() and np.isnan(memory.absent_since[k]):
            return
        edges = np.diff(np.concatenate(([False], ~there, [False])).astype(np.int8))
        begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        if not np.isnan(memory.absent_since[k]) and there[0]:
            begins, ends = np.concatenate(([0], begins)), np.concatenate(([0], ends))
        sparse = memory.present[k] < SPARSE_SHARE * memory.rows[k] and np.isnan(memory.failed_since[k])
        for b, e in zip(begins, ends, strict=True):
            carried = b == 0 and not np.isnan(memory.absent_since[k])
            since = float(memory.absent_since[k]) if carried else float(time[b])
            until = float(time[e]) if e < time.size else None
            in_hop = (end if until is None else until) - (max(since, end - HOP_S))
            if memory.absent_s[k] < 1e-2:
                memory.absent_first[k] = since
            memory.absent_s[k] += max(in_hop, 0.0)
            memory.absent_since[k] = np.nan if until is not None else since
            length = (end if until is None else until) - since
            told = f"{name} has no value for {length:.2f} s"
            if length < LONG_GAP_S or sparse:
                continue
            if until is None:
                self._fail(k, "dropout", since, end, length, told, failing)
            elif np.isnan(memory.failed_since[k]):
                self.ledger.report(name, "dropout", since, until, end, length, told)
        if memory.absent_s[k] > LOST_SHARE * LOST_WINDOW_S and not sparse and k not in failing:
            lost, began = float(memory.absent_s[k]), float(memory.absent_first[k])
            told = f"{name} has no value for {lost:.1f} s of the last {LOST_WINDOW_S:g} s, in bursts"
            self.ledger.report(name, "dropout", began, end, end, lost, told, adds=False)

    def _recover(self, end: float, failing: set[int]) -> None:
        """Trust again what had no complaint for some hops; the clean time counts from the first of them."""
        memory = self.memory
        for k in np.flatnonzero(~np.isnan(memory.failed_since)).tolist():
            lasting = memory.biased[k] != 0.0 or self._still_silent(k)
            if k in failing or lasting or not np.isnan(memory.absent_since[k]):
                memory.good[k] = 0.0
                continue
            memory.good[k] += 1.0
            if memory.good[k] >= GOOD_HOPS:
                memory.failed_since[k], memory.good[k] = np.nan, 0.0
                self.ledger.close(NAMES[k], end - GOOD_HOPS * HOP_S)

    def _still_silent(self, k: int) -> bool:
        """Whether the value of the failure still stands."""
        return bool(self.memory.run_since[k] <= self.memory.failed_since[k] + SAME_INSTANT_S)
