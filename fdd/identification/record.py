"""A log made even, every channel on the grid of the nominal period, gaps bridged and marked; and what it says
about its sensors: noise, resolution, and zeros that redundancy shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.identification import Array
from fdd.logs.channel_map import accumulate_speed
from fdd.logs.quality import sample_numbers
from fdd.residuals.oil import chambers_from_difference
from fdd.samples import PRESSURES, Samples, missing_required
from fdd.unit import Unit

SHORTEST = 5.0
"""s of log."""
LONGEST_GAP = 3
"""Rows that a straight line may bridge without a mark."""
MOST_ROWS = 5_000_000
"""Of one log: 80 minutes at 1 kHz, for which some 1.5 GB of memory are needed."""
NEEDED = ("position", "pump_angle", "pump_speed", "pressure_difference", "pressure_1", "pressure_2")
LEAST_SHARE, SLOWER = 0.01, 0.75
"""A channel with fewer values than this is empty; one with fewer than this times the others' is slower."""
LEAST_TRAVEL = 2e-3
"""m of travel, below which nothing about gain, leakage or friction can be said."""
STANDSTILL_SPEED = 0.02
"""Of the drive's largest speed: below it the pump counts as standing."""

SEGMENT = 0.5
"""s, over which a spectrum is taken."""
LOWEST_HZ, HIGHEST_HZ = 8.0, 100.0
"""Band in which the spectral density stands for the noise. Pressure sensors are limited to some 150 Hz
and carry tones above, so that differences of neighbouring samples would show too little; a filter
that follows the oil, which resonates below 100 Hz, needs the density there."""
QUIETEST = 0.25
"""Share of the segments that is taken for free of motion."""
SELECTION = 0.86
"""Mean of the lowest quarter over the mean of all, where half of the segments are free of motion: a
segment's band power scatters by 17 %, and the lower half of a normal distribution lies 0.8 deviations low."""
LEAST_STEPS = 50
LEAST_ZERO = 1.0
"""Pa; less means that the difference was computed from the chambers."""


@dataclass(frozen=True)
class Record:
    """One healthy log on an even grid; each channel (n,), SI, gauge, °C, without NaN."""

    period: float
    angle: Array
    position: Array
    pressure_1: Array
    pressure_2: Array
    accumulator: Array
    difference: Array
    """The differential sensor's where there is one."""
    gap: NDArray[np.bool_]
    """Rows that stand for missing ones, or next to a longer gap."""
    chambers_measured: bool
    """False where the chambers' pressures are reconstructed from their difference."""
    accumulator_measured: bool
    has_difference: bool
    current: Array | None
    temperature: Array | None
    command: Array | None = None
    load: Array | None = None
    angle_jumps: int = 0
    """Impossible jumps of the pump angle, marked as gaps."""

    def __len__(self) -> int:
        return int(self.position.size)

    def rows(self, seconds: float) -> int:
        """Rows in a time, at least one."""
        return max(round(seconds / self.period), 1)

    def smooth(self, values: Array, seconds: float) -> Array:
        """Mean over a window centred on each row: no phase."""
        return centred_mean(values, self.rows(seconds) | 1)

    def speeds(self, seconds: float) -> tuple[Array, Array]:
        """Velocity (m/s) and pump speed (rad/s), each averaged over `seconds`."""
        v = np.gradient(self.smooth(self.position, seconds), self.period)
        w = np.gradient(self.smooth(self.angle, seconds), self.period)
        return v, w

    @property
    def redundant(self) -> bool:
        """Whether both the chambers' pressures and their difference were measured."""
        return self.has_difference and self.chambers_measured

    def at_rest(self, unit: Unit) -> NDArray[np.bool_]:
        """(n,) rows in which neither pump nor piston moves."""
        v, w = self.speeds(0.1)
        slow_pump = STANDSTILL_SPEED * unit.drive.max_speed
        slow_piston = slow_pump * unit.pump.displacement / unit.cylinder.area_1
        return np.asarray((np.abs(w) < slow_pump) & (np.abs(v) < slow_piston) & ~self.gap)


def centred_mean(values: Array, width: int) -> Array:
    """Mean over `width` rows (odd) around each; beyond the ends the first and last value go on.

    Examples
    --------
    >>> centred_mean(np.array([0.0, 3.0, 6.0]), 3).tolist()
    [1.0, 3.0, 5.0]
    """
    half = width // 2
    padded = np.concatenate((np.full(half + 1, values[0]), values, np.full(half, values[-1])))
    level = float(values[0])  # sums of what is left keep their digits
    total = np.cumsum(padded - level)
    return np.asarray(level + (total[2 * half + 1 :] - total[: values.size]) / (2 * half + 1))


