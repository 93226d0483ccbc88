"""Are a log's units of measure and scales those of the profile? Asked before a diagnosis, as identification
asks it of healthy logs.

Refused is what no machine could be; what a fault could be is told in a note. A fault changes one thing or
two: a pressure in another unit changes all that goes with pressure, each by the slip's factor or its inverse.
"""

from __future__ import annotations

from math import exp, hypot, log

import numpy as np

from fdd.errors import InputError
from fdd.identification.identify import RELIEF_EXCEEDED, identify_unit
from fdd.identification.judgement import Ratio, against_base, pressure_slip, push_of
from fdd.identification.logs_agree import BETWEEN
from fdd.identification.record import Record, even_record
from fdd.identification.sensors import fit_sensors
from fdd.identification.signs import (
    UNLIKE,
    against_pressure,
    check_gain,
    check_pump,
    gain_ratio,
    gain_slips,
    refuse_sign,
)
from fdd.identification.slips import NEAR
from fdd.logs.stamps import nominal_period
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

ENOUGH_S = 120.0
"""s of a log that tell its signs and scales."""
STROKE_SHARE = 0.1
"""Of the stroke, that the piston may not pass between two samples."""
FINER = (10.0, 25.4, 1e3, 1e6)
"""Factors between units of length in which a log that hardly moves may have been written."""
RELIEF_OPEN, SENSOR_OPEN = 0.5, 0.35
"""Standard deviations of ln, of a relief setting that is passed and of a sensor's noise or counts."""
LEAST_SLIP = 2.5
"""No two units of one quantity are nearer to each other (`fdd.identification.slips`)."""
SURE = 4.0
"""Standard deviations from which on a gain is another one: once in 16 000 logs, were they Gaussian."""


def check_scales(samples: Samples, unit: Unit, where: str) -> list[str]:
    """Refuse a log whose signs and units are not those of the unit; a log that hardly moves tells nothing.

    Parameters
    ----------
    samples : log to be diagnosed; its first two minutes are enough. unit : its profile.
    where : what errors call the log.

    Returns
    -------
    Notes, one line each, on what a fault may be as well as a wrong unit or profile.

    Raises
    ------
    InputError : the clock, the gain or the pressures are of another unit of measure, the piston goes against
        the pump, or oil flows against the pressure difference.
    """
    _check_clock(samples, unit, where)
    start = samples.rows(0, int(np.searchsorted(samples.time, samples.time[0] + ENOUGH_S)))
    try:
        record = even_record(start, unit, where)
    except InputError:
        _check_travel(start, unit, where)
        return []
    check_gain(record, unit, where)
    check_pump(start, where)
    own = unit.baseline is not None
    of_sensors = _of_sensors(start, record, unit) if own else {}
    plain, _ = gain_ratio(record, unit)
    if of_sensors and 1.0 / NEAR < plain < NEAR and all(_usual(r) for r in of_sensors.values()):
        # Another unit of measure scales a sensor's noise and counts alike: the balances need not be asked.
        refuse_sign(against_pressure(record, unit, where, own=True), 1.0, where)
        return []
    ratios = _ratios(start, unit, where) | of_sensors
    slip, sure = _slipped(ratios, push_of([start], unit))
    if slip is not None and sure and own:
        raise InputError(slip, where=where, mend="correct it with --map")
    notes = _gain_notes(ratios, record, unit) if own else []
    try:
        refuse_sign(against_pressure(record, unit, where, own=own), 1.0, where)
    except InputError as error:
        # What oil is lost is judged with the profile's gain: that of another unit turns it just as well.
        raise InputError(
            error.problem, where=where,
            mend=f"{error.mend}; or give the profile of this unit, as {notes[0]}" if notes else error.mend,
        ) from None  # fmt: skip
    return [*([f"{slip}, unless a fault did it"] if slip is not None else []), *notes]


def _check_clock(samples: Samples, unit: Unit, where: str) -> None:
    """Refuse rows so far apart that a stroke fits between few of them.

    Raises
    ------
    InputError : names the period, and ms where that would do.
    """
    period = nominal_period(samples.time)
    c = unit.cylinder
    slowest = (
        STROKE_SHARE * c.stroke * min(c.area_1, c.area_2) / (unit.pump.displacement * unit.drive.max_speed)
    )
    if period > slowest:
        looks = " (it looks like ms read as s)" if 1e-3 * period < slowest else ""
        raise InputError(
            f"channel time: a row each {period:.3g} s, while {unit.name} moves a tenth of its stroke in "
            f"{slowest:.2g} s", where=where, mend=f"check the unit of time in the map{looks}",
        )  # fmt: skip


