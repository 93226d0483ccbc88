"""The verdict on a frame of half a second: each channel held against its limits and its own past."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors import constancy
from fdd.sensors.finding import Kind
from fdd.sensors.jumping import JumpWatch, Rows, swept_volume
from fdd.sensors.limits import INDEX, IS_LIVE, NAMES, Limits, beyond_relief, figure
from fdd.sensors.memory import MOVING, STILL, Memory
from fdd.sensors.noise import smallest
from fdd.sensors.scan import FRAME_S, LOST_WINDOW_S, Scan
from fdd.sensors.sensor_findings import SAME_INSTANT_S, SensorFindings
from fdd.sensors.supply import SupplyWatch

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BURST_S = 1.0
"""s: a value that stays constant for less is a loose contact's; a sensor that fails stays failed."""
NOISE_FACTOR, NOISE_FRAMES = 5.0, 4
"""Ratio of noise to its largest healthy value, and frames in a row, that make a fault. A frame's noise, from
some 500 second differences, has a relative standard deviation of a tenth: a factor of five is no chance."""
FAINT_FACTOR = 0.1
WITHOUT_NOISE = ("oil_temperature", "motor_current")
"""Channels whose noise is not judged: a slow one shows it too seldom, and a current's is the drive's as
well."""
SHOWS_NOISE = np.array([n not in WITHOUT_NOISE for n in NAMES])
GOOD_FRAMES = 2
"""Frames in a row without a failure after which a channel is trusted again."""
POSITION = INDEX["position"]


