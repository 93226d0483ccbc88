"""Are pressures and travel of a log on its own unit's scales? By the sensors' noise and counts."""

from __future__ import annotations

from math import exp, log

import numpy as np

from fdd.errors import InputError
from fdd.identification.profile import Ratio
from fdd.identification.record import Record
from fdd.identification.sensors import LEAST_ZERO, fit_sensors
from fdd.identification.signs import NEAR, against_pressure, gain_ratio, slips
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

NOISE_OPEN, COUNTS_OPEN = 0.35, 0.1
"""Standard deviations of ln, of a sensor's noise, to which motion adds, and of a converter's counts, which
change with the span of its transducer alone."""
LEAST_SLIP = 2.5
"""No two units of one quantity are nearer to each other (`fdd.identification.signs.slips`)."""


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
    # What identifies imports half a second's worth of scipy, which most logs do not need.
    from fdd.identification.own_balances import notes_by_balances

    return notes_by_balances(samples, unit, where, of_sensors, (plain, alike))


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
