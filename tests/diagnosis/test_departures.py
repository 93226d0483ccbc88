"""Amplitudes against what healthy coefficients depart by: closed forms and regimes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_evidence import DRIFT, EFFECTS, FRAMES, LEAK, drawn

from fdd.diagnosis.departures import VAGUE, Array, Departures, changes, departures
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.diagnosis.time_profiles import time_profile_of
from fdd.residuals.bins import FRAME_S


def weighed(
    evidence: Evidence, faults: list[tuple[Hypothesis, int]], *, overdispersion: float | Array = 1.0
) -> Departures:
    """The first of some faults beside the others."""
    columns = {"volume": np.array([[h.columns["volume"] for h, _ in faults]])}
    time_profiles = np.array([[time_profile_of("step", FRAMES, onset) for _, onset in faults]])
    parts = Parts(columns, time_profiles, np.full((1, len(faults)), VAGUE), np.zeros(1, np.bool_))
    factor = np.ones(1) * overdispersion
    return departures(evidence.balances, parts, factor, from_start=faults[0][1] == 0)


def test_from_the_start_a_log_is_weighed_with_the_units_own_spread() -> None:
    """Test: one log. Expected: generalised least squares of its coefficients about the unit's."""
    evidence = drawn(3)
    e = evidence.balances["volume"]
    found = weighed(evidence, [(LEAK, 0)], overdispersion=2.0)
    g = LEAK.columns["volume"]
    estimate = np.linalg.solve(e.total, (e.rest + e.information @ e.solution).sum(axis=0))
    inverse = np.linalg.inv(EFFECTS.covariance + 2.0 * np.linalg.inv(e.total))
    information = g @ inverse @ g
    assert found.information[0] == pytest.approx(information, rel=1e-4)
    assert found.size[0] == pytest.approx(g @ inverse @ (estimate - EFFECTS.mean) / information, rel=1e-4)


@pytest.mark.parametrize("onset", [0, 40])
def test_noise_of_twice_the_variance_is_half_of_the_information(onset: int) -> None:
    """Beside another fault too, and for several factors at once."""
    e = drawn(3).balances["volume"]
    v = e.rest + e.information @ e.solution
    whole, half = (Evidence({"volume": (x * e.information, x * v)}, {"volume": EFFECTS}) for x in (1.0, 0.5))
    for faults in ([(LEAK, onset)], [(LEAK, onset), (DRIFT, 20)]):
        both = weighed(whole, faults, overdispersion=np.array([[1.0], [2.0]]))
        for k, alone in enumerate([weighed(whole, faults), weighed(half, faults)]):
            assert np.allclose([x[k] for x in both], alone, rtol=1e-6)


def test_where_nothing_is_known_before_an_onset_what_follows_resembles_nothing() -> None:
    """Rounding of what is before it, which is nothing, did."""
    e = drawn(6, steady=True).balances["volume"]
    healthy = replace(EFFECTS, log_variance=np.full(3, 0.2**2), within=np.full(3, 1e-3))
    v = e.rest + e.information @ e.solution
    wide = Evidence({"volume": (e.information, v)}, {"volume": healthy}).balances["volume"]
    for before in (0.0, 1e-16, -1e-16):
        assert changes(wide, (1.0 - before) * e.total[None])[0, 0, 0] == pytest.approx(2.0 * 0.2**2, rel=1e-3)


def test_another_duty_may_be_another_draw() -> None:
    """Test: a log whose second half is excited in other directions. Expected: less is told of a change there
    than where both halves are excited alike, by what healthy logs differ by."""
    e = drawn(5).balances["volume"]
    v = e.rest + e.information @ e.solution
    wide = replace(EFFECTS, log_variance=np.full(3, 0.2**2), within=np.full(3, 1e-3))
    turned = e.information.copy()
    for half, kept in ((slice(0, 40), [1.0, 0.05, 0.05]), (slice(40, 80), [0.05, 1.0, 1.0])):
        turned[half] *= np.sqrt(np.outer(kept, kept))
    one, other = (Evidence({"volume": (m, v)}, {"volume": wide}) for m in (e.information, turned))
    alike, unlike = (1.0 / weighed(x, [(LEAK, 40)]).information[0] for x in (one, other))
    assert alike < 0.1**2
    assert unlike > 0.2**2
    # A load's own coefficient is as it was: machines move other loads in other logs, not in another duty.
    loads = replace(wide, own=np.array([False, True, True]))
    same = Evidence({"volume": (turned, v)}, {"volume": loads})
    assert 1.0 / weighed(same, [(LEAK, 40)]).information[0] < 0.1**2


def test_a_log_changes_no_more_than_two_logs_differ() -> None:
    """Test: healthy logs that differ by less than what is assumed of one log. Expected: a change within a log
    is told to the root of two of the difference between logs."""
    e = drawn(6, steady=True).balances["volume"]
    v = e.rest + e.information @ e.solution
    alike = replace(e.healthy, within=np.full(3, 0.5), log_variance=np.full(3, 0.03**2))
    evidence = Evidence({"volume": (e.information, v)}, {"volume": alike})
    std = np.sqrt(1.0 / weighed(evidence, [(DRIFT, 40)]).information[0])
    assert std == pytest.approx(np.sqrt(2.0) * 0.03, rel=0.05)


def test_oil_that_warms_unmeasured_changes_coefficients() -> None:
    """However much a log tells: half of its length at the usual rate, in the viscosity's direction alone."""
    e = drawn(6, steady=True).balances["volume"]
    warms = replace(e.healthy, warming=np.array([0.01, 0.0, 0.0]))
    v = e.rest + e.information @ e.solution
    evidence = Evidence({"volume": (e.information, v)}, {"volume": warms})
    leak, other = (1.0 / weighed(evidence, [(h, 40)]).information[0] for h in (LEAK, DRIFT))
    assert leak == pytest.approx((0.01 * 0.5 * FRAMES * FRAME_S) ** 2, rel=0.05)
    assert other < 0.01 * leak
