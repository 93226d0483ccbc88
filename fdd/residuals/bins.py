"""From samples to bins of 10 ms: every channel through one and the same linear filter.

A balance is linear, so it holds between means over bins of 10 ms as well as between samples. All channels are
averaged over the same samples of a bin (those at which every channel that is there has a value), so that
neither a missing value nor jitter shifts one against another. Bins lie on an absolute grid of time: the
result does not depend on how a log was cut, nor on its first bin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from fdd.measures import ATMOSPHERE_PA
from fdd.residuals.compiled import Array, Flags, Indices, follow, friction, windowed_means
from fdd.residuals.oil import DRAINS, sure_mean_pressure, viscosity_ratio
from fdd.restorable import Restorable
from fdd.samples import Samples
from fdd.unit import Unit

BIN_S = 0.01
"""s, length of a bin."""
FRAME_BINS = 50
"""Bins in a frame, the step in which evidence is gathered."""
FRAME_S = BIN_S * FRAME_BINS
BLOCK_FRAMES = 4
"""Frames of a block whose errors may be correlated: 2 s."""
TAIL_BINS = 50
"""Bins before a frame that its filters and validity rules may look back at."""
PRESLIDING_TRAVEL_M = 5e-4
"""m, presliding travel of a seal: elastomer seals give 0.1 to 0.5 mm before they slide."""
GAS_S = 6.0
"""s in which an accumulator's gas takes its shell's temperature: 2 to 20 s for 0.1 to 5 l (Pourmovahed and
Otis 1990, doi 10.1115/1.2894128)."""
WARMING_S = (10.0, 60.0)
"""s over which two means of the oil's temperature are taken, whose difference is its rate."""

PAUSE_S = 30.0
"""s without samples from which there are no frames: a week of short runs costs no more than the runs."""
STOP_S = 600.0
"""s of a pause after which an axis counts as started anew: its oil has cooled, or another has flown it."""

