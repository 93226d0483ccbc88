"""The verdict on a frame of half a second: each channel held against its limits and its own past."""

from __future__ import annotations

import numpy as np

from fdd.sensors.finding import MOVING, SAME_INSTANT_S, STILL, Kind, SensorFindings
from fdd.sensors.jumping import JumpWatch
from fdd.sensors.jumps import Rows, swept_volume
from fdd.sensors.limits import DIFFERENCE, IS_LIVE, IS_MEASURED, NAMES, POSITION, Array, Limits, Mask, figure
from fdd.sensors.scan import FRAME_S, LEARNT_FRAMES, LOST_WINDOW_S, Scan, rows_needed, scan, standing_position

BURST_S = 1.0
"""s: a value that stays constant for less is a loose contact's; a sensor that fails stays failed."""
NOISE_FACTOR, NOISE_FRAMES = 5.0, 4
"""Ratio of noise to its largest healthy value, and frames in a row, that make a fault. A frame's noise, from
some 500 second differences, has a relative standard deviation of a tenth: a factor of five is no chance."""
FAINT_FACTOR = 0.1
WITHOUT_NOISE = ("oil_temperature", "motor_current")
"""Channels whose noise is not judged: a slow one shows it seldom, a current's is the drive's too."""
SHOWS_NOISE = np.array([n not in WITHOUT_NOISE for n in NAMES])
GOOD_FRAMES = 2
"""Frames in a row without a failure after which a channel is trusted again."""
SILENT_S = 5.0
"""Noise that is there shows within some rows; this leaves time for a converter that starts late."""


