"""Pump-to-piston gain over speed and pressure, dead band and lost motion (thesis 5.1, Table 6.1)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.identification.experiments.outcome import Outcome, Told, axes, cloud, curve_line, points
from fdd.identification.least_squares import jackknife_std
from fdd.identification.record import Record
from fdd.identification.volume_steps import RELIEF_MARGIN
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import Unit

Array = NDArray[np.float64]
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
SPEEDS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.5])
"""Edges over the drive's largest speed."""
SLIP_MODEL = 0.03
"""Of the slip, likewise: density and compression, which `fdd.identification.experiments.leakage` balances."""
MODEL = 5e-4
"""Of the gain: encoders, cylinder, and what the windows leave out (standard deviation)."""
LEAST_WINDOWS = 5
LOADED = 5e5
"""Pa between the lowest and the highest pressures that slip needs."""
LEAST_REVERSALS = 4
LOOK = 0.5
"""s after a reversal of the pump within which the piston must follow."""


@dataclass(frozen=True)
class _Windows:
    """Means over 0.2 s: pump speed, velocity, pressure difference; which are steady, and their blocks."""

    pump: Array
    velocity: Array
    pressure: Array
    steady: Mask
    block: NDArray[np.int64]


def dead_band(levels: Array, speeds: Array, moves: Mask) -> float:
    """Where the line through the speeds of what moves meets zero.

    Parameters
    ----------
    levels, speeds, moves : (n,) of command or pump speed, of what it moves, and whether it moves.

    Returns
    -------
    As `levels`; NaN where it moves at fewer than three.

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
    """Volumetric gain in both directions, dead band and lost motion, beside the profile's."""
    out = Outcome("gain", "Gain from pump to piston")
    w = _windows(records, unit)
    profile = unit.pump.displacement / unit.cylinder.area_1
    out.heads = ("direction", "pump speed", "pressure along it", "velocity over pump speed", "95 %",
                 "over profile", "time")  # fmt: skip
    for sign, name, colour in ((1.0, "forward", tr.BLUE), (-1.0, "reverse", tr.VERMILLION)):
        _direction(out, w, sign, name, colour, unit, profile)
    _lost_motion(out, records, unit)
    out.notes.append(
        "Means over 0.2 s, by the encoders, in which compression takes at most 2 % of the pumped oil. "
        "Gain is the slope of velocity over pump speed beside a slip in proportion to pressure, the "
        "profile's where no load tells it."
    )
    if out.figures:
        line = 1e-9 + np.array([-1.0, 1.0]) * float(np.abs(w.pump[w.steady]).max())
        along = curve_line(RPM * line, 1e3 * profile * line, "profile", tr.GREY, "dash")
        data = [*(f.data.pop(0) for f in out.figures), along]
        layout = axes("pump speed (rpm)")
        out.figures.insert(
            0, Figure("velocity", "Velocity over pump speed", data, layout, "mm/s", "", 340, True)
        )
    return out