def measured_rows(log: Samples) -> Samples:
    """The rows in which all of motion and pressures was measured, where some of it comes at a slower rate.

    The oil's temperature, measured once a second or so, stands on the line between its values.
    """
    share = {c: float(np.isfinite(log[c]).mean()) for c in log.channels}
    if 0.0 < share.get("oil_temperature", 0.0) < 1.0:
        there = np.isfinite(log["oil_temperature"])
        warm = np.interp(log.time, log.time[there], log["oil_temperature"][there])
        log = log.with_columns({"oil_temperature": warm})
    needed = [c for c in NEEDED if share.get(c, 0.0) > LEAST_SHARE]
    shares = [share[c] for c in needed]
    if not needed or min(shares) > SLOWER * max(shares):
        return log
    keep = np.logical_and.reduce([np.isfinite(log[c]) for c in needed])
    return Samples(log.time[keep], {c: log[c][keep] for c in log.channels})


def even_record(log: Samples, unit: Unit, where: str) -> Record:
    """Check a healthy log, called `where` in errors, and lay it on an even grid.

    Where sensors are missing, accumulator and oil of the base profile `unit` stand in.

    Raises InputError: a channel is missing or empty, the log is shorter than 5 s, or nothing moves.
    """
    log = measured_rows(log)
    present = {c for c in log.channels if np.isfinite(log[c]).mean() > 0.2}
    if missing := missing_required(present):
        raise InputError(f"no usable data for {', '.join(missing)}", where=where, mend="map a column to each")
    if log.duration < SHORTEST:
        short = f"{log.duration:.1f} s long, at least {SHORTEST:.0f} s are needed"
        raise InputError(short, where=where, mend="record longer")
    period = float(np.median(np.diff(log.time)))
    numbers = sample_numbers(log.time, period)
    n = int(numbers[-1]) + 1
    if n > (most := min(MOST_ROWS, 20 * len(log) + 1000)):
        spread = f"{len(log)} rows spread over {n} periods of {period * 1e3:.3g} ms"
        mend = "cut the log, at its gaps if it has any, and give the parts"
        raise InputError(f"{spread}, at most {most} are used", where=where, mend=mend)
    gap = np.zeros(n, dtype=bool)
    grid = np.arange(n, dtype=np.float64)

    def even(values: Array, *, marks: bool = True) -> Array:
        there = np.isfinite(values)
        if marks:  # gaps longer than a straight line may bridge
            edges = np.concatenate(([-1], numbers[there], [n]))
            for k in np.flatnonzero(np.diff(edges) - 1 > LONGEST_GAP):
                gap[edges[k] + 1 : edges[k + 1]] = True
        return np.interp(grid, numbers[there], values[there])

    turned = "pump_angle" in present
    angle = even(log["pump_angle"] if turned else accumulate_speed(log.time, log["pump_speed"], period))
    position = even(log["position"])
    step = np.abs(np.diff(angle))
    # No pump makes such jumps.
    limit = 2.0 * max(unit.drive.max_speed * period, float(np.quantile(step, 0.99)))
    jumps = np.flatnonzero(step > limit)
    for row in jumps:
        gap[max(row - LONGEST_GAP, 0) : row + LONGEST_GAP + 2] = True
    dp, p1, p2, accumulator = (even(log[c]) if c in present else None for c in PRESSURES)
    # With one chamber and the difference the other one follows.
    if dp is not None and p1 is not None and p2 is None:
        p2 = p1 - dp
    elif dp is not None and p2 is not None and p1 is None:
        p1 = p2 + dp
    if measured_both := p1 is not None and p2 is not None:
        difference = p1 - p2 if dp is None else dp
        tank = _lower_chamber(p1, p2, period) if accumulator is None else accumulator
    else:
        assert dp is not None  # as `missing_required` has it
        smoothed = centred_mean(dp, max(round(0.025 / period), 1) | 1)
        known = np.full_like(position, np.nan) if accumulator is None else accumulator
        mean, tank = chambers_from_difference(smoothed, position, period, unit, known)
        difference, p1, p2 = dp, mean + 0.5 * dp, mean - 0.5 * dp

    def measured_if(channel: str) -> Array | None:
        return even(log[channel], marks=False) if channel in present else None

    record = Record(
        period=period, angle=angle, position=position, pressure_1=p1, pressure_2=p2,
        accumulator=tank if accumulator is None else accumulator, difference=difference, gap=gap,
        chambers_measured=measured_both, accumulator_measured=accumulator is not None,
        has_difference=dp is not None,
        current=measured_if("motor_current"), temperature=measured_if("oil_temperature"),
        command=measured_if("command"), load=measured_if("load_force"), angle_jumps=int(jumps.size),
    )  # fmt: skip
    travel = float(np.sum(np.abs(np.diff(record.smooth(position, 0.05)[:: record.rows(0.05)]))))
    reach, revolved = float(np.ptp(position)), float(np.ptp(angle))
    if reach < LEAST_TRAVEL or travel < 2.0 * LEAST_TRAVEL:
        mend = "identify from a log with strokes, or check the position's unit of measure"
        raise InputError(f"the cylinder moves by {reach * 1e3:.3g} mm only", where=where, mend=mend)
    if revolved < 1.0:
        problem = f"the pump turns by {revolved:.2g} rad only"
        raise InputError(problem, where=where, mend="check the pump channel's unit")
    return record


