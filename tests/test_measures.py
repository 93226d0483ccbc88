"""Units of measure: factors against their definitions, round trips, and what is refused."""

from __future__ import annotations

import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.measures import _NOT_BY_PINT, MEASURES, find_measure, measure
from fdd.samples import CHANNELS
from tests.refusal import refused

WRITTEN = [
    ("cm2", "area", 1e-4), ("kgf/cm2", "pressure", 98066.5), ("m3/s", "flow", 1.0),
    ("furlong", "length", None),
]  # fmt: skip
# Of the few units that pint does not have in our sense, from the definition.
DEFINED = {"1/h": 1.0 / 3600.0, "%": 0.01, "1": 1.0}


def test_factors_and_fixed_points_are_those_of_pint() -> None:
    registry = pint.UnitRegistry()
    base: dict[str, str] = {}
    for name, each in MEASURES.items():
        si = base.setdefault(each.dimension, name)
        if each.dimension in _NOT_BY_PINT or each.dimension == "temperature":
            assert name not in DEFINED or each.factor == DEFINED[name]
        elif name:
            factor = registry.Quantity(1.0, name.replace("rev", "turn")).to(si).magnitude
            assert (each.factor, each.offset) == (pytest.approx(factor, rel=1e-12), 0.0), name
    for name in ("K", "degF", "degC", "°C"):
        for value in (0.0, 100.0):
            celsius = registry.Quantity(value, name).to("degC").magnitude
            ours = MEASURES[name].factor * value + MEASURES[name].offset
            assert ours == pytest.approx(celsius, abs=1e-10), name


@pytest.mark.parametrize(("text", "dimension", "factor"), WRITTEN)
def test_units_as_rigs_write_them(text: str, dimension: str, factor: float | None) -> None:
    found = find_measure(text, dimension)
    assert (None if found is None else found.factor) == (factor and pytest.approx(factor))


def test_a_channels_own_unit_is_si() -> None:
    for channel in (c for c in CHANNELS.values() if c.name != "oil_temperature"):
        found = measure(channel.unit, channel.dimension)
        assert (found.factor, found.offset) == (1.0, 0.0), channel.name


def test_unknown_names_and_wrong_dimensions_are_told_with_what_would_fit() -> None:
    assert measure(" bar ") is MEASURES["bar"]
    line = refused(lambda: measure("blurp", "length"))
    assert line.startswith("unknown unit 'blurp'; use one of: m, cm, mm") and "bar" not in line
    line = refused(lambda: measure("bar", "length"))
    assert "'bar' measures pressure, not length; use one of: m, cm" in line


@given(st.text(max_size=12).filter(lambda s: s.strip() not in MEASURES))
def test_any_other_name_is_refused_in_one_line(name: str) -> None:
    refused(lambda: measure(name))
