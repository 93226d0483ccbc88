"""What a log may differ from its unit by: the profile's doubt, and oil that nobody knows the warmth of."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.faults import CATALOGUE
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import (
    UNKNOWN_VISCOSITY,
    LogConditions,
    first_effects,
    usual_conditions,
    viscous_change,
    with_logs,
)
from fdd.sections import Provenance
from fdd.unit import Unit


class Usual:
    """A healthy unit as the oil's signature asks for it."""

    leakage_ratio = speed_ratio = 1.0

    def mean(self, balance: str, column: str) -> float:
        return float(first_effects(balance).mean[BALANCES[balance].columns.index(column)])


@pytest.mark.parametrize("name", ["volume", "torque"])
def test_unknown_viscosity_moves_coefficients_as_other_oil_does(name: str) -> None:
    """Half the viscosity against the derivative by its logarithm; what goes by the inverse: 1/0.5 - 1 = 1."""
    thin = next(s for s in CATALOGUE["oil_degradation"].signatures if s.label == "thin")
    columns = thin.columns(Usual())[name]
    wanted = np.array([columns.get(c, 0.0) for c in BALANCES[name].columns])
    change = -viscous_change(name, first_effects(name).mean)
    np.testing.assert_allclose(wanted / np.abs(wanted).max(), change / np.abs(change).max(), atol=1e-12)
    if name == "volume":
        np.testing.assert_allclose(wanted, change)


def test_without_a_thermometer_a_log_may_be_of_any_viscosity() -> None:
    """One more draw along the viscosity's direction, no other."""
    first = first_effects("volume")
    change = viscous_change("volume", first.mean)
    warm = usual_conditions(first.noise)
    blind = LogConditions(*warm[:4], 1.0)
    more = with_logs(first, blind, change).covariance - with_logs(first, blind).covariance
    np.testing.assert_allclose(more, UNKNOWN_VISCOSITY**2 * np.outer(change, change))
    one, other = with_logs(first, warm, change), with_logs(first, warm)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_profiles_doubt_about_its_displacement_is_the_gains() -> None:
    unit, gain = Unit.load("axis_a"), BALANCES["volume"].columns.index("gain")
    sure = first_effects("volume", unit=unit).units[gain]
    assert sure == first_effects("volume").units[gain]
    unit.pump.provenance["displacement"] = Provenance(std=0.03 * unit.pump.displacement)
    assert first_effects("volume", unit=unit).units[gain] == pytest.approx(np.hypot(sure, 0.03))