def _check_travel(samples: Samples, unit: Unit, where: str) -> None:
    """Refuse a position that hardly moves, and goes with the pump as it should were its unit a finer one.

    Raises
    ------
    InputError : names the unit that it looks like.
    """
    for factor in FINER:
        finer = samples.with_columns({"position": factor * samples.get("position")})
        try:
            ratio, alike = gain_ratio(even_record(finer, unit, where), unit)
        except InputError:
            continue
        if alike > UNLIKE and ratio < NEAR and ratio / alike > 1.0 / NEAR:
            raise InputError(
                f"channel position: {ratio / factor:.2g} times the travel per rad of the pump of {unit.name}",
                where=where, mend=f"check its unit in the map{gain_slips(ratio / factor)}",
            )  # fmt: skip


def _ratios(samples: Samples, unit: Unit, where: str) -> dict[str, Ratio]:
    """What the log alone identifies, over the profile's; empty where it identifies nothing."""
    try:
        found = identify_unit([samples], unit, labels=[where])
    except InputError:
        return {}
    ratios = against_base(found, unit)
    setting = unit.accumulator.relief_pressure
    raised = next((r for r in found.table if r.quantity == "accumulator.relief_pressure"), None)
    if raised is not None and raised.identified is not None:
        # A valve passes a little more than its setting; how far beyond, tells the pressures' scale.
        ratios["accumulator.relief_pressure"] = Ratio(
            raised.identified / setting / RELIEF_EXCEEDED, 0.2, RELIEF_OPEN
        )
    return ratios


def _of_sensors(samples: Samples, record: Record, unit: Unit) -> dict[str, Ratio]:
    """Noise and counts of the pressures over the profile's: no fault of oil or machine changes them."""
    fits = fit_sensors([samples], [record], unit)
    out = {}
    for name, part in (("noise", "noise"), ("counts", "resolution")):
        pairs = [(getattr(f.sensor, part), getattr(unit.sensor(c), part)) for c, f in fits.items()
                 if c in PRESSURES and part in f.found]  # fmt: skip
        logs = [log(now / then) for now, then in pairs if now > 0.0 and then > 0.0]
        if logs:
            out[name] = Ratio(exp(sum(logs) / len(logs)), 0.0, SENSOR_OPEN)
    return out


def _usual(ratio: Ratio) -> bool:
    """Whether a sensor reads as the profile's does, nearer than to any other unit's factor."""
    return abs(log(ratio.value)) < log(LEAST_SLIP) / 2.0


def _slipped(ratios: dict[str, Ratio], push: float) -> tuple[str | None, bool]:
    """The unit that the pressures look like, and whether it holds whatever one sign of it is left out."""
    slip = pressure_slip(ratios, push)
    if slip is None:
        return None, False
    rest = [({n: r for n, r in ratios.items() if n != left}, push) for left in ratios]
    held = [pressure_slip(*each) for each in [*rest, (ratios, 1.0)]]
    return slip, len(ratios) > 1 and None not in held


def _gain_notes(ratios: dict[str, Ratio], record: Record, unit: Unit) -> list[str]:
    """A note where the log's travel per rad is surely not the profile's, by balances where they tell."""
    found, known = ratios.get("pump.displacement"), unit.pump.std_of("displacement")
    if known is None:
        return []
    if found is not None:
        between = BETWEEN["travel per rad of the pump"][0]
        std = hypot(found.std, known / unit.pump.displacement, between)
        ratio, same = found.value, abs(log(found.value)) < SURE * std
    else:
        ratio, alike = gain_ratio(record, unit)  # but for leakage it lies between the regressions
        same = alike < UNLIKE or (ratio < NEAR and ratio / alike > 1.0 / NEAR)
    if same:
        return []
    return [
        f"travel per rad of the pump is {ratio:.3g} times that of profile {unit.name}: the log is of another "
        "unit, a scale in the channel map is wrong, or a fault did it"
    ]
