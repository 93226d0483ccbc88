"""Pump-to-piston gain beside slip and dead band (thesis 5.1, Table 6.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.identification import Array, jackknife_std
from fdd.identification.experiments import NORMAL_95, Outcome, Told, axes, cloud, curve_line
from fdd.identification.record import Record
from fdd.identification.volume_steps import RELIEF_MARGIN
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

Mask = NDArray[np.bool_]

RPM = 30.0 / np.pi
"""Of a rad/s."""
WINDOW = 0.2
"""s."""
BLOCK = 10
"""Windows, 2 s: what lies farther apart counts as independent."""
GROUPS = 12
COMPRESSED = 0.02
"""Of the pumped volume that compression may take or give: more is no steady motion."""
SLIDING = 1.0 / 3.0
"""Of the velocity that the gain would give, from which the piston slides rather than creeps."""
SLOW = 0.12
"""Of the drive's largest speed, below which windows tell the dead band."""
SLIP_MODEL = 0.03
"""Of the slip, likewise: density and compression, which `fdd.identification.experiments.leakage` balances."""
MODEL = 5e-4
"""Of the gain: encoders, cylinder, and what the windows leave out (standard deviation)."""
LEAST_WINDOWS = 5
LOADED = 5e5
"""Pa between the lowest and the highest pressures that slip needs."""


def dead_band(levels: Array, speeds: Array, moves: Mask) -> float:
    """Where the line through the speeds of what moves meets zero; NaN where it moves at fewer than three.

    `levels`, `speeds` and `moves` (n,) are command or pump speed, that of what it moves, and whether it does.

    Examples
    --------
    >>> speeds = np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    >>> round(dead_band(np.arange(6.0), speeds, speeds > 0.0), 6)
    2.0
    """
    if np.count_nonzero(moves) < 3:
        return float("nan")
    slope, offset = np.polyfit(levels[moves], speeds[moves], 1)
    return float(-offset / slope)


def gain(records: list[Record], unit: Unit) -> Outcome:
    """Volumetric gain in both directions, slip and dead band, beside the profile's."""
    out = Outcome("gain", "Gain from pump to piston")
    pump, velocity, pressure, steady, block = _windows(records, unit)
    profile, top = unit.pump.displacement / unit.cylinder.area_1, unit.drive.max_speed
    group = np.unique(block, return_inverse=True)[1] % GROUPS
    data = []
    for sign, name, colour in ((1.0, "forward", tr.BLUE), (-1.0, "reverse", tr.VERMILLION)):
        w, v = sign * pump, sign * velocity
        forward = steady & (w > 0.0)
        slides = forward & (v > SLIDING * profile * w)
        _slope(out, w, v, sign * pressure, slides & (w > SLOW * top), group, name, unit)
        slow = forward & (w < SLOW * top)
        _dead(out, w, v, slow & slides, slow & ~slides, group, name, profile)
        if slides.any():
            data.append(cloud(RPM * pump[slides], 1e3 * velocity[slides], name, colour))
            out.curves[name] = {"pump_speed": pump[slides], "velocity": velocity[slides]}
    out.notes.append(
        "Means over 0.2 s, by the encoders, in which compression takes at most 2 % of the pumped oil. "
        "Gain is the slope of velocity over pump speed beside a slip in proportion to pressure, the "
        "profile's where no load tells it."
    )
    if data:
        line = 1e-9 + np.array([-1.0, 1.0]) * float(np.abs(pump[steady]).max())
        data.append(curve_line(RPM * line, 1e3 * profile * line, "profile", tr.GREY, "dash"))
        layout = axes("pump speed (rpm)")
        out.figures = [Figure("velocity", "Velocity over pump speed", data, layout, "mm/s", "", 340, True)]
    return out


