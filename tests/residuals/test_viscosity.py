"""Walther's law through an oil's two data-sheet points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.plant.oil import viscosity
from fdd.residuals.oil import viscosity_ratio
from fdd.unit import Oil, Unit


def oil_of(at_40: float, at_100: float, reference: float) -> Oil:
    """Axis A's oil with other viscosities (cSt)."""
    points = {"viscosity_40": at_40 * 1e-6, "viscosity_100": at_100 * 1e-6}
    return Unit.load("axis_a").oil.model_copy(update={**points, "reference_temperature": reference})


oils = st.builds(
    lambda at_40, share, reference: oil_of(at_40, 1.0 + share * (at_40 - 1.0), reference),
    st.floats(8.0, 400.0), st.floats(0.05, 0.5), st.floats(0.0, 90.0),
)  # fmt: skip


@given(oils, st.floats(-20.0, 120.0))
def test_is_a_straight_line_in_walthers_coordinates(oil: Oil, celsius: float) -> None:
    at_reference = viscosity(oil, oil.reference_temperature)
    centistokes = viscosity_ratio(oil, [40.0, 100.0, celsius]) * float(at_reference) * 1e6
    ordinate = np.log10(np.log10(centistokes + 0.7))
    abscissa = np.log10(np.array([40.0, 100.0, celsius]) + 273.15)
    line = np.polyfit(abscissa[:2], ordinate[:2], 1)
    assert ordinate[2] == pytest.approx(np.polyval(line, abscissa[2]), abs=1e-7)


def test_agrees_with_the_plants_own_law() -> None:
    oil = Unit.load("axis_a").oil
    celsius = np.linspace(-20.0, 110.0, 27)
    expected = viscosity(oil, celsius) / viscosity(oil, 40.0)
    np.testing.assert_allclose(viscosity_ratio(oil, celsius), expected, rtol=1e-9)


def test_absurd_temperatures_stay_finite() -> None:
    found = viscosity_ratio(Unit.load("axis_a").oil, [-300.0, 1e6])
    assert np.isfinite(found).all() and (found > 0.0).all()
