"""Lost motion: what the pump turns after a reversal before the piston follows, backlash among it."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from fdd.identification.experiments.outcome import Outcome, Told
from fdd.identification.record import Record
from fdd.unit import Unit

LEAST_REVERSALS = 4
LOOK = 0.5
"""s after a reversal of the pump within which the piston must follow."""


def lost_motion(out: Outcome, records: list[Record], unit: Unit) -> None:
    """Pump angle from its reversals until the piston follows, less what creep, oil and leakage take."""
    cylinder, pump = unit.cylinder, unit.pump
    profile = pump.displacement / cylinder.area_1
    lost, taken = [], []
    for r in records:
        v, w = r.speeds(0.01)
        calm, n = r.smooth(w, 0.05), r.rows(LOOK)
        for start in np.flatnonzero(np.sign(calm[1:]) != np.sign(calm[:-1])) + 1:
            before, ahead = slice(start - n // 2, start - n // 10), slice(start, start + n)
            if start < n or start + n > len(r) or r.gap[start - n // 2 : start + n].any():
                continue
            sign, least = np.sign(calm[start]), 0.01 * unit.drive.max_speed
            if (
                sign * v[start] > 1e-4
                or np.any(-sign * calm[before] < least)
                or np.any(sign * calm[ahead] < 0.0)
            ):
                continue
            follows = np.flatnonzero(sign * v[ahead] > 0.8 * profile * np.abs(w[ahead]) + 1e-4)
            if follows.size == 0:
                continue
            stop = start + int(follows[0])
            pressure, volume = (
                (r.pressure_1, cylinder.volume_1) if sign > 0.0 else (r.pressure_2, cylinder.volume_2)
            )  # the chamber that the pump now fills
            level = r.smooth(pressure, 0.01)
            compressed = volume * (level[stop] - level[start]) / unit.oil.bulk_modulus
            leaked = (pump.cross_port_leakage + pump.case_leakage) * r.period * float(
                np.sum(sign * (r.pressure_1 - r.pressure_2)[start:stop])
            )  # fmt: skip
            lost.append(sign * (r.angle[stop] - r.angle[start]))
            moved = sign * (r.position[stop] - r.position[start])
            taken.append(moved / profile + (compressed + leaked) / pump.displacement)
    if len(lost) < LEAST_REVERSALS:
        out.not_told.append(
            f"Backlash: the pump turns round at speed {len(lost)} times, {LEAST_REVERSALS} times are needed."
        )
        return
    whole, rest = np.array(lost), np.array(lost) - np.array(taken)
    spread = float(student.ppf(0.975, len(lost) - 1)) / np.sqrt(len(lost))
    wide = spread * float(whole.std(ddof=1))
    out.told.append(
        Told(
            "pump turns from its reversal until the piston follows",
            float(whole.mean()),
            float(whole.mean()) - wide,
            float(whole.mean()) + wide,
            "rad",
            f"{len(lost)} reversals",
        )
    )
    # The profile's compressibility is known to a quarter at best where the pressure passes the charge.
    oil = float(np.mean(taken))
    half = float(np.hypot(spread * rest.std(ddof=1), 0.25 * abs(oil)))
    if rest.mean() > half:
        beside = f"the other {np.degrees(oil):.3g}° are creep, oil compressed and leaked, by the profile"
        out.told.append(Told("backlash among it", float(rest.mean()), float(rest.mean()) - half,
                             float(rest.mean()) + half, "rad", beside))  # fmt: skip
    else:
        out.not_told.append(
            f"Backlash: less than {np.degrees(max(rest.mean(), 0.0) + half):.3g}° of the pump, which "
            "the oil's "
            "compression hides."
        )
