"""Are the channels' signs and units those of one actuator? Told by the oil: what the pump moves beyond the
piston's travel either leaks away with the pressure or is compressed by it."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.identification import Array, huber, jackknife_std
from fdd.identification.record import Record
from fdd.measures import MEASURES
from fdd.samples import Samples
from fdd.tolerances import RELIEF_SHUT
from fdd.unit import Unit

MOST_GAIN_CHANGE = 3.0
"""Factor between the logs' and the base's gain beyond which one of the two is wrong."""
STEP = 0.2
"""s of a step: some millimetres of travel, and leakage beside compression."""
GROUPS = 12
"""Of the jackknife; blocks of 1 s are dealt out to them in turn."""
BLOCK = 1.0
BY_CHANCE = 3e-5
"""How often an error this way would be told of a right log, were there nothing else (Student's t)."""
SURE = {5: 12.4191, 6: 9.9383, 7: 8.5384, 8: 7.6530, 9: 7.0479, 10: 6.6103, 11: 6.2803}
"""Quantiles of Student's t at 1 - `BY_CHANCE` by degrees of freedom; scipy takes a while to import."""
ALONE = 2.0
"""Times what chance gives, beyond which a log's sign is wrong whatever the others say: laws err too."""
TURN = "swap pressure_1 and pressure_2, or turn the sign of pressure_difference, in the map"
LIKE = 0.9
"""Correlation of two channels from which their ratio is one of units, whatever its size."""
UNLIKE = 0.25
"""Squared correlation of travel and turning below which even the sign of their ratio is open."""

NEAR = 1.25
"""Factor within which a slip explains what was found; of lengths, angles and pressures no two slips of one
channel are nearer than 1.4 to each other, and none is nearer than 2.5 to one."""
COMMON = ("m", "rad", "rad/s", "Pa", "kPa", "bar", "mm", "deg", "rpm", "MPa")
"""Units in which logs are most often written or read, the commonest first."""


def check_gain(record: Record, base: Unit, where: str) -> None:
    """Refuse a log whose travel per rad of the pump is nowhere near the base's.

    Raises InputError: opposite signs, or a factor of three and more; names the unit that it looks like.
    """
    ratio, alike = gain_ratio(record, base)
    expected = 1e3 * base.pump.displacement / base.cylinder.area_1
    if alike < UNLIKE:  # a gust or a leak moves the piston more than the pump does
        return
    if ratio < 0.0:
        problem = f"the piston retracts while the pump turns forward ({ratio * expected:.3g} mm/rad)"
        raise InputError(problem, where=where, mend="turn the sign of position or pump in the channel map")
    # Errors in travel lower the one regression, those in turning raise the other: the gain lies between them.
    if ratio > MOST_GAIN_CHANGE or ratio / alike < 1.0 / MOST_GAIN_CHANGE:
        raise InputError(
            f"{ratio * expected:.3g} mm of travel per rad of the pump where base {base.name} has "
            f"{expected:.3g}", where=where,
            mend=f"check the units of position and pump in the channel map{gain_slips(ratio)}, or give a "
            "fitting base profile",
        )  # fmt: skip


def gain_ratio(record: Record, base: Unit) -> tuple[float, float]:
    """Travel per rad of the pump over the base's, and how much of the travel goes with it (0 to 1)."""
    step = record.rows(STEP)
    dx, dtheta = np.diff(record.position[::step]), np.diff(record.angle[::step])
    moving = np.abs(dtheta) > 0.2 * np.max(np.abs(dtheta), initial=0.0)
    dx, dtheta = dx[moving], dtheta[moving]
    product, square = float(np.sum(dx * dtheta)), max(float(np.sum(dtheta**2)), 1e-30)
    alike = product**2 / max(square * float(np.sum(dx**2)), 1e-300)
    return product / square * base.cylinder.area_1 / base.pump.displacement, alike


def gain_slips(ratio: float) -> str:
    """What would make the gain `ratio` times too large, in brackets; empty where no unit does."""
    length, speed = slips(ratio, "length"), slips(1.0 / ratio, "angular_speed")
    # A map without a unit reads SI: rpm is likelier taken for rad/s than one length for a tenth of it.
    if speed.endswith("read as rad/s"):
        length = ""
    angle = slips(1.0 / ratio, "angle")
    found = [f"{c} in {s}" for c, s in (("position", length), ("pump", speed), ("pump", angle)) if s]
    return f" (it looks like {', or '.join(found)})" if found else ""


def check_pressure_signs(records: Sequence[Record], base: Unit, labels: Sequence[str]) -> None:
    """Refuse logs of a unit in which oil leaks towards the higher pressure; see `against_pressure`.

    They are read by one map, so the others may outvote a doubtful one.

    Raises InputError: the pressure difference of a log has the wrong sign.
    """
    found = [against_pressure(r, base, label) for r, label in zip(records, labels, strict=True)]
    doubt = sum(np.clip(one, -ALONE, ALONE) for one in found)
    for one, label in zip(found, labels, strict=True):
        refuse_sign(one, 1.0 if doubt > 0.0 else ALONE, label)


def refuse_sign(against: float, most: float, where: str) -> None:
    """Refuse what `against_pressure` found, where it is more than `most`."""
    if against > most:
        problem = f"oil flows against the pressure difference ({against:.1f} times what chance gives)"
        raise InputError(problem, where=where, mend=TURN)


def against_pressure(record: Record, unit: Unit, where: str, *, own: bool = False) -> float:
    """How much speaks for a pressure difference of the wrong sense, over what chance gives.

    `own` tells that the profile is this unit's, whose gain is known. The work that the pressures do on the
    piston does not tell: a gust drives it against the pump for minutes.

    Raises InputError: a measured difference is not that of the chambers.
    """
    if record.redundant:
        ratio = _slope(record, record.pressure_1 - record.pressure_2, record.difference)
        if ratio is not None:
            problem = f"pressure_difference is {ratio:.3g} times pressure_1 - pressure_2"
            looks = f" (it looks like {slip})" if (slip := slips(ratio, "pressure")) else ""
            units = f"check their units in the map{looks}"
            raise InputError(problem, where=where, mend=TURN if ratio < 0.0 else units)
    step, areas = record.rows(STEP), unit.cylinder.area_1 / unit.cylinder.area_2
    dx, dtheta = np.diff(record.position[::step]), np.diff(record.angle[::step])
    dtheta = dtheta * np.where(record.pressure_1 > record.pressure_2, 1.0, areas)[step::step]
    throughout = float(np.sum(dx * dtheta) / max(float(np.sum(dtheta**2)), 1e-30))
    gains: list[tuple[float | None, float]] = [(None, 0.0), (throughout, 0.0)]
    if own and (std := unit.pump.std_of("displacement")) is not None:
        gains = [(unit.pump.displacement / unit.cylinder.area_1, std / unit.cylinder.area_1)]
    found = [_oil_loss(record, unit, *gain) for gain in gains]
    return 0.0 if 0.0 in found else -max(found)


def check_pump(log: Samples, where: str) -> None:
    """Raise InputError of a log whose pump_speed is not the rate of its pump_angle."""
    angle, speed = log.get("pump_angle"), log.get("pump_speed")
    there = np.isfinite(angle) & np.isfinite(speed)
    if np.count_nonzero(there) < 2:
        return
    time, angle, speed = log.time[there], angle[there], speed[there]
    step = max(int(0.05 * time.size / max(float(np.ptp(time)), 1e-9)), 1)
    turned = np.diff(angle[::step])
    meant = np.diff(np.concatenate(([0.0], np.cumsum(speed[1:] * np.diff(time))))[::step])
    ratio = _regression(turned, meant)
    if ratio is not None and not 1.0 / NEAR < ratio < NEAR:
        looks = slips(ratio, "angular_speed")
        raise InputError(
            f"pump_speed is {ratio:.3g} times what pump_angle turns", where=where,
            mend=f"check their units and signs in the map{f' (it looks like {looks})' if looks else ''}",
        )  # fmt: skip


def _oil_loss(record: Record, unit: Unit, gain: float | None, gain_std: float) -> float:
    """Leakage and compression of a log together, over what is sure; both are positive by physics.

    ``Δx = g± Δθ - l ∫Δp dt - c Δ(Δp) + d Δt`` over steps; g of its own for either sign of Δp, because the
    chamber under load meters the motion. d takes up the zero of the pressures. Where a load goes with the
    speed, as a throttle's does, g and l can hardly be told apart: then `gain` (m/rad of chamber 1; chamber 2
    has its area's), known to `gain_std`, is better.

    It is 0 where the pressures or the pump hardly move, or there are too few steps.
    """
    n = record.rows(STEP)
    drop = record.smooth(record.pressure_1 - record.pressure_2, 0.05)
    x, theta = record.smooth(record.position, 0.05), record.smooth(record.angle, 0.05)
    starts = np.arange(0, len(record) - n, n)
    # Beyond the relief setting oil passes the valve, and the law is another one.
    passes = np.abs(drop) > RELIEF_SHUT * unit.accumulator.relief_pressure
    bad = np.concatenate(([0], np.cumsum(record.gap | passes)))
    starts = starts[bad[starts + n] == bad[starts]]
    held = np.concatenate(([0.0], np.cumsum(drop))) * record.period
    turned, mean = theta[starts + n] - theta[starts], (held[starts + n] - held[starts]) / STEP
    y = x[starts + n] - x[starts]
    m = np.column_stack(
        [turned * (mean > 0), turned * (mean <= 0), -mean, drop[starts] - drop[starts + n], np.ones(y.size)]
    )
    metered = turned * np.where(mean > 0, 1.0, unit.cylinder.area_1 / unit.cylinder.area_2)
    if gain is not None:
        y, m = y - gain * metered, m[:, 2:]
    leak = m.shape[1] - 3
    group = (starts * record.period / BLOCK).astype(np.int64) % GROUPS
    groups = np.unique(group)
    if groups.size < GROUPS // 2 or y.size < 5 * m.shape[1]:
        return 0.0
    m = m / np.maximum(np.sqrt(np.mean(m**2, axis=0)), 1e-300)

    def solve(rows: NDArray[np.bool_], y: Array = y) -> Array:
        """Steps with an unmodelled event count less."""
        return huber(m[rows], y[rows], 2.5, rounds=5, least=1e-12, rcond=1e-10)[0]

    every = np.ones(y.size, dtype=bool)
    std = jackknife_std(np.array([solve(group != g) for g in groups]))
    over = solve(every) / np.maximum(np.hypot(std, solve(every, gain_std * metered)), 1e-12)
    # Stouffer's sum: one of the two may hardly show.
    return float((over[leak] + over[leak + 1]) / np.sqrt(2.0)) / SURE[groups.size - 1]


def _slope(record: Record, x: Array, y: Array) -> float | None:
    """Factor from x to y where it is surely none of a sound pair of sensors, else None.

    Noise and wander of x lower the one regression, those of y raise the other: the factor lies between the
    two, each give or take its own standard error (errors in variables). Told is their geometric mean.
    """
    x, y = (record.smooth(v, 0.05)[~record.gap] for v in (x, y))
    group = np.arange(x.size) // record.rows(BLOCK) % GROUPS
    groups = np.unique(group)
    if groups.size < GROUPS // 2:
        return None
    x, y = x - x.mean(), y - y.mean()
    if _regression(x, y) is None:  # a dead sensor among others
        return None
    parts = np.array([[np.sum(v[group == g]) for g in groups] for v in (x * y, x * x, y * y)])
    xy, xx, yy = (np.append(np.sum(p) - p, np.sum(p)) for p in parts)  # without each group, and of all
    ends = []
    for one in (xy / xx, yy / xy):
        error = SURE[groups.size - 1] * jackknife_std(one[:-1])
        ends += [one[-1] - error, one[-1] + error]
    if min(ends) < NEAR and max(ends) > 1.0 / NEAR:
        return None
    return float(np.copysign(np.sqrt(yy[-1] / xx[-1]), xy[-1]))


def _regression(x: Array, y: Array) -> float | None:
    """Factor from x to y, None where they are not alike: then it is no question of units."""
    size = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    product = float(np.sum(x * y))
    return product / float(np.sum(x**2)) if size > 0.0 and abs(product) > LIKE * size else None


def slips(factor: float, dimension: str) -> str:
    """Pairs of units that make a channel `factor` times too large, in words; empty where none does.

    Examples
    --------
    >>> slips(1000.0, "length")
    'mm read as m'
    >>> slips(9.6, "angular_speed")
    'rpm read as rad/s'
    >>> slips(0.01, "pressure")
    'bar read as kPa'
    >>> slips(1.1, "pressure")
    ''
    """
    if factor <= 0.0:
        return ""

    def rank(name: str) -> int:
        return COMMON.index(name) if name in COMMON else len(COMMON)

    fitting = []
    for true, t in MEASURES.items():
        for read, r in MEASURES.items():
            if not t.dimension == r.dimension == dimension or t.factor == r.factor:
                continue
            off = abs(log(factor * t.factor / r.factor))
            if off < log(NEAR):
                fitting.append((round(off, 2), rank(read) + rank(true), f"{true} read as {read}"))
    return min(fitting)[2] if fitting else ""
