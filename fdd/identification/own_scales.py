"""Are pressures and travel of a log on its own unit's scales? By the sensors' noise and counts,
and where these are not as usual by what the log's balances identify."""

from __future__ import annotations

from math import exp, hypot, log

import numpy as np

from fdd.errors import InputError
from fdd.identification.identify import RELIEF_EXCEEDED, identify_unit
from fdd.identification.judgement import pressure_slip, push_of
from fdd.identification.logs_agree import BETWEEN
from fdd.identification.profile import Ratio, against_base
from fdd.identification.record import Record
from fdd.identification.sensors import LEAST_ZERO, SensorFit, fit_sensors
from fdd.identification.signs import UNLIKE, against_pressure, gain_ratio
from fdd.identification.slips import NEAR, slips
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

RELIEF_OPEN, NOISE_OPEN, COUNTS_OPEN = 0.5, 0.35, 0.1
"""Standard deviations of ln, of a relief setting that is passed, of a sensor's noise, to which motion adds,
and of a converter's counts, which change with the span of its transducer alone."""
LEAST_SLIP = 2.5
"""No two units of one quantity are nearer to each other (`fdd.identification.slips`)."""
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
        for c, f in fit_sensors([samples], [record], unit).items()
        if c in PRESSURES and not (made and c == "pressure_difference")
    }
    _refuse_odd_counts(fits, unit, where)
    of_sensors = _of_sensors(fits, unit)
    plain, _ = gain_ratio(record, unit)
    usual = of_sensors and 1.0 / NEAR < plain < NEAR and all(
        # A sensor reads as the profile's does, nearer than to any other unit's factor.
        abs(log(r.value)) < log(LEAST_SLIP) / 2.0 for r in of_sensors.values()
    )  # fmt: skip
    # Another unit of measure scales a sensor's noise and counts alike: the balances need not be asked of it.
    # A turned sign leaves both, but oil that flows against the pressure.
    if usual and against_pressure(record, unit, where) <= 1.0:
        return []
    ratios = _ratios(samples, unit, where) | of_sensors
    slip, sure = _slipped(ratios, push_of([samples], unit))
    if slip is not None and sure:
        raise InputError(slip, where=where, mend="correct it with --map")
    notes = _gain_notes(ratios, record, unit)
    if slip is not None:
        notes = [f"{slip}, unless a fault did it", *notes]
    # It may not be the gain that is another one, but the pressures that are turned.
    return [] if notes and _turned_fits(samples, unit, where) else notes


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


def difference_is_made(samples: Samples) -> bool:
    """Whether the difference of pressures is that of the chambers' sensors, and has none of its own."""
    if not all(c in samples for c in ("pressure_1", "pressure_2", "pressure_difference")):
        return False
    off = samples["pressure_difference"] - samples["pressure_1"] + samples["pressure_2"]
    off = np.abs(off[np.isfinite(off)])
    return bool(off.size and off.max() < LEAST_ZERO)


def _over_profile(fits: dict[str, SensorFit], unit: Unit, part: str) -> dict[str, float]:
    """Noise or resolution of the pressures over the profile's, where both are known."""
    now = {c: getattr(f.sensor, part) for c, f in fits.items() if part in f.found}
    return {c: v / then for c, v in now.items() if v > 0.0 and (then := getattr(unit.sensor(c), part)) > 0.0}


def _refuse_odd_counts(fits: dict[str, SensorFit], unit: Unit, where: str) -> None:
    """Refuse one pressure whose counts are those of another unit of measure, while the others' are the
    profile's: counts are the converter's, which no fault of oil, machine or transducer changes.

    Raises
    ------
    InputError : names the channel and the unit that it looks like.
    """
    counts = _over_profile(fits, unit, "resolution")
    odd = [c for c, ratio in counts.items() if not 1.0 / NEAR < ratio < NEAR]
    if len(odd) != 1 or len(counts) < 2 or not (looks := slips(counts[odd[0]], "pressure")):
        return
    times = f"{counts[odd[0]]:.3g} times those of profile {unit.name}"
    problem = f"channel {odd[0]}: its counts, and no other pressure's, are {times}"
    raise InputError(problem, where=where, mend=f"check its unit in the map (it looks like {looks})")


def _of_sensors(fits: dict[str, SensorFit], unit: Unit) -> dict[str, Ratio]:
    """Noise and counts of the pressures over the profile's: no fault of oil or machine changes them."""
    out = {}
    for name, part, left_open in (("noise", "noise", NOISE_OPEN), ("counts", "resolution", COUNTS_OPEN)):
        if ratios := _over_profile(fits, unit, part):
            mean = sum(map(log, ratios.values())) / len(ratios)
            out[name] = Ratio(exp(mean), 0.0, left_open)
    return out


def _slipped(ratios: dict[str, Ratio], push: float) -> tuple[str | None, bool]:
    """The unit that the pressures look like, and whether it holds whatever one sign of it is left out."""
    slip = pressure_slip(ratios, push)
    if slip is None:
        return None, False
    rest = [({n: r for n, r in ratios.items() if n != left}, push) for left in ratios]
    held = [pressure_slip(*each) for each in [*rest, (ratios, 1.0)]]
    return slip, len(ratios) > 1 and None not in held


def _turned_fits(samples: Samples, unit: Unit, where: str) -> bool:
    """Whether with its pressures turned the log's travel per rad is the profile's."""
    turned = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}
    columns = {a: samples[b] for a, b in turned.items() if a in samples and b in samples}
    if "pressure_difference" in samples:
        columns["pressure_difference"] = -samples["pressure_difference"]
    found = _ratios(samples.with_columns(columns), unit, where).get("pump.displacement")
    return found is not None and _same_gain(found, unit)


def _same_gain(found: Ratio, unit: Unit) -> bool:
    known = unit.pump.std_of("displacement") or 0.0
    between = BETWEEN["pump.displacement"][0]
    return abs(log(found.value)) < SURE * hypot(found.std, known / unit.pump.displacement, between)


def _gain_notes(ratios: dict[str, Ratio], record: Record, unit: Unit) -> list[str]:
    """A note where the log's travel per rad is surely not the profile's, by balances where they tell."""
    found, known = ratios.get("pump.displacement"), unit.pump.std_of("displacement")
    if known is None:
        return []
    if found is not None:
        ratio, same = found.value, _same_gain(found, unit)
    else:
        ratio, alike = gain_ratio(record, unit)  # but for leakage it lies between the regressions
        same = alike < UNLIKE or (ratio < NEAR and ratio / alike > 1.0 / NEAR)
    if same:
        return []
    return [
        f"travel per rad of the pump is {ratio:.3g} times that of profile {unit.name}: the log is of another "
        "unit, a scale in the channel map is wrong, or a fault did it"
    ]