def _lower_chamber(p1: Array, p2: Array, period: float) -> Array:
    """Stand-in for the accumulator, below which a refeeding valve holds the lower chamber: its low level.

    Where both chambers are above the accumulator it is too high, and so only more careful.
    """
    from scipy.ndimage import percentile_filter  # half a second to import, where it is not needed

    block = max(round(0.1 / period), 1) | 1
    lower = np.minimum(centred_mean(p1, block), centred_mean(p2, block))
    coarse = lower[block // 2 :: block]
    low = percentile_filter(coarse, 25, size=min(41, coarse.size), mode="nearest")
    return np.interp(np.arange(p1.size), block // 2 + block * np.arange(coarse.size), low)


def effective_noise(values: Array, period: float) -> float | None:
    """White noise (standard deviation) with the spectral density that the channel, a row per `period` (s),
    has below 100 Hz; None where there are fewer than four segments.

    ``sqrt(mean PSD over 8 to 100 Hz · f_s/2)``, in the quietest quarter of half-second segments.
    """
    length = round(SEGMENT / period)
    count = values.size // max(length, 1)
    if length < 64 or count < 4:
        return None
    frequency, density = welch(values[: count * length].reshape(count, length), period, length // 2)
    band = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
    power = np.sort(density[:, band].mean(axis=1))[: max(int(QUIETEST * count), 1)]
    return float(np.sqrt(power.mean() / SELECTION * 0.5 / period))


def welch(segments: Array, period: float, length: int) -> tuple[Array, Array]:
    """Frequencies (Hz) and one-sided power spectral densities of segments (k, n), by Welch's method (1967,
    doi 10.1109/TAU.1967.1161901): parts of a length that overlap by half, without their straight lines, in
    Hann's window. `scipy.signal.welch` gives the same; importing it takes as long as diagnosing a log.
    """
    parts = np.lib.stride_tricks.sliding_window_view(segments, length, axis=1)[:, :: length - length // 2]
    line = np.column_stack([np.ones(length), np.arange(length) - 0.5 * (length - 1)])
    straight = line @ np.linalg.pinv(line)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    power = np.square(np.abs(np.fft.rfft((parts - parts @ straight) * window))).mean(axis=1)
    power[:, 1 : (length + 1) // 2] *= 2.0  # but for the mean and the highest frequency
    density: Array = power * (period / np.sum(window**2))
    return np.asarray(np.fft.rfftfreq(length, period), dtype=np.float64), density


def resolution(values: Array) -> float | None:
    """Quantum of a channel: the step of which all steps are multiples; None for a smooth channel."""
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    span = float(np.ptp(known)) if steps.size else 0.0
    steps = steps[steps > 1e-9 * max(span, 1e-30)]
    if steps.size < LEAST_STEPS:
        return None
    quantum = float(np.median(steps[steps < 1.5 * float(np.quantile(steps, 0.002))]))
    small = steps[steps < 20.5 * quantum]
    for _ in range(2):
        counts = np.maximum(np.rint(small / quantum), 1.0)
        quantum = float(np.sum(small * counts) / np.sum(counts**2))
    off = np.abs(small / quantum - np.rint(small / quantum))
    if np.quantile(off, 0.9) > 0.15:
        return None
    return float(f"{quantum:.5g}")


def redundancy_offset(records: list[Record]) -> float:
    """Mean of the differential sensor less the chambers' difference (Pa); 0 where one is not measured."""
    parts = [(r.difference - r.pressure_1 + r.pressure_2)[~r.gap] for r in records if r.redundant]
    return float(np.concatenate(parts).mean()) if any(np.any(p) for p in parts) else 0.0


def fit_sensors(logs: list[Samples], records: list[Record]) -> dict[str, dict[str, float]]:
    """Channel to noise, resolution and zero of its sensor, SI, as far as the logs tell them.

    `logs` are as recorded, `records` the same made even.
    """
    fits: dict[str, dict[str, float]] = {}
    for channel in (*PRESSURES, "position", "pump_angle", "pump_speed"):
        # NaN are dropped, not bridged: a bridge is free of noise.
        columns = [log[channel][np.isfinite(log[channel])] for log in logs if channel in log]
        pump = channel.startswith("pump")
        noise = None if pump else lowest([effective_noise(c, records[0].period) for c in columns])
        step = lowest([resolution(c) for c in columns])
        fit = fits[channel] = {}
        if noise is not None:
            # Rounding adds its own noise to the measured density; the profile lists it apart.
            rounding = (step or 0.0) / np.sqrt(12.0)
            left = float(np.sqrt(max(noise**2 - rounding**2, 0.0)))
            if channel != "position" or left > rounding:
                fit["noise"] = float(f"{left:.4g}")
        if step is not None:
            fit["resolution"] = step
    if abs(offset := redundancy_offset(records)) > LEAST_ZERO:
        fits["pressure_difference"]["zero"] = offset
    return {c: f for c, f in fits.items() if f}


def lowest(values: list[float | None]) -> float | None:
    """The least of what the logs told, None where none did."""
    return min((v for v in values if v is not None), default=None)