def _windows(records: list[Record], unit: Unit) -> tuple[Array, Array, Array, Mask, NDArray[np.int64]]:
    """Means over 0.2 s: pump speed, velocity, pressure difference; which are steady, and their blocks."""
    parts = []
    stiffness = unit.oil.bulk_modulus / (0.25 * (unit.cylinder.volume_1 + unit.cylinder.volume_2))
    for k, r in enumerate(records):
        n = r.rows(WINDOW)
        starts = np.arange(0, len(r) - n, n)
        bad = np.concatenate(([0], np.cumsum(r.gap)))
        drop = r.smooth(r.pressure_1 - r.pressure_2, 0.02)
        turned, moved, pressed = (x[starts + n] - x[starts] for x in (r.angle, r.position, drop))
        mean = np.add.reduceat(drop, starts)[: starts.size] / n
        mean[-1] = drop[starts[-1] : starts[-1] + n].mean()
        pumped = np.abs(turned) * unit.pump.displacement
        steady = (np.abs(pressed) / stiffness < COMPRESSED * pumped) & (bad[starts + n] == bad[starts])
        # One direction all along: a window with a reversal has no steady speed.
        speed = np.diff(r.smooth(r.angle, 0.02))
        flips = np.concatenate(([0], np.cumsum(np.sign(speed[1:]) != np.sign(speed[:-1])), [0]))
        steady &= (np.abs(turned) > 1e-9) & (np.abs(mean) < RELIEF_MARGIN * unit.accumulator.relief_pressure)
        steady &= (flips[starts + n - 2] == flips[starts]) | (
            np.abs(turned) < 0.02 * unit.drive.max_speed * WINDOW
        )
        span = n * r.period
        parts.append((turned / span, moved / span, mean, steady, 10_000 * k + starts // (n * BLOCK)))
    pump, velocity, pressure, still, block = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return pump, velocity, pressure, still, block


def _jackknifed(parts: list[Array] | list[float]) -> Array:
    """Half widths of 95 % intervals from estimates that each lack one group."""
    return np.asarray(student.ppf(0.975, len(parts) - 1) * jackknife_std(np.array(parts)))


def _slope(
    out: Outcome, pump: Array, velocity: Array, pressure: Array, fast: Mask, group: NDArray[np.int64],
    name: str, unit: Unit,
) -> None:  # fmt: skip
    """Gain and slip in one direction: velocity over pump speed, less what a pressure loses."""
    groups, area = np.unique(group[fast]), unit.cylinder.area_1
    if np.count_nonzero(fast) < 2 * LEAST_WINDOWS or groups.size < 3:
        slowest = f"{30 / np.pi * SLOW * unit.drive.max_speed:.0f} rpm"
        out.not_told.append(f"Gain {name}: fewer than {2 * LEAST_WINDOWS} steady windows above {slowest}.")
        return
    profile = unit.pump.displacement / area
    loaded = np.ptp(pressure[fast]) > LOADED
    holding = unit.pump.cross_port_leakage + unit.pump.case_leakage
    # The pump moves oil, not volume: its ports' mean density is less than the driven chamber's.
    slipped = profile * pump * pressure / (2.0 * unit.oil.bulk_modulus)
    if not loaded:  # no load tells the slip: the profile's leakage takes it off, a third of it left open
        slipped = holding * pressure / area + slipped
    m = np.column_stack([pump, *([-pressure] if loaded else [])])
    scale, met = np.abs(m[fast]).max(axis=0), velocity + slipped

    def solve(rows: Mask) -> Array:
        return np.asarray(np.linalg.lstsq((m / scale)[rows], met[rows], rcond=None)[0] / scale)

    whole = solve(fast)
    half = _jackknifed([solve(fast & (group != g)) for g in groups])
    value = float(whole[0])
    open_slip = NORMAL_95 / 3.0 * float(np.mean(slipped[fast])) / float(np.mean(pump[fast]))
    reach = float(np.sqrt(half[0] ** 2 + (NORMAL_95 * MODEL * value) ** 2 + open_slip**2))
    beside = f"profile {2e3 * np.pi * profile:.4g} mm/turn, this is {100 * (value / profile - 1):+.2f} %"
    out.told.append(Told.within(f"gain, {name}", value, reach, "m/rad", beside))
    if loaded:
        slip = whole[1] * area
        reach = float(np.hypot(half[1] * area, NORMAL_95 * SLIP_MODEL * slip))
        beside = f"profile's ξ + C_ep: {holding:.3g} m³/(s·Pa)"
        out.told.append(Told.within(f"slip, {name}", slip, reach, "m^3/(s*Pa)", beside))
    else:
        out.not_told.append(
            f"Slip over pressure, {name}: the pressures at speed differ by less than {LOADED / 1e5:.0f} bar."
        )


def _dead(
    out: Outcome, pump: Array, velocity: Array, slides: Mask, stands: Mask, group: NDArray[np.int64],
    name: str, profile: float,
) -> None:  # fmt: skip
    speeds, groups = pump[slides], np.unique(group[slides])
    told = speeds.size >= 2 * LEAST_WINDOWS and np.ptp(speeds) > 0.5 * np.median(speeds)
    if not told or groups.size < 3 or np.count_nonzero(stands) < 2:
        needs = "it needs slow pump speeds at which the piston stands and several at which it slides."
        out.not_told.append(f"Dead band {name}: {needs}")
        return
    value = dead_band(pump, velocity, slides)
    half = float(_jackknifed([dead_band(pump, velocity, slides & (group != g)) for g in groups]))
    note = f"{1e3 * profile * value:.2g} mm/s; leakage under the friction's pressure is in it"
    out.told.append(Told.within(f"dead band of the piston, {name}", value, half, "rad/s", note))