class FrameJudge:
    """Judge frame after frame, by a unit's limits and by what `findings` keeps of the channels."""

    def __init__(self, limits: Limits, findings: SensorFindings) -> None:
        self.limits, self.findings = limits, findings
        self._jumps = JumpWatch(limits, findings)

    def judge(self, time: Array, values: Array, first: int, impossible: Mask, end: float) -> None:
        """Judge rows ``first:`` of `time` (n,) s and `values` (12, n), the frame's until `end` (s), after the
        tail of the one before; `impossible` (12, m) says what `impossible_rows` took."""
        memory, limits = self.findings.memory, self.limits
        self.findings.begin_frame(end)
        failing = self.findings.failing
        swept = swept_volume(time, values, limits, memory)
        turned = float(np.abs(np.diff(swept[first:])).sum() / limits.displacement)
        kind = MOVING if turned > 2.0 * np.pi else STILL
        frame = scan(time, values, first, kind, end, limits, memory)
        rows = Rows(time, values, frame.noise, swept)
        self._absent(frame, end)
        odd = self._constant(frame, kind, end)
        self._standing(frame, rows, first)
        odd |= failing
        beyond = frame.measured & ((frame.least < limits.low) | (frame.most > limits.high)) & ~failing
        for k in np.flatnonzero(beyond).tolist():
            odd[k] |= self._range(k, time[first:], values[k, first:], impossible[k])
        odd |= self._noise(frame, kind, end)
        if kind == MOVING:
            memory.excited[frame.measured] = np.where(frame.whole, memory.excited + 1.0, 0.0)[frame.measured]
        self._learn(frame, kind, frame.measured & ~odd & ~failing & np.isnan(memory.failed_since))
        self._jumps.judge(rows, frame.seen, end)
        own = np.ones(len(NAMES), np.bool_)
        own[DIFFERENCE] = memory.derived[0] != 1.0
        self._silent_from_start(end, own)
        self._lost_together(own)
        self._recover(end)

    def _learn(self, frame: Scan, kind: int, good: Mask) -> None:
        """Learn the range of healthy behaviour from good channels: repeated rows, and noise."""
        memory = self.findings.memory
        # The expected longest run of N rows is about ln N / ln(1/p).
        by_run = np.maximum(memory.present, 1.0) ** (-1.0 / np.maximum(frame.longest, 1.0))
        by_run[memory.present < 2.0] = 0.0
        repeat, noisiest, quietest = memory.repeat[kind], memory.noisiest[kind], memory.quietest[kind]
        for kept, shown in ((repeat, frame.repeated), (repeat, by_run), (noisiest, frame.noise)):
            np.maximum(kept, shown, out=kept, where=good)
        np.minimum(quietest, frame.noise, out=quietest, where=good)
        memory.frames[kind] += good

    def _absent(self, frame: Scan, end: float) -> None:
        """Gaps of channels that were there: long ones, and many short ones."""
        memory, found = self.findings.memory, self.findings
        for channel, since, until in frame.gaps.tolist():
            k = int(channel)
            length = (end if np.isnan(until) else until) - since
            message = f"{NAMES[k]} has no value for {length:.2f} s"
            if np.isnan(until):
                found.fail(k, "dropout", since, length, message)
            elif np.isnan(memory.failed_since[k]):
                found.report(k, "dropout", since, until, length, message)
        for k in np.flatnonzero(frame.bursts & ~found.failing).tolist():
            lost, began = float(memory.absent_s[k]), float(memory.absent_first[k])
            message = f"{NAMES[k]} has no value for {lost:.1f} s of the last {LOST_WINDOW_S:g} s, in bursts"
            found.report(k, "dropout", began, end, lost, message, adds=False)

    def _constant(self, frame: Scan, kind: int, end: float) -> Mask:
        """Runs of one value that are too long; (12,) which channels had some."""
        memory, limits, found = self.findings.memory, self.limits, self.findings
        held = np.zeros(len(NAMES), np.bool_)
        for channel, value, since, until, rows in frame.runs.tolist():
            k = int(channel)
            name, held[k] = NAMES[k], True
            over = not np.isnan(until)
            length = (until if over else end) - since
            message = f"{name} shows exactly {figure(name, value)} in {rows:.0f} rows, {length:.2f} s"
            # Sensors' ranges end where the relief valve opens, and a peak goes further for some milliseconds.
            peak = name.startswith("pressure") and limits.relief <= abs(value) <= limits.high[k]
            if peak and length < BURST_S:
                if over:
                    found.report(k, "clipped", since, until, length, f"{message}: its range's end")
                continue
            if over:
                known = since == memory.failed_since[k]  # the end of a run that was reported already
                if not known or length < BURST_S:
                    memory.held_until[k] = until + LOST_WINDOW_S
                if not known:
                    found.report(k, "dropout", since, until, length, f"{message}, then goes on")
                elif length < BURST_S:  # it was a loose contact
                    found.was_dropout(k, since, length)
                continue
            reach = limits.resolution[k]
            dead = abs(value) <= reach or abs(value - limits.dead[k]) <= reach
            beyond = not limits.low[k] <= value <= limits.high[k]
            if memory.held_until[k] > since:
                found.fail(k, "dropout", since, length, message)
            elif value >= limits.rail[k] - reach or (beyond and not dead):
                found.fail(k, "saturated", since, value, f"{message}: the end of its range")
            elif dead:
                found.fail(k, "dead", since, value, f"{message}: no signal")
            else:
                why = "though the pump turns"
                if memory.changed[k]:
                    need = rows_needed(k, kind, memory, limits)
                    why = f"its noise lets it repeat for at most {need:.0f} rows"
                found.fail(k, "stuck", since, value, f"{message}; {why}")
        return held

    def _standing(self, frame: Scan, rows: Rows, first: int) -> None:
        """A position that stays constant while the pump turns."""
        memory, limits, pressure = self.findings.memory, self.limits, rows.difference()
        failed = self.findings.failing[POSITION] or not frame.measured[POSITION]
        if failed or not rows.swept.size or pressure is None:
            return
        since, value = float(memory.run_since[POSITION]), float(memory.run_value[POSITION])
        # From the last row of the frame before, so that no step of the angle is lost.
        begin, position = max(first - 1, 0), rows.values[POSITION]
        if standing_position(rows.time, position, rows.swept, pressure, begin, memory, limits):
            volume = memory.volume[2] - memory.volume[1]
            message = (
                f"position stands at {1e3 * value:.3f} mm while the pump displaces "
                f"{1e6 * volume:.1f} cm³, {1e3 * volume / limits.area:.1f} mm of travel"
            )
            kind: Kind = "dead" if value == 0.0 else "stuck"
            self.findings.fail(POSITION, kind, since, value, message)

    def _range(self, k: int, time: Array, values: Array, impossible: Mask) -> bool:
        """Values beyond the limits: most of a frame's, or single rows that were taken out."""
        low, high, name = self.limits.low[k], self.limits.high[k], NAMES[k]
        beyond = (values < low) | (values > high)
        known = values[~np.isnan(values)]
        middle = float(np.partition(known, known.size // 2)[known.size // 2])
        if not low <= middle <= high:
            message = (
                f"{name} is {figure(name, middle)} (median of {FRAME_S:g} s), beyond what the unit can "
                f"reach, {figure(name, low)} to {figure(name, high)}"
            )
            self.findings.fail(k, "out_of_range", float(time[np.argmax(beyond)]), middle, message)
            return True
        wild = np.flatnonzero(beyond & impossible)
        if wild.size:
            worst = float(values[wild][np.argmax(np.abs(values[wild]))])
            message = f"single rows of {name} are impossible, the first {figure(name, worst)}"
            onset, until = float(time[wild[0]]), float(time[wild[-1]])
            self.findings.report(k, "spikes", onset, until, float(wild.size), message, count=int(wild.size))
        return bool(wild.size)

    def _noise(self, frame: Scan, kind: int, end: float) -> Mask:
        """Noise far beyond or below what it was; (12,) where it is."""
        memory, limits, noise = self.findings.memory, self.limits, frame.noise
        # Counts follow the motion, whose curvature is no noise.
        judged = frame.measured & ~self.findings.failing & SHOWS_NOISE & (IS_LIVE | (limits.noise > 0.0))
        judged &= memory.frames[kind] >= LEARNT_FRAMES
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
                    shown, low, high = (figure(NAMES[k], x) for x in (noise[k], least[k], usual[k]))
                    seconds = frames[k] * FRAME_S
                    message = f"noise of {NAMES[k]} is {shown} rms for {seconds:g} s, it was {low} to {high}"
                    size = float(noise[k] / max(usual[k], 1e-300))
                    self.findings.fail(k, "noisy", float(begun[k]), size, message)
        return np.asarray(loud | faint)

    def _silent_from_start(self, end: float, own: Mask) -> None:
        """Two or more channels that the profile gives noise, and none of them ever showed any.

        One alone may have a profile that is wrong; it is judged when the pump turns.
        """
        memory = self.findings.memory
        alive = (memory.present > 0) & (self.limits.repeat < 1.0) & own
        silent = alive & (memory.changed == 0.0) & (end - memory.run_since >= SILENT_S)
        if alive.sum() < 2 or not (silent == alive).all():
            return
        for k in np.flatnonzero(silent).tolist():
            since, value = float(memory.run_since[k]), float(memory.run_value[k])
            message = f"{NAMES[k]} shows exactly {figure(NAMES[k], value)} since the log's first row"
            self.findings.fail(k, "dead", since, value, message)

    def _lost_together(self, own: Mask) -> None:
        """A lost supply of channels that fell silent at the same instant."""
        memory, failing = self.findings.memory, self.findings.failing
        rests_at_0 = (memory.run_value == 0.0) & (np.abs(memory.last_value) > 0.0) & (memory.run_rows > 1)
        for k in np.flatnonzero(failing & own).tolist():
            onset = float(memory.failed_since[k])
            fell = failing & (np.abs(memory.failed_since - onset) <= SAME_INSTANT_S)
            fell |= rests_at_0 & (np.abs(memory.run_since - onset) <= SAME_INSTANT_S)
            silent = np.flatnonzero(fell & own & IS_MEASURED & (memory.present > 0)).tolist()
            names = {NAMES[j] for j in silent}
            known = any(
                f.kind == "supply_loss" and f.until_s is None and names <= set(f.channels)
                for f in self.findings.by_onset()
            )
            if len(silent) < 2 or known:
                continue
            failing[silent] = True
            late = [j for j in silent if np.isnan(memory.failed_since[j])]
            memory.failed_since[late] = onset
            together = f"{', '.join(NAMES[j] for j in silent)} fall silent within {1e3 * SAME_INSTANT_S:.0f}"
            self.findings.lose_supply(silent, onset, f"{together} ms: they lost their supply")

    def _recover(self, end: float) -> None:
        """Trust channels again after `GOOD_FRAMES` without a failure, from the first of these on."""
        memory = self.findings.memory
        for k in np.flatnonzero(~np.isnan(memory.failed_since)).tolist():
            # A silent one still shows the value of its failure.
            silent = memory.run_since[k] <= memory.failed_since[k] + SAME_INSTANT_S
            lasting = memory.biased[k] != 0.0 or silent or not np.isnan(memory.absent_since[k])
            if self.findings.failing[k] or lasting:
                memory.good[k] = 0.0
                continue
            memory.good[k] += 1.0
            if memory.good[k] >= GOOD_FRAMES:
                memory.failed_since[k], memory.good[k] = np.nan, 0.0
                self.findings.close(k, end - GOOD_FRAMES * FRAME_S)
