"""What healthy logs say of how a balance errs, and of a unit's own variances from log to log."""

import numpy as np
import pytest
from simulated_logs import HEALTHY, simulated

from fdd.diagnosis.baseline import PRIOR_LOGS, baseline_of, effects_of, histories_of, moderation
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.effects import LogConditions, first_effects, usual_conditions
from fdd.unit import Unit


@pytest.fixture(scope="module")
def histories() -> list[BalanceHistory]:
    return histories_of(Unit.load("axis_a"), [simulated(seed, load) for seed, load in HEALTHY])


def test_three_logs_tell_a_unit_better_than_one(histories: list[BalanceHistory]) -> None:
    whole, first = baseline_of(histories), baseline_of(histories[:1])
    assert whole.seconds == pytest.approx(3.0 * 32.0, abs=1.5)
    for name, other in whole.balances.items():
        alone = first.balances[name]
        assert other.hops > alone.hops
        std, std_alone = (np.sqrt(np.diag(np.array(b.covariance))) for b in (other, alone))
        assert (std <= 1.001 * std_alone).all(), name
        # Three alike logs leave 1 / √(3 - 2 r²) of r = std_alone / units, 0.6 to 0.7 here; under three loads
        # they tell a pressure's gain unequally.
        told = std_alone < 0.7 * first_effects(name).units
        assert (std < 0.85 * std_alone).any() or not told.any(), name


def test_what_an_older_fdd_learnt_in_another_scale_counts_for_nothing(histories):
    unit = Unit.load("axis_a").model_copy(deep=True)
    unit.baseline = baseline_of(histories)
    now = effects_of(unit)
    unit.baseline.version = "15"
    before = effects_of(unit)
    assert np.array_equal(before["volume"].mean, now["volume"].mean)
    assert np.array_equal(before["refeed"].mean, first_effects("refeed").mean)
    assert not np.array_equal(now["refeed"].mean, first_effects("refeed").mean)


def test_a_log_is_held_against_its_units_baseline_and_what_differs_between_logs(histories):
    unit = Unit.load("axis_a")
    unit.baseline = baseline_of(histories)
    one = unit.baseline.balances["force"]
    one.columns = one.columns[::-1]  # of other columns: those of another version
    for name, e in effects_of(unit).items():
        first, known = first_effects(name), unit.baseline.balances.get(name)
        if known is None or name == "force":
            np.testing.assert_array_equal(e.mean, first.mean)
            np.testing.assert_array_equal(e.covariance, first.covariance)
        else:
            np.testing.assert_array_equal(e.mean, known.mean)
            between = np.diag(e.covariance) - np.diag(np.array(known.covariance))
            usual = first.between_logs(usual_conditions(known.noise)) * known.moderation
            within = first.within * np.sqrt(known.moderation)
            np.testing.assert_allclose([between, e.within], [usual, within], rtol=1e-6)
            assert e.noise == known.noise and e.information.any() and e.scatter.any()


USUAL = LogConditions(1.0, 0.0, 0.0, 0.0, 0.0)
FIRST = first_effects("coherence")


def logs(std: float, count: int, precision: float, seed: int = 5) -> list:
    """Logs whose coefficients depart by so many of the population's standard deviations, all but known."""
    rng = np.random.default_rng(seed)
    between = np.sqrt(FIRST.between_logs(USUAL))
    information = np.diag(precision / between**2)
    drawn = FIRST.mean + std * between * rng.standard_normal((count, FIRST.mean.size))
    return [(information, information @ theta, USUAL) for theta in drawn]


@pytest.mark.parametrize("std", [0.3, 1.0, 4.0])
def test_many_logs_tell_a_units_own_variance(std: float) -> None:
    factor = moderation("coherence", logs(std, 400, 1e4), FIRST)
    # The variance of 400 normal values scatters by 7 %.
    np.testing.assert_allclose(factor, (PRIOR_LOGS + 400 * std**2) / (PRIOR_LOGS + 400), rtol=0.25)


def test_logs_that_tell_nothing_leave_the_populations() -> None:
    np.testing.assert_allclose(moderation("coherence", logs(4.0, 3, 1e-9), FIRST), 1.0, atol=1e-3)