class FrameJudge:
    """Judge frame after frame.

    Parameters
    ----------
    limits : of the unit. memory : what is kept. findings : where they go.
    """

    def __init__(self, limits: Limits, memory: Memory, findings: SensorFindings) -> None:
        self.limits, self.memory, self.findings = limits, memory, findings
        self._jumps = JumpWatch(limits, memory, findings)
        self._supply = SupplyWatch(limits, memory, findings)

    def judge(self, time: Array, values: Array, first: int, impossible: Mask, end: float) -> None:
        """Judge rows ``first:``; those before are the tail of the frame before.

        Parameters
        ----------
        time : (n,) s. values : (12, n). impossible : (12, m) of this frame's, what `impossible_rows` took
            out.
        end : s, of the frame.
        """
        memory = self.memory
        swept = swept_volume(time, values, self.limits, memory)
        turned = float(np.abs(np.diff(swept[first:])).sum() / self.limits.displacement)
        kind = MOVING if turned > 2.0 * np.pi else STILL
        frame = Scan.of(time, values, first, kind, end, self.limits, memory)
        rows = Rows(time, values, frame.noise, swept)
        failing = np.zeros(len(NAMES), np.bool_)
        self._absent(frame, end, failing)
        odd = self._constant(frame, kind, end, failing)
        self._standing(frame, rows, first, end, failing)
        odd |= failing
        beyond = (
            frame.measured & ((frame.least < self.limits.low) | (frame.most > self.limits.high)) & ~failing
        )
        for k in np.flatnonzero(beyond).tolist():
            odd[k] |= self._range(k, time[first:], values[k, first:], impossible[k], end, failing)
        odd |= self._noise(frame, kind, end, failing)
        if kind == MOVING:
            memory.excited[frame.measured] = np.where(frame.whole, memory.excited + 1.0, 0.0)[frame.measured]
        self._learn(frame, kind, frame.measured & ~odd & ~failing & np.isnan(memory.failed_since))
        self._jumps.judge(rows, frame.seen, end - FRAME_S, end, failing)
        self._supply.silent_from_start(end, failing)
        self._supply.lost_together(end, failing)
        self._recover(end, failing)

    def _learn(self, frame: Scan, kind: int, good: Mask) -> None:
        """Learn the range of healthy behaviour from good channels: repeated rows, and noise."""
        memory = self.memory
        # The expected longest run of N rows is about ln N / ln(1/p).
        by_run = np.maximum(memory.present, 1.0) ** (-1.0 / np.maximum(frame.longest, 1.0))
        by_run[memory.present < 2.0] = 0.0
        for kept, shown in (
            (memory.repeat, frame.repeated),
            (memory.repeat, by_run),
            (memory.noisiest, frame.noise),
        ):
            np.maximum(kept[kind], shown, out=kept[kind], where=good)
        np.minimum(memory.quietest[kind], frame.noise, out=memory.quietest[kind], where=good)
        memory.frames[kind] += good

    def _fail(
        self, k: int, kind: Kind, onset: float, now: float, size: float, evidence: str, failing: Mask
    ) -> None:
        """A lasting failure: reported, and the channel is not trusted from now on."""
        failing[k] = True
        if np.isnan(self.memory.failed_since[k]):
            self.memory.failed_since[k] = onset
            self.findings.was_slip(NAMES[k], onset, kind, size, evidence)
            self.findings.report(NAMES[k], kind, onset, None, now, size, evidence, adds=False)

    def _absent(self, frame: Scan, end: float, failing: Mask) -> None:
        """Gaps of channels that were there: long ones, and many short ones."""
        memory = self.memory
        for channel, since, until in frame.gaps.tolist():
            k = int(channel)
            length = (end if np.isnan(until) else until) - since
            message = f"{NAMES[k]} has no value for {length:.2f} s"
            if np.isnan(until):
                self._fail(k, "dropout", since, end, length, message, failing)
            elif np.isnan(memory.failed_since[k]):
                self.findings.report(NAMES[k], "dropout", since, until, end, length, message)
        for k in np.flatnonzero(frame.bursts & ~failing).tolist():
            lost, began = float(memory.absent_s[k]), float(memory.absent_first[k])
            message = f"{NAMES[k]} has no value for {lost:.1f} s of the last {LOST_WINDOW_S:g} s, in bursts"
            self.findings.report(NAMES[k], "dropout", began, end, end, lost, message, adds=False)

    def _constant(self, frame: Scan, kind: int, end: float, failing: Mask) -> Mask:
        """Runs of one value that are too long; (12,) which channels had some."""
        memory, limits = self.memory, self.limits
        held = np.zeros(len(NAMES), np.bool_)
        for channel, value, since, until, rows in frame.runs.tolist():
            k = int(channel)
            name, held[k] = NAMES[k], True
            length = (end if np.isnan(until) else until) - since
            message = f"{name} shows exactly {figure(name, value)} in {rows:.0f} rows, {length:.2f} s"
            if beyond_relief(k, value, limits) and length < BURST_S:
                if not np.isnan(until):
                    self.findings.report(
                        name, "clipped", since, until, end, length, f"{message}: its range's end"
                    )
                continue
            if not np.isnan(until) and since == memory.failed_since[k]:
                # The end of a run already reported; if short, it was a loose contact.
                if length < BURST_S:
                    memory.held_until[k] = until + LOST_WINDOW_S
                    self.findings.rename(name, since, "dropout", length)
                continue
            if not np.isnan(until):
                memory.held_until[k] = until + LOST_WINDOW_S
                self.findings.report(name, "dropout", since, until, end, length, f"{message}, then goes on")
                continue
            if memory.held_until[k] > since:
                self._fail(k, "dropout", since, end, length, message, failing)
                continue
            reach = limits.resolution[k]
            dead = abs(value) <= reach or abs(value - limits.dead[k]) <= reach
            beyond = not limits.low[k] <= value <= limits.high[k]
            if value >= limits.rail[k] - reach or (beyond and not dead):
                self._fail(k, "saturated", since, end, value, f"{message}: the end of its range", failing)
            elif dead:
                self._fail(k, "dead", since, end, value, f"{message}: no signal", failing)
            else:
                need = constancy.rows_needed(k, kind, memory, limits)
                why = (
                    f"its noise lets it repeat for at most {need:.0f} rows" if memory.changed[k]
                    else "though the pump turns"
                )  # fmt: skip
                self._fail(k, "stuck", since, end, value, f"{message}; {why}", failing)
        return held

    def _standing(self, frame: Scan, rows: Rows, first: int, end: float, failing: Mask) -> None:
        """A position that stays constant while the pump turns."""
        memory, limits, pressure = self.memory, self.limits, rows.difference()
        if failing[POSITION] or not frame.measured[POSITION] or not rows.swept.size or pressure is None:
            return
        since, value = float(memory.run_since[POSITION]), float(memory.run_value[POSITION])
        # From the last row of the frame before, so that no step of the angle is lost.
        begin = max(first - 1, 0)
        if constancy.standing_position(
            rows.time, rows.values[POSITION], rows.swept, pressure, begin, memory, limits
        ):
            volume = memory.volume[2] - memory.volume[1]
            message = (
                f"position stands at {1e3 * value:.3f} mm while the pump displaces "
                f"{1e6 * volume:.1f} cm³, {1e3 * volume / limits.area:.1f} mm of travel"
            )
            self._fail(POSITION, "dead" if value == 0.0 else "stuck", since, end, value, message, failing)

    def _range(self, k: int, time: Array, values: Array, impossible: Mask, end: float, failing: Mask) -> bool:
        """Values beyond the limits: most of a frame's, or single rows that were taken out."""
        low, high, name = self.limits.low[k], self.limits.high[k], NAMES[k]
        beyond = (values < low) | (values > high)
        known = values[~np.isnan(values)]
        middle = smallest(known, known.size // 2)
        if not low <= middle <= high:
            message = (
                f"{name} is {figure(name, middle)} (median of {FRAME_S:g} s), beyond what the unit can "
                f"reach, {figure(name, low)} to {figure(name, high)}"
            )
            self._fail(k, "out_of_range", float(time[np.argmax(beyond)]), end, middle, message, failing)
            return True
        wild = np.flatnonzero(beyond & impossible)
        if wild.size:
            worst = float(values[wild][np.argmax(np.abs(values[wild]))])
            message = f"single rows of {name} are impossible, the first {figure(name, worst)}"
            self.findings.report(
                name, "spikes", float(time[wild[0]]), float(time[wild[-1]]), end, float(wild.size), message,
                count=int(wild.size),
            )  # fmt: skip
        return bool(wild.size)

    def _noise(self, frame: Scan, kind: int, end: float, failing: Mask) -> Mask:
        """Noise far beyond or below what it was; (12,) where it is."""
        memory, limits, noise = self.memory, self.limits, frame.noise
        # Counts follow the motion, whose curvature is no noise.
        judged = frame.measured & ~failing & SHOWS_NOISE & (IS_LIVE | (limits.noise > 0.0))
        judged &= memory.frames[kind] >= constancy.LEARNT_FRAMES
        usual = np.maximum(np.maximum(memory.noisiest[kind], limits.noise), limits.resolution)
        least = memory.quietest[kind]
        loud = judged & (noise > NOISE_FACTOR * usual)
        faint = judged & (least > 2.0 * limits.resolution) & (noise < FAINT_FACTOR * least)
        for is_so, frames, begun in (
            (loud, memory.loud, memory.loud_since),
            (faint, memory.faint, memory.faint_since),
        ):
            frames[judged] = np.where(is_so, frames + 1.0, 0.0)[judged]
            for k in np.flatnonzero(is_so).tolist():
                if frames[k] == 1.0:
                    begun[k] = end - FRAME_S
                if frames[k] >= NOISE_FRAMES:
                    message = (
                        f"noise of {NAMES[k]} is {figure(NAMES[k], noise[k])} rms for "
                        f"{frames[k] * FRAME_S:g} s, "
                        f"it was {figure(NAMES[k], least[k])} to {figure(NAMES[k], usual[k])}"
                    )
                    size = float(noise[k] / max(usual[k], 1e-300))
                    self._fail(k, "noisy", float(begun[k]), end, size, message, failing)
        return np.asarray(loud | faint)

    def _recover(self, end: float, failing: Mask) -> None:
        """Trust channels again after `GOOD_FRAMES` without a failure; they count as good from the first of
        these."""
        memory = self.memory
        for k in np.flatnonzero(~np.isnan(memory.failed_since)).tolist():
            lasting = memory.biased[k] != 0.0 or self._still_silent(k)
            if failing[k] or lasting or not np.isnan(memory.absent_since[k]):
                memory.good[k] = 0.0
                continue
            memory.good[k] += 1.0
            if memory.good[k] >= GOOD_FRAMES:
                memory.failed_since[k], memory.good[k] = np.nan, 0.0
                self.findings.close(NAMES[k], end - GOOD_FRAMES * FRAME_S)

    def _still_silent(self, k: int) -> bool:
        """Whether the channel still shows the value of its failure."""
        return bool(self.memory.run_since[k] <= self.memory.failed_since[k] + SAME_INSTANT_S)
