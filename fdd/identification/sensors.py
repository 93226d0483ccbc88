"""What a healthy log says about its sensors: noise, resolution, and zeros that redundancy shows; and of the
motor by its current: the torque constant, against the pump's load torque in slow motion."""

from __future__ import annotations

import numpy as np

from fdd.identification import Array, Estimate, jackknife_std
from fdd.identification.record import Record
from fdd.samples import PRESSURES, Samples

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

WINDOW = 0.1
"""s over which currents and pressures are averaged."""
LEAST_WINDOWS = 60
SLOW = 400.0
"""rad/s²: above it the rotor's inertia would hide the load torque."""
LEAST_RANGE = 0.3
"""N·m of load torque that must be covered."""
WELL_DETERMINED = 0.03
GEAR_FRICTION = (0.05, 0.03)
"""Torque by which the load rubs in gears and bearings, over D·Δp, with its standard deviation: catalogues
give gear pumps 85 to 95 % of their torque, about half of the loss being this (McCandlish and Dorey)."""
GAINS = 0.005
"""Of the sensors of current and pressures, relative: catalogues allow 0.5 % each."""
BLOCK = 20
"""Windows, 2 s: residuals nearer than that are one."""
_GROUPS = 10


def effective_noise(values: Array, period: float) -> float | None:
    """White noise (standard deviation) with the spectral density that the channel, a row per `period` (s),
    has below 100 Hz; None where there are fewer than four segments.

    ``sqrt(mean PSD over 8 to 100 Hz · f_s/2)``, in the quietest quarter of half-second segments.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal(60_000)
    >>> abs(effective_noise(noise, 1e-3) - 1.0) < 0.1
    True
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
    """Quantum of a channel: the step of which all steps are multiples; None for a smooth channel.

    Examples
    --------
    >>> resolution(0.25 * np.rint(np.sin(np.arange(0.0, 9.0, 0.01)) * 40.0))
    0.25
    """
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
    parts = [(r.difference - r.pressure_1 + r.pressure_2)[~r.gap] for r in _redundant(records)]
    return float(np.concatenate(parts).mean()) if any(np.any(p) for p in parts) else 0.0


def gain_mismatch(records: list[Record]) -> float | None:
    """Slope of the differential sensor over the chambers' difference, less one."""
    if not (use := _redundant(records)):
        return None
    x = np.concatenate([r.smooth(r.pressure_1 - r.pressure_2, 0.05)[~r.gap] for r in use])
    y = np.concatenate([r.smooth(r.difference, 0.05)[~r.gap] for r in use])
    x = x - x.mean()
    spread = float(np.mean(x**2))
    return None if spread < 1e9 else float(np.mean(x * (y - y.mean())) / spread - 1.0)


def _redundant(records: list[Record]) -> list[Record]:
    return [r for r in records if r.has_difference and r.chambers_measured]


def fit_sensors(logs: list[Samples], records: list[Record]) -> dict[str, dict[str, float]]:
    """Channel to noise, resolution and zero of its sensor, SI, as far as the logs tell them.

    `logs` are as recorded, `records` the same made even.
    """
    fits: dict[str, dict[str, float]] = {}
    for channel in (*PRESSURES, "position", "pump_angle", "pump_speed"):
        # NaN are dropped, not bridged: a bridge is free of noise.
        columns = [log[channel][np.isfinite(log[channel])] for log in logs if channel in log]
        pump = channel.startswith("pump")
        noise = None if pump else _lowest([effective_noise(c, records[0].period) for c in columns])
        step = _lowest([resolution(c) for c in columns])
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


def _lowest(values: list[float | None]) -> float | None:
    return min((v for v in values if v is not None), default=None)


def fit_torque_constant(records: list[Record], displacement: float) -> tuple[Estimate | None, str]:
    """The torque constant (N·m/A) and a note, or None with the reason; `displacement` in m³/rad.

    Current is regressed on D·Δp, |D·Δp| and 1 with the sign of the speed, speed and its rate. K_t is one over
    the first slope; the second over the first is friction that grows with load, and where load and motion
    always go together it is known by `GEAR_FRICTION` alone.
    """
    parts = [_windows(r, displacement) for r in records if r.current is not None]
    if not parts:
        return None, "motor current is not measured"
    m, y = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if y.size < LEAST_WINDOWS:
        return None, "too little slow motion"
    if np.ptp(m[:, 0]) < LEAST_RANGE:
        return None, f"load torque covers {np.ptp(m[:, 0]):.2f} N·m only"
    usual, doubt = GEAR_FRICTION
    slope = _slope(m, y, usual)
    group = np.arange(y.size) // BLOCK % _GROUPS
    left_out = np.array([_slope(m[group != g], y[group != g], usual) for g in range(_GROUPS)])
    std = float(jackknife_std(left_out))
    if slope <= 0.0 or std > WELL_DETERMINED * slope:
        return None, f"slope of current over load torque {slope:.3g} ± {std:.2g} A/(N·m) is not sharp enough"
    gears = _slope(m, y, usual + doubt) - slope
    relative = float(np.sqrt(std**2 + gears**2 + (GAINS * slope) ** 2)) / slope
    return Estimate(1.0 / slope, relative / slope), "friction that grows with load taken off"


def _windows(record: Record, displacement: float) -> tuple[Array, Array]:
    assert record.current is not None
    step = record.rows(WINDOW)
    n = len(record) // step * step
    _, w = record.speeds(0.02)
    rate = np.gradient(record.smooth(w, 0.02), record.period)
    drop = record.pressure_1 - record.pressure_2 if record.chambers_measured else record.difference

    def mean(values: Array) -> Array:
        return np.asarray(values[:n].reshape(-1, step).mean(axis=1), dtype=np.float64)

    speed, acceleration = mean(w), mean(rate)
    slow = (np.abs(rate[:n]).reshape(-1, step).max(axis=1) < SLOW) & (np.abs(speed) > 2.0)
    slow &= ~record.gap[:n].reshape(-1, step).any(axis=1)
    load, turning = mean(displacement * drop), np.sign(speed)
    m = np.column_stack(
        [load, np.abs(load) * turning, turning, speed * 1e-2, acceleration * 1e-2, np.ones_like(speed)]
    )
    return m[slow], mean(record.current)[slow]


def _slope(m: Array, y: Array, friction: float) -> float:
    """First coefficient; the second over it is `friction`, as sure as `GEAR_FRICTION` says."""
    weights: Array = np.ones(y.size)
    theta: Array = np.zeros(m.shape[1])
    prior = np.zeros(m.shape[1])
    for _ in range(6):
        rows, wanted = np.vstack([m * weights[:, None], prior]), np.append(y * weights, 0.0)
        theta = np.asarray(np.linalg.lstsq(rows, wanted, rcond=1e-10)[0])
        residual = y - m @ theta
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weights = np.sqrt(np.minimum(1.0, 2.0 * sigma / np.maximum(np.abs(residual), 1e-12)))
        sure = np.sqrt(BLOCK) * sigma / max(GEAR_FRICTION[1] * abs(float(theta[0])), 1e-12)
        prior[:2] = -friction * sure, sure
    return float(theta[0])
