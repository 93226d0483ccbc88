"""Are pressures and travel of a log on its own unit's scales? By the sensors' noise and counts,
and where these are not as usual by what the log's balances identify."""

from __future__ import annotations

from math import exp, hypot, log

import numpy as np

from fdd.errors import InputError
from fdd.identification.identify import RELIEF_EXCEEDED, identify_unit
from fdd.identification.judgement import BETWEEN, pressure_slip, push_of
from fdd.identification.profile import Ratio, against_base
from fdd.identification.record import Record
from fdd.identification.sensors import LEAST_ZERO, fit_sensors
from fdd.identification.signs import NEAR, UNLIKE, against_pressure, gain_ratio, slips
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

RELIEF_OPEN, NOISE_OPEN, COUNTS_OPEN = 0.5, 0.35, 0.1
"""Standard deviations of ln, of a relief setting that is passed, of a sensor's noise, to which motion adds,
and of a converter's counts, which change with the span of its transducer alone."""
LEAST_SLIP = 2.5
"""No two units of one quantity are nearer to each other (`fdd.identification.signs.slips`)."""
TURNED = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}
SURE = 4.0
"""Standard deviations from which on a gain is another one: once in 16 000 logs, were they Gaussian."""


def own_notes(samples: Samples, record: Record, unit: Unit, where: str) -> list[str]:
    """Notes, one line each, on what a fault may be as well as a wrong unit or profile.

    Raises
    ------
    InputError : pressures are surely of another unit of measure.
    """
    made = difference_is_made(samples)
    fits = {
        c: f
        for c, f in fit_sensors([samples], [record]).items()
        if c in PRESSURES and not (made and c == "pressure_difference")
    }
    of_sensors = _of_sensors(fits, unit, where)
    plain, alike = gain_ratio(record, unit)
    usual = of_sensors and 1.0 / NEAR < plain < NEAR and all(
        # A sensor reads as the profile's does, nearer than to any other unit's factor.
        abs(log(r.value)) < log(LEAST_SLIP) / 2.0 for r in of_sensors.values()
    )  # fmt: skip
    # Another unit of measure scales a sensor's noise and counts alike: the balances need not be asked of it.
    # A turned sign leaves both, but oil that flows against the pressure.
    if usual and against_pressure(record, unit, where) <= 1.0:
        return []
    ratios, push = _ratios(samples, unit, where) | of_sensors, push_of([samples], unit)
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
            ratio, same = found.value, _same_gain(found, unit)
        else:  # but for leakage it lies between the regressions
            ratio, same = plain, alike < UNLIKE or (plain < NEAR and plain / alike > 1.0 / NEAR)
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
    turned = _ratios(samples.with_columns(columns), unit, where).get("pump.displacement")
    return [] if turned is not None and _same_gain(turned, unit) else notes


def _ratios(samples: Samples, unit: Unit, where: str) -> dict[str, Ratio]:
    """What the log alone identifies, over the profile's; empty where it identifies nothing."""
    try:
        found = identify_unit([samples], unit, labels=[where])
    except InputError:
        return {}
    ratios = against_base(found, unit)
    setting = unit.accumulator.relief_pressure
    for row in found.table:
        if row.quantity == "accumulator.relief_pressure" and row.identified is not None:
            # A valve passes a little more than its setting; how far beyond, tells the pressures' scale.
            ratios[row.quantity] = Ratio(row.identified / setting / RELIEF_EXCEEDED, 0.2, RELIEF_OPEN)
    return ratios


def difference_is_made(samples: Samples) -> bool:
    """Whether the difference of pressures is that of the chambers' sensors, and has none of its own."""
    if not all(c in samples for c in ("pressure_1", "pressure_2", "pressure_difference")):
        return False
    off = samples["pressure_difference"] - samples["pressure_1"] + samples["pressure_2"]
    off = np.abs(off[np.isfinite(off)])
    return bool(off.size and off.max() < LEAST_ZERO)


def _of_sensors(fits: dict[str, dict[str, float]], unit: Unit, where: str) -> dict[str, Ratio]:
    """Noise and counts of the pressures over the profile's; one of another unit by its counts is refused."""
    # No fault of oil or machine changes noise; no fault of a transducer the converter's counts.
    out = {}
    for name, part, left_open in (("noise", "noise", NOISE_OPEN), ("counts", "resolution", COUNTS_OPEN)):
        now = {c: f[part] for c, f in fits.items() if part in f}
        then = {c: getattr(unit.sensor(c), part) for c in now}
        ratios = {c: v / then[c] for c, v in now.items() if v > 0.0 and then[c] > 0.0}
        odd = [c for c, ratio in ratios.items() if not 1.0 / NEAR < ratio < NEAR]
        if name == "counts" and len(odd) == 1 < len(ratios) and (looks := slips(ratios[odd[0]], "pressure")):
            times = f"{ratios[odd[0]]:.3g} times those of profile {unit.name}"
            problem = f"channel {odd[0]}: its counts, and no other pressure's, are {times}"
            raise InputError(problem, where=where, mend=f"check its unit in the map (it looks like {looks})")
        if ratios:
            out[name] = Ratio(exp(sum(map(log, ratios.values())) / len(ratios)), 0.0, left_open)
    return out


def _same_gain(found: Ratio, unit: Unit) -> bool:
    known = unit.pump.std_of("displacement") or 0.0
    between = BETWEEN["pump.displacement"][0]
    return abs(log(found.value)) < SURE * hypot(found.std, known / unit.pump.displacement, between)
