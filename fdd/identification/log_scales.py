"""Are a log's units of measure and scales those of the profile? Asked before a diagnosis, as identification
asks it of healthy logs.

Refused is what no machine could be; what a fault could be is told in a note. A fault changes one thing or
two: a pressure in another unit changes all that goes with pressure, each by the slip's factor or its inverse.
"""

from __future__ import annotations

import numpy as np

from fdd.errors import InputError
from fdd.identification.record import LEAST_TRAVEL, even_record
from fdd.identification.signs import (
    NEAR,
    UNLIKE,
    against_pressure,
    check_gain,
    check_pump,
    gain_ratio,
    gain_slips,
    refuse_sign,
)
from fdd.logs.quality import nominal_period
from fdd.samples import Samples
from fdd.unit import Unit

ENOUGH_S = 120.0
"""s of a log that tell its signs and scales."""
STREAM_S, PAUSE_S = 20.0, 1.0
"""The same of a stream, whose alarms do not wait for it; s of a pause after which they are counted anew."""
STROKE_SHARE = 0.1
"""Of the stroke, that the piston may not pass between two samples."""
FINER = (10.0, 25.4, 1e3, 1e6)
"""Factors between units of length in which a log that hardly moves may have been written."""


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
    notes: list[str] = []
    if own:  # else nothing is known of this unit's own scales
        from fdd.identification.own_scales import own_notes

        notes = own_notes(start, record, unit, where)
    # What oil is lost is judged with the profile's gain, where that is the log's.
    refuse_sign(against_pressure(record, unit, where, own=own and not notes), 1.0, where)
    return notes


class StreamScales:
    """Holds a stream's first seconds in which the piston moves against the profile, as `check_scales` a log.

    So many `seconds` are taken together; `done` tells that they were, and passed.
    """

    def __init__(self, unit: Unit, where: str, seconds: float = STREAM_S) -> None:
        self.unit, self.where, self.seconds, self.done = unit, where, seconds, False
        self._parts: list[Samples] = []

    def push(self, samples: Samples) -> list[str]:
        """Take what comes next; notes, once, as `check_scales` gives and refuses them."""
        if self.done or not len(samples):
            return []
        if self._parts and samples.time[0] - self._parts[-1].time[-1] > PAUSE_S:
            self._parts = []
        self._parts.append(samples)
        if samples.time[-1] - self._parts[0].time[0] < self.seconds:
            return []
        joined, self._parts = Samples.concatenate(self._parts), []
        known = joined["position"][np.isfinite(joined["position"])] if "position" in joined else np.empty(0)
        if known.size and np.ptp(known) < LEAST_TRAVEL:
            return []  # at rest: what comes later tells more
        notes = check_scales(joined, self.unit, self.where)
        self.done = True
        return notes


def _check_clock(samples: Samples, unit: Unit, where: str) -> None:
    """Refuse rows so far apart that a stroke fits between few of them; ms are named where they would do."""
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
    """Refuse a position that hardly moves, and goes with the pump as it should were its unit a finer one."""
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
