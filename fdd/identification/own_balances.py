"""Are pressures and travel of a log on its own unit's scales? By what the log's balances identify."""

from __future__ import annotations

from math import hypot, log

from fdd.errors import InputError
from fdd.identification.identify import RELIEF_EXCEEDED, identify_unit
from fdd.identification.judgement import BETWEEN, pressure_slip, push_of
from fdd.identification.profile import Ratio, against_base
from fdd.identification.signs import NEAR, UNLIKE
from fdd.samples import Samples
from fdd.unit import Unit

RELIEF_OPEN = 0.5
"""Standard deviation of ln, of a relief setting that is passed."""
TURNED = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}
SURE = 4.0
"""Standard deviations from which on a gain is another one: once in 16 000 logs, were they Gaussian."""


def notes_by_balances(
    samples: Samples, unit: Unit, where: str, of_sensors: dict[str, Ratio], gains: tuple[float, float]
) -> list[str]:
    """Notes, one line each, on what a fault may be as well as a wrong unit or profile.

    Parameters
    ----------
    of_sensors : noise and counts of the pressures over the profile's. gains : travel per rad of the pump over
        the profile's, as `fdd.identification.signs.gain_ratio` gives it.

    Raises
    ------
    InputError : pressures are surely of another unit of measure.
    """
    plain, alike = gains
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


def _same_gain(found: Ratio, unit: Unit) -> bool:
    known = unit.pump.std_of("displacement") or 0.0
    between = BETWEEN["pump.displacement"][0]
    return abs(log(found.value)) < SURE * hypot(found.std, known / unit.pump.displacement, between)
