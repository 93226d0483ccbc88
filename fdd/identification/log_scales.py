"""Are a log's units of measure and scales those of the profile? Asked before a diagnosis, as identification
asks it of healthy logs.

Refused is what no machine could be; what a fault could be is told in a note. A fault changes one thing or
two: a pressure in another unit changes all that goes with pressure, each by the slip's factor or its inverse.
"""

from __future__ import annotations

from math import exp, hypot, log

import numpy as np

from fdd.errors import InputError
from fdd.identification import Ratio, signs
from fdd.identification.record import LEAST_TRAVEL, LEAST_ZERO, Record, even_record, fit_sensors
from fdd.logs.quality import nominal_period
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

ENOUGH_S = 120.0
"""s of a log that tell its signs and scales."""
STREAM_S, PAUSE_S = 20.0, 1.0
"""The same of a stream, whose alarms do not wait for it; s of a pause after which they are counted anew."""
STROKE_SHARE = 0.1
"""Of the stroke, that the piston may not pass between two samples."""
FINER = (10.0, 25.4, 1e3, 1e6)
"""Factors between units of length in which a log that hardly moves may have been written."""
NOISE_OPEN, COUNTS_OPEN = 0.35, 0.1
"""Standard deviations of ln, of a sensor's noise, to which motion adds, and of a converter's counts, which
change with the span of its transducer alone."""
LEAST_SLIP = 2.5
"""No two units of one quantity are nearer to each other (`fdd.identification.signs.slips`)."""
TURNED = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}
SURE = 4.0
"""Standard deviations from which on a gain is another one: once in 16 000 logs, were they Gaussian."""


def check_scales(samples: Samples, unit: Unit, where: str) -> list[str]:
    """Refuse a log whose signs and units are not those of its profile; one that hardly moves tells nothing.

    The first two minutes are enough; `where` is what errors call the log. Returns notes, one line each, on
    what a fault may be as well as a wrong unit or profile.

    Raises InputError: the clock, the gain or the pressures are of another unit of measure, the piston goes
        against the pump, or oil flows against the pressure difference.
    """
    _check_clock(samples, unit, where)
    start = samples.rows(0, int(np.searchsorted(samples.time, samples.time[0] + ENOUGH_S)))
    try:
        record = even_record(start, unit, where)
    except InputError:
        _check_travel(start, unit, where)
        return []
    signs.check_gain(record, unit, where)
    signs.check_pump(start, where)
    own = unit.baseline is not None  # else nothing is known of this unit's own scales
    notes = _own_notes(start, record, unit, where) if own else []
    # What oil is lost is judged with the profile's gain, where that is the log's.
    signs.refuse_sign(signs.against_pressure(record, unit, where, own=own and not notes), 1.0, where)
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
        position = joined.get("position")
        known = position[np.isfinite(position)]
        if known.size and np.ptp(known) < LEAST_TRAVEL:
            return []  # at rest: what comes later tells more
        notes = check_scales(joined, self.unit, self.where)
        self.done = True
        return notes


def difference_is_made(samples: Samples) -> bool:
    """Whether the difference of pressures is that of the chambers' sensors, and has none of its own."""
    off = samples.get("pressure_difference") - samples.get("pressure_1") + samples.get("pressure_2")
    off = np.abs(off[np.isfinite(off)])
    return bool(off.size and off.max() < LEAST_ZERO)


def _check_clock(samples: Samples, unit: Unit, where: str) -> None:
    """Refuse rows so far apart that a stroke fits between few of them; ms are named where they would do."""
    period, c = nominal_period(samples.time), unit.cylinder
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
            ratio, alike = signs.gain_ratio(even_record(finer, unit, where), unit)
        except InputError:
            continue
        if alike > signs.UNLIKE and ratio < signs.NEAR and ratio / alike > 1.0 / signs.NEAR:
            raise InputError(
                f"channel position: {ratio / factor:.2g} times the travel per rad of the pump of {unit.name}",
                where=where, mend=f"check its unit in the map{signs.gain_slips(ratio / factor)}",
            )  # fmt: skip


