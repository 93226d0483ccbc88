"""Units of measure: factors against their definitions, round trips, and what is refused."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import constants

from fdd.errors import InputError
from fdd.measures import MEASURES, find_measure, measure
from fdd.samples import CHANNELS

# From SciPy's table of CODATA and NIST SP 811 constants, or from the definition.
DEFINED = {
    "psi": constants.psi,
    "bar": constants.bar,
    "lbf": constants.pound_force,
    "in": constants.inch,
    "deg": constants.degree,
    "rpm": 2.0 * math.pi / constants.minute,
    "L/min": constants.liter / constants.minute,
    "1/h": 1.0 / constants.hour,
    "cm^3/rev": 1e-6 / (2.0 * math.pi),
    "cSt": 1e-6,
    "°C": 1.0,
    "degC": 1.0,
}
PREFIXED = [
    ("mm", "m", 1000), ("cm", "m", 100), ("um", "m", 10**6), ("µm", "m", 10**6), ("mm/s", "m/s", 1000),
    ("cm^2", "m^2", 10**4), ("mm^2", "m^2", 10**6), ("cm^3", "m^3", 10**6), ("mL", "L", 1000),
    ("L", "m^3", 1000), ("ms", "s", 1000), ("us", "s", 10**6), ("ns", "s", 10**9), ("Pa", "kPa", 1000),
    ("kPa", "MPa", 1000), ("mbar", "bar", 1000), ("N", "kN", 1000), ("mA", "A", 1000), ("mV", "V", 1000),
    ("mH", "H", 1000), ("%", "1", 100),
]  # fmt: skip
WRITTEN = [
    ("cm2", "area", 1e-4),
    ("kgf/cm2", "pressure", 98066.5),
    ("m3/s", "flow", 1.0),
    ("furlong", "length", None),
]
TEMPERATURES = [("K", 273.15, 0.0), ("K", 0.0, -273.15), ("degF", 32.0, 0.0), ("degF", 212.0, 100.0)]


@pytest.mark.parametrize("name", DEFINED)
def test_factor_is_the_defined_one(name: str) -> None:
    assert MEASURES[name].factor == pytest.approx(DEFINED[name], rel=1e-12)


@pytest.mark.parametrize(("text", "dimension", "factor"), WRITTEN)
def test_units_as_rigs_write_them(text: str, dimension: str, factor: float | None) -> None:
    found = find_measure(text, dimension)
    assert (None if found is None else found.factor) == (factor and pytest.approx(factor))


@pytest.mark.parametrize(("small", "large", "ratio"), PREFIXED)
def test_prefixes(small: str, large: str, ratio: int) -> None:
    assert MEASURES[small].dimension == MEASURES[large].dimension
    assert MEASURES[small].factor * ratio == pytest.approx(MEASURES[large].factor, rel=1e-14)


@pytest.mark.parametrize(("name", "value", "celsius"), TEMPERATURES)
def test_fixed_points_of_temperature(name: str, value: float, celsius: float) -> None:
    m = MEASURES[name]
    assert m.factor * value + m.offset == pytest.approx(celsius, abs=1e-10)


@pytest.mark.parametrize("channel", [c for c in CHANNELS.values() if c.name != "oil_temperature"])
def test_a_channels_own_unit_is_si(channel: object) -> None:
    unit, dimension = channel.unit, channel.dimension  # type: ignore[attr-defined]
    found = measure(unit, dimension)
    assert (found.factor, found.offset) == (1.0, 0.0)


def test_unknown_names_and_wrong_dimensions_are_told_with_what_would_fit() -> None:
    assert measure(" bar ") is MEASURES["bar"]
    with pytest.raises(InputError, match=r"^unknown unit 'blurp'; use one of: m, cm, mm") as caught:
        measure("blurp", "length")
    assert "bar" not in str(caught.value)
    with pytest.raises(InputError, match=r"'bar' measures pressure, not length; use one of: m, cm"):
        measure("bar", "length")


@given(st.text(max_size=12).filter(lambda s: s.strip() not in MEASURES))
def test_any_other_name_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(InputError) as caught:
        measure(name)
    assert len(str(caught.value).splitlines()) == 1
