"""More healthy logs narrow a profile as if it had been made of all of them."""

from __future__ import annotations

import numpy as np
import pytest
from made_units import spread_unit, work

from fdd.diagnosis.baseline import add_baseline
from fdd.errors import InputError
from fdd.identification import identify_unit
from fdd.identification.from_logs import add_logs
from fdd.samples import Samples
from fdd.unit import Unit

PLAN = (("strokes", "constant"), ("steps", "spring"), ("flight", "gust"), ("steps", "constant"))


@pytest.fixture(scope="module")
def logs() -> list[Samples]:
    unit = spread_unit(4)
    return [work(unit, 60 + k, duty=duty, load=load) for k, (duty, load) in enumerate(PLAN)]


@pytest.fixture(scope="module")
def profile(logs: list[Samples]) -> Unit:
    return add_baseline(identify_unit(logs[:2], Unit.load("axis_a")).unit, logs[:2])


def test_added_logs_count_as_if_all_had_been_there(
    logs: list[Samples], profile: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coefficients within half of their standard deviation, these within 5 %, of the sums of all logs.

    What the unit's logs differ by stays as the first ones told it (`moderation`): here as any unit's do.
    """
    monkeypatch.setattr("fdd.diagnosis.baseline.moderation", lambda name, logs, e: np.ones(len(e.mean)))
    profile = add_baseline(profile, logs[:2])
    found, added = add_logs(logs[2:], profile)
    together = add_baseline(profile, logs)
    assert added.baseline is not None and together.baseline is not None and profile.baseline is not None
    assert added.baseline.seconds == pytest.approx(together.baseline.seconds)
    assert set(added.baseline.balances) == set(together.baseline.balances)
    for name, one in added.baseline.balances.items():
        other, before = together.baseline.balances[name], profile.baseline.balances[name]
        std, std_all = (np.sqrt(np.diag(np.array(b.covariance))) for b in (one, other))
        assert np.all(np.abs(np.array(one.mean) - other.mean) < 0.5 * std_all), name
        np.testing.assert_allclose(std, std_all, rtol=0.05)
        assert np.all(std <= np.sqrt(np.diag(np.array(before.covariance))) * (1.0 + 1e-6))
        assert one.noise == pytest.approx(other.noise, rel=0.25)
    assert {row.quantity for row in found.balances} >= {"leakage", "travel per rad of the pump"}
    assert added.pump == profile.pump and added.cylinder == profile.cylinder


def test_a_profile_without_its_balances_takes_no_logs(logs: list[Samples], profile: Unit) -> None:
    bare = profile.model_copy(update={"baseline": None})
    assert profile.baseline is not None
    older = profile.model_copy(update={"baseline": profile.baseline.model_copy(update={"version": "5"})})
    for unit in (bare, older):
        with pytest.raises(InputError, match="no healthy baseline of this version"):
            add_logs(logs[2:3], unit)
