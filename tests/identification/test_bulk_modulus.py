"""``fdd experiment bulk-modulus`` on units whose oil is known."""

from __future__ import annotations

import numpy as np
import pytest
from made_units import Case, calibration_logs, random_unit

from fdd.identification.experiments.bulk_modulus import bulk_modulus
from fdd.identification.experiments.outcome import Outcome
from fdd.identification.record import even_record
from fdd.plant import oil as plant_oil
from fdd.residuals.oil import air_compliance
from fdd.samples import Samples
from fdd.unit import Unit

AXIS_A = Unit.load("axis_a")


def outcome(logs: list[Samples], base: Unit = AXIS_A) -> Outcome:
    return bulk_modulus([even_record(log, base, "log") for log in logs], base)


def with_air(unit: Unit, air: float) -> Unit:
    """The same oil with another share of free air: the oil itself stays as stiff."""
    oil = unit.oil
    soft = float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    oil.bulk_modulus = 1.0 / (1.0 / oil.bulk_modulus + (air - oil.air_fraction) * soft)
    oil.air_fraction = air
    return unit


def hits(found: Outcome, truth: Unit) -> list[bool]:
    """Whether each interval holds the plant's own number."""
    inside = []
    for t in found.told:
        if "free air at" in t.quantity:
            true = truth.oil.air_fraction
        elif "without" in t.quantity:
            true = plant_oil.stiff_bulk_modulus(truth.oil)
        else:
            pressure = float(t.quantity.split(" at ")[1].split()[0]) * 1e5
            true = float(plant_oil.bulk_modulus(truth.oil, pressure))
        inside.append(t.low < true < t.high)
    return inside


@pytest.mark.parametrize("air", [0.001, 0.02])
def test_aeration_shows_at_low_pressure(air: float) -> None:
    truth = with_air(random_unit(2), air)
    found = outcome(calibration_logs(truth, 2))
    assert hits(found, truth) == [True] * 4
    free = next(t for t in found.told if "free air" in t.quantity)
    assert not free.low < AXIS_A.oil.air_fraction < free.high
    assert "profile 0.003" in free.note
    fitted = found.curves["fitted"]
    true = plant_oil.bulk_modulus(truth.oil, fitted["pressure"])
    assert fitted["bulk_modulus"] == pytest.approx(true, rel=0.12)
    assert np.mean((fitted["low"] < true) & (true < fitted["high"])) > 0.9


def test_one_throttled_log_is_enough(cases: dict[int, Case]) -> None:
    found = outcome(cases[1].logs[2:3])
    assert len(found.told) >= 3 and all(hits(found, cases[1].truth))


def test_volumes_that_strokes_do_not_tell_widen_the_interval(cases: dict[int, Case]) -> None:
    sines = cases[1].logs[1:2]
    found = outcome(sines)
    assert any("volumes stay" in note for note in found.notes) and all(hits(found, cases[1].truth))
    first = found.told[0]
    assert first.high - first.low > 2.0 * 1.96 * 0.15 * first.value
    known = AXIS_A.model_copy(deep=True)
    for name in ("volume_1", "volume_2"):
        known.cylinder.provenance[name].std = 0.02 * getattr(known.cylinder, name)
    sharper = outcome(sines, known).told[0]
    assert sharper.high - sharper.low < 0.5 * (first.high - first.low)


def test_chambers_never_shut_are_said(cases: dict[int, Case]) -> None:
    log = cases[1].logs[0]
    low = log["pressure_accumulator"]
    never_shut = {"pressure_1": low, "pressure_2": low, "pressure_difference": 0.0 * low}
    found = outcome([log.with_columns(never_shut)])
    assert not found.told and "refeeding" in found.not_told[0] and " 0 % of the time" in found.not_told[0]