FAST = (
    "command", "pump_angle", "pump_speed", "position", "pressure_difference", "pressure_1", "pressure_2",
    "pressure_accumulator", "motor_current", "load_force",
)  # fmt: skip
DERIVED = (
    "friction", "sliding", "temperature", "time", "gas_heat", "warming", "mean_pressure", "windowed_current",
)  # fmt: skip
NOISY = ("pressure_difference", "pressure_1", "pressure_2")
COLUMNS = {name: i for i, name in enumerate((*FAST, *DERIVED, *(f"{n}_noise" for n in NOISY)))}
NOISE_FRAMES, LEAST_SAMPLES = 20, 20
"""Frames whose noise is kept; fewest samples of a frame that it is estimated from."""
NOISE_HZ = (80.0, 140.0)
"""Hz, where a pressure's noise exceeds its motion, in the transducer's band (150 Hz: thesis Appendix A)."""
NOISE_SHARE = (0.6, 0.95)
"""The same as shares of the Nyquist frequency, for low sampling rates."""
DENSITY_SPREAD = 0.88
"""Relative std of a noise by the median of n frequencies of a windowed periodogram, times √n (simulated)."""
_ANGLES = np.radians(np.arange(0.0, 180.0, 30.0))
MIXED = np.array([np.cos(_ANGLES), np.sin(_ANGLES)])
"""Combinations of two pressures, each over its sensor's noise, that have the noise of one."""
ALONE = [0, 1, 1 + _ANGLES.size // 2]
"""Where `NOISY` stand by themselves among Δp and the `MIXED`."""
RINGS = 1.5
"""Noise by itself over that of the best combination, from which it is ringing: so far the ratio of two
sensors' noise is known, as it was identified below the band."""
LOWER_QUARTILE = np.array(
    [0.0, *(-NormalDist().inv_cdf((n // 4 + 0.6) / (n + 0.2)) for n in range(1, NOISE_FRAMES + 1))]
)
"""Standard deviations by which the lower quartile of n normal values lies below their mean, by Cunnane's
plotting positions (1978, doi 10.1016/0022-1694(78)90017-3)."""


class BinMaker(Restorable):
    """Samples in, bins of complete frames out.

    Parameters
    ----------
    unit : its sensors' zeros and gains are taken out. together : frames that are given at a time.

    Attributes
    ----------
    frame : index of the first frame not yet given. jumps : begin, end and decision (s) of the position's
        jumps, as `fdd.sensors.SensorWatch.take_jumps` gives them: no piston moved there.
    """

    STATE = ("frame", "_first", "jumps", "_waiting", "_memory")

    def __init__(self, unit: Unit, together: int = 1) -> None:
        self.unit, self.together = unit, together
        self.frame, self._first = -1, 0
        self.jumps: list[tuple[float, float, float]] = []
        self._waiting: list[Samples] = []
        self._memory = {
            "seal": np.zeros(2),  # of `friction`
            "last": np.full(2, np.nan),  # time and position that it goes on from
            "turned": np.full(3, np.nan),  # time, angle and speed that the pump's missing signal goes on from
            "celsius": np.full(1, np.nan),  # as last known: it changes slowly, and is measured seldom
            "lags": np.full(1 + len(WARMING_S), np.nan),  # ln Pa of the gas's mean, °C of the oil's two means
            "noise": np.full((NOISE_FRAMES, 1 + _ANGLES.size), np.nan),  # by `_root_density`
            "hidden": np.tile([np.nan, 0.0, np.nan], (len(DRAINS), 1)),  # of `sure_mean_pressure`
            "tank": np.full(1, np.nan),  # Pa, the accumulator's pressure as last known
        }

    def push(self, samples: Samples | None) -> tuple[int, Array]:
        """Index of the first, and bins (frames * FRAME_BINS, len(COLUMNS)), of the frames that the next block
        completes, `together` at a time; NaN where a bin has no data. None closes the log: what waits is given
        as a last frame."""
        if samples is not None and len(samples):
            if self.frame < 0:
                self.frame = self._first = int(np.floor(samples.time[0] / FRAME_S + 1e-9))
            self._waiting.append(samples)
        complete = self._complete()
        if samples is None:
            return self._given(complete + bool(self._waiting))
        return self._given(complete - (complete - self._first) % self.together)

    def stretches(self, samples: Samples) -> Iterator[tuple[int, Array]]:
        """What `push` gives for the samples between pauses; before a pause, all that waits."""
        before = self._waiting[-1].time[-1] if self._waiting else np.nan
        starts = np.flatnonzero(np.diff(samples.time, prepend=before) > PAUSE_S).tolist()
        for a, b in pairwise(sorted({0, *starts, len(samples)})):
            if a in starts:
                yield self.push(None)
                self.frame = -1
                self._memory["hidden"][:, 0] = np.nan  # meanwhile the case drain has let the mean down
            yield self.push(samples.rows(a, b))

    def rest(self) -> tuple[int, Array]:
        """Bins of all complete frames that wait; `push` goes on in the same steps as without."""
        return self._given(self._complete())

    def _complete(self) -> int:
        """Index of the first frame that is not complete."""
        if not self._waiting:
            return self.frame
        return int(np.floor(float(self._waiting[-1].time[-1]) / FRAME_S + 1e-9))

    def _given(self, until: int) -> tuple[int, Array]:
        first = self.frame
        if until <= first:
            return first, np.empty((0, len(COLUMNS)))
        joined = Samples.concatenate(self._waiting)
        cut = int(np.searchsorted(joined.time, until * FRAME_S - 1e-9 * FRAME_S))
        rest = joined.rows(cut, len(joined))
        self._waiting = [rest] if len(rest) else []
        self.frame = until
        bins = self._bins(joined.rows(0, cut), first, until)
        self.jumps = [jump for jump in self.jumps if jump[1] >= until * FRAME_S]
        return first, bins

    def state(self) -> dict[str, Array]:
        """See `Restorable`; what waits is joined, as it is often many rows by themselves."""
        self._waiting = [Samples.concatenate(self._waiting)] if self._waiting else []
        return super().state()

    def _bins(self, samples: Samples, first: int, until: int) -> Array:
        n = len(samples)
        out = np.full(((until - first) * FRAME_BINS, len(COLUMNS)), np.nan)
        if not n:
            return out
        data = np.full((n, len(COLUMNS)), np.nan)
        data[:, COLUMNS["time"]] = samples.time
        for name in FAST:
            if name in samples.channels:
                sensor = self.unit.sensor(name)
                data[:, COLUMNS[name]] = (samples[name] - sensor.zero) / sensor.gain
        self._turn(data)
        self._friction_reference(data)
        bin_of = np.floor(samples.time / BIN_S + 1e-7).astype(np.int64) - first * FRAME_BINS
        bin_of = np.clip(bin_of, 0, out.shape[0] - 1)
        # A channel counts in a frame where it has values at all; then only samples with all of them are
        # taken.
        frame = bin_of // FRAME_BINS
        starts = np.flatnonzero(np.diff(frame, prepend=-1))
        angle, speed = data[:, COLUMNS["pump_angle"]], data[:, COLUMNS["pump_speed"]]
        for a, b in pairwise([*starts.tolist(), n]):
            # Within the frame, so that it does not matter what came in the same block.
            if b - a > 2 and np.isnan(speed[a:b]).all():
                speed[a:b] = np.gradient(angle[a:b], samples.time[a:b])
        fast = np.isfinite(data[:, : len(FAST)])
        lengths = np.diff(starts, append=n)
        # What comes less than once in a bin is not waited for: it has a value in the bins where it comes.
        bins = np.add.reduceat(np.diff(bin_of, prepend=-1) > 0, starts)
        there = np.add.reduceat(fast, starts, axis=0) >= 0.9 * bins[:, None]
        dense = np.repeat(there, lengths, axis=0)
        complete = (fast | ~dense).all(axis=1)
        if complete.any():
            taken = data[complete]
            where = bin_of[complete]
            begin = np.flatnonzero(np.diff(where, prepend=-1))
            rows = np.diff(begin, append=where.size).astype(np.float64)
            out[where[begin]] = np.add.reduceat(taken, begin, axis=0) / rows[:, None]
            self._pressure_noise(taken, where // FRAME_BINS, where[begin], rows, out)
            seldom = fast & ~dense
            for k in np.flatnonzero(seldom.any(axis=0)):
                mine = np.flatnonzero(seldom[:, k])
                out[bin_of[mine], k] = data[mine, k]
        windowed_means(
            samples.time, data[:, COLUMNS["motor_current"]], bin_of,
            (first * FRAME_BINS, BIN_S, FRAME_BINS), out[:, COLUMNS["windowed_current"]],
        )  # fmt: skip
        if "oil_temperature" in samples.channels:  # slow, and comes when it likes
            celsius = samples["oil_temperature"]
            known = np.isfinite(celsius)
            count = np.bincount(frame[known], minlength=until - first)
            total = np.bincount(frame[known], celsius[known], minlength=until - first)
            with np.errstate(invalid="ignore"):
                means = held_on(total / count, self._memory["celsius"][0])
            self._memory["celsius"] = means[-1:].copy()
            out[:, COLUMNS["temperature"]] = np.repeat(means, FRAME_BINS)
        for begins, ends, decided in self.jumps:
            # What is decided later must not matter, though this block may reach as far.
            if decided <= until * FRAME_S + 1e-9:
                at, last = (int(np.floor(t / BIN_S)) - first * FRAME_BINS for t in (begins, ends))
                out[max(at - 1, 0) : max(last + 2, 0), COLUMNS["position"]] = np.nan
        self._heat(out)
        self._chambers(out)
        return out

    def _chambers(self, bins: Array) -> None:
        """Fill the chambers' mean pressure by their difference, for logs that measure no more."""
        accumulator, celsius = (bins[:, COLUMNS[n]] for n in ("pressure_accumulator", "temperature"))
        tank = held_on(accumulator, self._memory["tank"][0])
        self._memory["tank"] = tank[-1:].copy()
        warm = np.where(np.isfinite(celsius), celsius, self.unit.oil.reference_temperature)
        bins[:, COLUMNS["mean_pressure"]] = sure_mean_pressure(
            bins[:, COLUMNS["pressure_difference"]], bins[:, COLUMNS["position"]], BIN_S, self.unit, tank,
            noise=bins[:, COLUMNS["pressure_difference_noise"]],
            viscosity=viscosity_ratio(self.unit.oil, warm), states=self._memory["hidden"],
        )  # fmt: skip

    def _heat(self, bins: Array) -> None:
        """Fill what the accumulator's gas has of the work done on it (ln Pa), and the oil's warming (K/s)."""
        pressure = bins[:, COLUMNS["pressure_accumulator"]] + ATMOSPHERE_PA
        known = np.log(np.where(pressure > 0.0, pressure, np.nan))
        slow, warm = np.empty((len(bins), 1)), np.empty((len(bins), len(WARMING_S)))
        lags = self._memory["lags"]
        follow(known, lags[:1], np.array([BIN_S / GAS_S]), slow)
        follow(bins[:, COLUMNS["temperature"]], lags[1:], BIN_S / np.array(WARMING_S), warm)
        bins[:, COLUMNS["gas_heat"]] = known - slow[:, 0]
        rate = (warm[:, 0] - warm[:, 1]) / (WARMING_S[1] - WARMING_S[0])
        bins[:, COLUMNS["warming"]] = np.nan_to_num(rate)

    def _pressure_noise(self, taken: Array, frame: Indices, bins: Indices, count: Array, out: Array) -> None:
        """Fill the noise (standard deviation, Pa) that the mean of a bin's samples has, at this log's rate.

        A mean over T takes a band of 1/(2T) of the noise's spectral density. Motion only adds to that of a
        frame, so the lower quartile of the last ten seconds' counts, less what chance alone puts it below. A
        piston that rings on its oil moves the chambers' pressures all the time, one against the other: their
        noise is in that combination of both that has least.
        """
        pressures = [COLUMNS[n] for n in NOISY]
        sensors = [self.unit.sensor(n) for n in NOISY[1:]]
        chambers = [math.hypot(s.noise, s.resolution / math.sqrt(12.0)) for s in sensors]
        own = np.array([1.0, *(chambers if all(chambers) else (1.0, 1.0))])
        frames, begin, rows = np.unique(frame, return_index=True, return_counts=True)
        first, last = (np.searchsorted(bins, (frames + k) * FRAME_BINS) for k in (0, 1))
        rate = np.array([np.median(count[a:b]) for a, b in zip(first, last, strict=True)]) / BIN_S
        density, frequencies = np.empty((frames.size, 1 + _ANGLES.size)), np.ones(frames.size)
        for n, each in np.unique(np.column_stack([rows, rate]), axis=0).tolist():
            band = _noise_band(int(n), each)
            mine = np.flatnonzero((rows == n) & (rate == each))
            frequencies[mine] = max(int(np.count_nonzero(band)), 1)
            if n >= LEAST_SAMPLES:
                samples = taken[begin[mine, None] + np.arange(int(n))][..., pressures] / own
                density[mine] = _root_density(samples, each, band)
        enough = rows >= LEAST_SAMPLES
        kept = np.concatenate([self._memory["noise"], density[enough]])
        self._memory["noise"] = kept[-NOISE_FRAMES:]
        windows = np.sort(np.lib.stride_tricks.sliding_window_view(kept, NOISE_FRAMES, axis=0), axis=2)
        windows = windows[np.cumsum(enough)]
        known = np.isfinite(windows).sum(axis=2)
        quiet = np.take_along_axis(windows, known[..., None] // 4, axis=2)[..., 0]
        chance = LOWER_QUARTILE[known] * DENSITY_SPREAD / np.sqrt(frequencies)[:, None]
        quiet = quiet / (1.0 - np.minimum(chance, 0.5))
        each, least = quiet[:, ALONE], quiet[:, 1:].min(axis=1, keepdims=True)
        each[:, 1:] = np.where(each[:, 1:] > RINGS * least, least, each[:, 1:])
        root = own * each * np.sqrt(0.5 * rate)[:, None]
        out[bins, -len(NOISY) :] = np.repeat(root, last - first, axis=0) / np.sqrt(count[:, None])

    def _turn(self, data: Array) -> None:
        """Where one of the pump's angle and speed is not there, make it from the other."""
        time, angle, speed = (data[:, COLUMNS[n]] for n in ("time", "pump_angle", "pump_speed"))
        before = self._memory["turned"]
        dt = np.diff(time, prepend=before[0] if np.isfinite(before[0]) else time[0])
        if np.isnan(angle).all() and np.isfinite(speed).any():
            held = np.where(np.isfinite(speed), speed, 0.0)
            mean = 0.5 * (held + np.concatenate([[np.nan_to_num(before[2], nan=held[0])], held[:-1]]))
            angle[:] = np.nan_to_num(before[1]) + np.cumsum(mean * dt)
        elif np.isnan(speed).all() and np.isfinite(angle).any():
            with np.errstate(divide="ignore", invalid="ignore"):
                speed[:] = np.diff(angle, prepend=before[1]) / dt
            if np.isnan(before[1]) and speed.size > 1:  # the log's first sample has none before it
                speed[0] = speed[1]
        self._memory["turned"] = np.array([time[-1], angle[-1], speed[-1]])

    def _friction_reference(self, data: Array) -> None:
        """Fill the friction that a healthy seal would give to the measured travel, at the samples' own rate.

        By the position, not by the pump: compression and leakage between the two are many times what a seal
        gives.
        """
        known = np.isfinite(data[:, COLUMNS["position"]])
        if not known.any():
            return
        time, position = data[known, COLUMNS["time"]], data[known, COLUMNS["position"]]
        last = self._memory["last"]
        before = last if np.isfinite(last[0]) else (time[0] - 1e-3, position[0])
        self._memory["last"] = np.array([time[-1], position[-1]])
        dt, step = np.diff(time, prepend=before[0]), np.diff(position, prepend=before[1])
        forward, reverse = (
            np.array([b.coulomb, b.static, b.stribeck_velocity, b.stribeck_exponent])
            for b in (self.unit.friction.forward, self.unit.friction.reverse)
        )
        out, film = np.empty(step.size), np.empty(step.size)
        stiffness = 0.5 * (forward[1] + reverse[1]) / PRESLIDING_TRAVEL_M
        friction(step, dt, self._memory["seal"], forward, reverse, stiffness, out, film)
        data[known, COLUMNS["friction"]], data[known, COLUMNS["sliding"]] = out, film


def held_on(values: Array, before: float) -> Array:
    """The value last known at each bin, (n,); `before` until the first."""
    latest = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), -1))
    return np.where(latest >= 0, values[latest], before)


def _noise_band(samples: int, rate: float) -> Flags:
    """Which frequencies of a periodogram show noise."""
    frequency = np.arange(samples // 2 + 1) * rate / samples
    low, high = (min(f, share * 0.5 * rate) for f, share in zip(NOISE_HZ, NOISE_SHARE, strict=True))
    return (frequency >= low) & (frequency <= high)


def _root_density(values: Array, rate: float, band: Flags) -> Array:
    """Root of a noise's spectral density (m, 1 + 6), per √Hz, at a rate (Hz), of the first of (m, n, 3)
    columns and of the others `MIXED`: the median of the periodogram's frequencies in a band, as the pump's
    pulses and the mains are lines."""
    window = np.hanning(values.shape[1])[:, None]
    spectrum = np.fft.rfft(window * (values - values.mean(axis=1, keepdims=True)), axis=1)[:, band]
    spectrum = np.concatenate([spectrum[..., :1], spectrum[..., 1:] @ MIXED], axis=2)
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    density = np.median(power, axis=1) / math.log(2.0)
    return np.asarray(np.sqrt(2.0 * density / (rate * np.sum(window**2))))