def _own_notes(samples: Samples, record: Record, unit: Unit, where: str) -> list[str]:
    """Notes, one line each, on pressures and travel against the unit's own scales: on what a fault may be as
    well as a log of another unit, or a wrong scale. First by the sensors' noise and counts, then by balances.

    Raises InputError: pressures are surely of another unit of measure.
    """
    of_sensors = _of_sensors(samples, record, unit, where)
    plain, alike = signs.gain_ratio(record, unit)
    usual = of_sensors and 1.0 / signs.NEAR < plain < signs.NEAR and all(
        # A sensor reads as the profile's does, nearer than to any other unit's factor.
        abs(log(r.value)) < log(LEAST_SLIP) / 2.0 for r in of_sensors.values()
    )  # fmt: skip
    # Another unit of measure scales a sensor's noise and counts alike: the balances need not be asked of it.
    # A turned sign leaves both, but oil that flows against the pressure.
    if usual and signs.against_pressure(record, unit, where) <= 1.0:
        return []
    # What identifies imports half a second's worth of scipy, which most logs do not need.
    from fdd.identification.judgement import BETWEEN, alone, pressure_slip, push_of

    def own(found: Ratio) -> bool:
        """Whether the gain is the profile's."""
        std = (unit.pump.std_of("displacement") or 0.0) / unit.pump.displacement
        return abs(log(found.value)) < SURE * hypot(found.std, std, BETWEEN["pump.displacement"][0])

    ratios, push = alone(samples, unit, where) | of_sensors, push_of([samples], unit)
    notes = []
    if slip := pressure_slip(ratios, push):
        # It is sure where it holds whatever one sign of it is left out.
        rest = [({n: r for n, r in ratios.items() if n != left}, push) for left in ratios] + [(ratios, 1.0)]
        if len(ratios) > 1 and all(pressure_slip(*each) for each in rest):
            raise InputError(slip, where=where, mend="correct it with --map")
        notes.append(f"{slip}, unless a fault did it")
    if unit.pump.std_of("displacement") is not None:
        found = ratios.get("pump.displacement")
        if found is not None:
            ratio, same = found.value, own(found)
        else:  # but for leakage it lies between the regressions
            ratio = plain
            same = alike < signs.UNLIKE or (plain < signs.NEAR and plain / alike > 1.0 / signs.NEAR)
        if not same:
            notes.append(
                f"travel per rad of the pump is {ratio:.3g} times that of profile {unit.name}: the log is of "
                "another unit, a scale in the channel map is wrong, or a fault did it"
            )
    if not notes:
        return []
    # It may not be the gain that is another one, but the pressures that are turned.
    columns = {a: samples[b] for a, b in TURNED.items() if a in samples and b in samples}
    if "pressure_difference" in samples:
        columns["pressure_difference"] = -samples["pressure_difference"]
    turned = alone(samples.with_columns(columns), unit, where).get("pump.displacement")
    return [] if turned is not None and own(turned) else notes


def _of_sensors(samples: Samples, record: Record, unit: Unit, where: str) -> dict[str, Ratio]:
    """Noise and counts of the pressures over the profile's; one of another unit by its counts is refused."""
    made = difference_is_made(samples)
    fits = {
        channel: fit
        for channel, fit in fit_sensors([samples], [record]).items()
        if channel in PRESSURES and not (made and channel == "pressure_difference")
    }
    # No fault of oil or machine changes noise; no fault of a transducer the converter's counts.
    out = {}
    for name, part, left_open in (("noise", "noise", NOISE_OPEN), ("counts", "resolution", COUNTS_OPEN)):
        now = {c: f[part] for c, f in fits.items() if part in f}
        then = {c: getattr(unit.sensor(c), part) for c in now}
        ratios = {c: v / then[c] for c, v in now.items() if v > 0.0 and then[c] > 0.0}
        odd = [c for c, ratio in ratios.items() if not 1.0 / signs.NEAR < ratio < signs.NEAR]
        alone = name == "counts" and len(odd) == 1 < len(ratios)
        if alone and (looks := signs.slips(ratios[odd[0]], "pressure")):
            times = f"{ratios[odd[0]]:.3g} times those of profile {unit.name}"
            problem = f"channel {odd[0]}: its counts, and no other pressure's, are {times}"
            raise InputError(problem, where=where, mend=f"check its unit in the map (it looks like {looks})")
        if ratios:
            out[name] = Ratio(exp(sum(map(log, ratios.values())) / len(ratios)), 0.0, left_open)
    return out