def _windows(records: list[Record], unit: Unit) -> _Windows:
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
    return _Windows(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _jackknifed(parts: Array) -> Array:
    """Half widths of 95 % intervals from estimates that each lack one group."""
    return np.asarray(student.ppf(0.975, len(parts) - 1) * jackknife_std(parts))


def _direction(
    out: Outcome, w: _Windows, sign: float, name: str, colour: str, unit: Unit, profile: float
) -> None:
    top = unit.drive.max_speed
    pump, velocity, pressure = sign * w.pump, sign * w.velocity, sign * w.pressure
    fast = w.steady & (pump > SLOW * top) & (velocity > SLIDING * profile * pump)
    group = np.unique(w.block, return_inverse=True)[1] % GROUPS
    if np.count_nonzero(fast) < 2 * LEAST_WINDOWS or np.unique(group[fast]).size < 3:
        out.not_told.append(
            f"Gain {name}: fewer than {2 * LEAST_WINDOWS} steady windows above "
            f"{30 / np.pi * SLOW * top:.0f} rpm."
        )
    else:
        loaded = np.ptp(pressure[fast]) > LOADED
        holding = unit.pump.cross_port_leakage + unit.pump.case_leakage
        # Where no load tells the slip, the profile's leakage takes it off, a third of it left open.
        slipped = np.zeros(pump.size) if loaded else holding * pressure / unit.cylinder.area_1
        # The pump moves oil, not volume: its ports' mean density is less than the driven chamber's.
        slipped = slipped + profile * pump * pressure / (2.0 * unit.oil.bulk_modulus)
        m = np.column_stack([pump, *([-pressure] if loaded else [])])
        scale, met = np.abs(m[fast]).max(axis=0), velocity + slipped

        def solve(rows: Mask) -> Array:
            return np.asarray(np.linalg.lstsq((m / scale)[rows], met[rows], rcond=None)[0] / scale)

        whole = solve(fast)
        half = _jackknifed(np.array([solve(fast & (group != g)) for g in np.unique(group[fast])]))
        value = float(whole[0])
        open_slip = 1.96 / 3.0 * float(np.mean(slipped[fast])) / float(np.mean(pump[fast]))
        reach = float(np.sqrt(half[0] ** 2 + (1.96 * MODEL * value) ** 2 + open_slip**2))
        beside = f"profile {2e3 * np.pi * profile:.4g} mm/turn, this is {100 * (value / profile - 1):+.2f} %"
        out.told.append(Told.within(f"gain, {name}", value, reach, "m/rad", beside))
        if loaded:
            slip = whole[1] * unit.cylinder.area_1
            slip_reach = float(np.hypot(half[1] * unit.cylinder.area_1, 1.96 * SLIP_MODEL * slip))
            beside = f"profile's ξ + C_ep: {holding:.3g} m³/(s·Pa)"
            out.told.append(Told.within(f"slip, {name}", slip, slip_reach, "m^3/(s*Pa)", beside))
        else:
            out.not_told.append(
                f"Slip over pressure, {name}: the pressures at speed differ by less than "
                f"{LOADED / 1e5:.0f} bar."
            )
    _table(out, w, sign, name, colour, top, profile)
    _dead(out, w.steady & (pump > 0.0) & (pump < SLOW * top), pump, velocity, group, name, profile)


def _table(
    out: Outcome, w: _Windows, sign: float, name: str, colour: str, top: float, profile: float
) -> None:
    """Efficiency by speed and pressure."""
    pump, pressure = sign * w.pump, sign * w.pressure
    ratio = w.velocity / np.where(w.pump == 0.0, np.nan, w.pump)
    moving = w.steady & (sign * w.velocity > SLIDING * profile * pump) & (pump > 0.0)
    xs, ys, reaches = [], [], []
    for a, b in zip(SPEEDS[:-1] * top, SPEEDS[1:] * top, strict=True):
        inside = moving & (pump >= a) & (pump < b)
        if np.count_nonzero(inside) < LEAST_WINDOWS:
            continue
        low, high = np.quantile(pressure[inside], [0.1, 0.9])
        middle, wide = 0.5 * (low + high), high - low > 4e5
        for rows in (inside & (pressure <= middle), inside & (pressure > middle)) if wide else (inside,):
            means = np.array([np.mean(ratio[rows & (w.block == k)]) for k in np.unique(w.block[rows])])
            if np.count_nonzero(rows) < LEAST_WINDOWS or means.size < 2:
                continue
            value = float(means.mean())
            reach = float(student.ppf(0.975, means.size - 1) * np.std(means, ddof=1) / np.sqrt(means.size))
            xs.append(float(np.median(pump[rows])))
            ys.append(value / profile)
            reaches.append(reach / profile)
            least, most = (2e3 * np.pi * (value + side) for side in (-reach, reach))
            out.rows.append((
                name, f"{RPM * xs[-1]:.0f} rpm", f"{np.median(pressure[rows]) / 1e5:.1f} bar",
                f"{2e3 * np.pi * value:.4g} mm/turn", f"{least:.4g} … {most:.4g}",
                f"{100 * value / profile:.1f} %", f"{WINDOW * np.count_nonzero(rows):.1f} s",
            ))  # fmt: skip
    if not xs:
        return
    x, y, band = (np.array(v) for v in (xs, ys, reaches))
    out.curves[name] = {"pump_speed": x, "over_profile": y, "low": y - band, "high": y + band}
    data = [
        cloud(RPM * w.pump[moving], 1e3 * w.velocity[moving], name, colour),
        points(RPM * x, 100 * y, 100 * (y - band), 100 * (y + band), "means, 95 %", colour),
    ]
    note = "over the profile's gain; two at a speed: low and high pressure"
    layout = axes("pump speed (rpm)")
    out.figures.append(Figure(name, f"Volumetric efficiency, {name}", data, layout, "%", note, 300))


def _dead(
    out: Outcome, slow: Mask, pump: Array, velocity: Array, group: NDArray[np.int64], name: str,
    profile: float,
) -> None:  # fmt: skip
    slides = slow & (velocity > SLIDING * profile * pump)
    enough, speeds = np.count_nonzero(slides) >= 2 * LEAST_WINDOWS, pump[slides]
    told, groups = enough and np.ptp(speeds) > 0.5 * np.median(speeds), np.unique(group[slides])
    if not told or groups.size < 3 or np.count_nonzero(slow & ~slides) < 2:
        out.not_told.append(
            f"Dead band {name}: it needs slow pump speeds at which the piston stands and several at "
            "which it slides."
        )
        return
    value = dead_band(pump, velocity, slides)
    half = float(_jackknifed(np.array([dead_band(pump, velocity, slides & (group != g)) for g in groups])))
    note = f"{1e3 * profile * value:.2g} mm/s; leakage under the friction's pressure is in it"
    out.told.append(Told.within(f"dead band of the piston, {name}", value, half, "rad/s", note))


def _lost_motion(out: Outcome, records: list[Record], unit: Unit) -> None:
    """Pump angle from its reversals until the piston follows, less what creep, oil and leakage take."""
    found = np.array([both for r in records for both in _reversals(r, unit)]).reshape(-1, 2)
    count = len(found)
    if count < LEAST_REVERSALS:
        out.not_told.append(
            f"Backlash: the pump turns round at speed {count} times, {LEAST_REVERSALS} times are needed."
        )
        return
    lost, taken = found.T
    rest, spread = lost - taken, float(student.ppf(0.975, count - 1)) / np.sqrt(count)
    half = spread * float(lost.std(ddof=1))
    quantity = "pump turns from its reversal until the piston follows"
    out.told.append(Told.within(quantity, float(lost.mean()), half, "rad", f"{count} reversals"))
    # The profile's compressibility is known to a quarter at best where the pressure passes the charge.
    oil = float(np.mean(taken))
    half = float(np.hypot(spread * rest.std(ddof=1), 0.25 * abs(oil)))
    if rest.mean() > half:
        beside = f"the other {np.degrees(oil):.3g}° are creep, oil compressed and leaked, by the profile"
        out.told.append(Told.within("backlash among it", float(rest.mean()), half, "rad", beside))
    else:
        out.not_told.append(
            f"Backlash: less than {np.degrees(max(rest.mean(), 0.0) + half):.3g}° of the pump, which "
            "the oil's compression hides."
        )


def _reversals(r: Record, unit: Unit) -> Iterator[tuple[float, float]]:
    """At each reversal the pump's angle (rad) until the piston follows, and what of it the profile says."""
    cylinder, pump = unit.cylinder, unit.pump
    profile, least = pump.displacement / cylinder.area_1, 0.01 * unit.drive.max_speed
    v, w = r.speeds(0.01)
    calm, n = r.smooth(w, 0.05), r.rows(LOOK)
    for start in np.flatnonzero(np.sign(calm[1:]) != np.sign(calm[:-1])) + 1:
        before, ahead = slice(start - n // 2, start - n // 10), slice(start, start + n)
        if start < n or start + n > len(r) or r.gap[start - n // 2 : start + n].any():
            continue
        sign = np.sign(calm[start])
        turns = np.all(-sign * calm[before] >= least) and np.all(sign * calm[ahead] >= 0.0)
        follows = np.flatnonzero(sign * v[ahead] > 0.8 * profile * np.abs(w[ahead]) + 1e-4)
        if sign * v[start] > 1e-4 or not turns or follows.size == 0:
            continue
        stop = start + int(follows[0])
        # Of the chamber that the pump now fills.
        filled = (r.pressure_1, cylinder.volume_1) if sign > 0.0 else (r.pressure_2, cylinder.volume_2)
        level, volume = r.smooth(filled[0], 0.01), filled[1]
        compressed = volume * (level[stop] - level[start]) / unit.oil.bulk_modulus
        drop = float(np.sum(sign * (r.pressure_1 - r.pressure_2)[start:stop]))
        leaked = (pump.cross_port_leakage + pump.case_leakage) * r.period * drop
        moved = sign * (r.position[stop] - r.position[start])
        explained = moved / profile + (compressed + leaked) / pump.displacement
        yield sign * (r.angle[stop] - r.angle[start]), explained
