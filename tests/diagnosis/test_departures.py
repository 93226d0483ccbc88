"""Amplitudes against what healthy coefficients depart by: closed forms and regimes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_evidence import DRIFT, EFFECTS, FRAMES, LEAK, drawn

from fdd.diagnosis.departures import VAGUE, WITHIN_FRAMES, Departures, departures
from fdd.diagnosis.evidence import Evidence, time_profile_of
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.residuals.bins import FRAME_S


def weighed(
    evidence: Evidence, faults: list[tuple[Hypothesis, int]], *, overdispersion: float = 1.0
) -> Departures:
    """The first of some faults beside the others."""
    columns = {"volume": np.array([[h.columns["volume"] for h, _ in faults]])}
    time_profiles = np.array([[time_profile_of("step", FRAMES, onset) for _, onset in faults]])
    parts = Parts(columns, time_profiles, np.full((1, len(faults)), VAGUE), np.zeros(1, np.bool_))
    return departures(evidence.balances, parts, np.full(1, overdispersion), from_start=faults[0][1] == 0)


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


def test_a_known_fault_takes_its_own_part() -> None:
    """Test: two faults. Expected: beside the second the first has its size; the same twice says nothing."""
    evidence = drawn(4, [(LEAK, 0.8, 30), (DRIFT, 1.5, 50)])
    both = weighed(evidence, [(LEAK, 30), (DRIFT, 50)])
    assert both.size[0] == pytest.approx(0.8, abs=3.0 / np.sqrt(both.information[0]))
    twice = weighed(evidence, [(LEAK, 30), (LEAK, 30)])
    assert twice.information[0] < 1e-3 * both.information[0]


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


def test_healthy_minutes_change_a_coefficient() -> None:
    """However much a log tells: the variance of an amplitude is that of `Effects.within` at least."""
    evidence = drawn(6, steady=True)
    found = weighed(evidence, [(LEAK, 40)])
    drift = EFFECTS.within[0] ** 2 * FRAMES / WITHIN_FRAMES
    assert 1.0 / found.information[0] == pytest.approx(drift, rel=0.2)


@pytest.mark.parametrize("onset", [0, 40])
@pytest.mark.parametrize("told_before", [1e-4, 1.0])
def test_the_healthy_share_is_how_the_variance_goes_with_the_priors(onset: int, told_before: float) -> None:
    """Test: the prior's variance one per cent up and down. Expected: what the amplitude's changes by."""
    e = drawn(9, [(LEAK, 0.5, onset)]).balances["volume"]
    share = np.where(np.arange(FRAMES) < 40, told_before, 1.0)[:, None]
    frames = e.information * share[..., None], (e.rest + e.information @ e.solution) * share
    less, same, more = (
        weighed(
            Evidence({"volume": frames}, {"volume": replace(EFFECTS, covariance=s * EFFECTS.covariance)}),
            [(LEAK, onset)],
        )
        for s in (0.99, 1.0, 1.01)
    )
    slope = (np.log(less.information[0]) - np.log(more.information[0])) / 0.02
    assert same.healthy[0] == pytest.approx(slope, rel=1e-3, abs=1e-6)
    assert same.healthy[0] > 0.5 or (onset == 40 and told_before == 1.0)


@pytest.mark.parametrize("onset", [0, 40])
def test_a_noise_that_scatters_more_is_that_of_fewer_rows(onset: int) -> None:
    """Test: overdispersion of four. Expected: a quarter of the information, the same prior."""
    e = drawn(8, [(LEAK, 0.5, onset)]).balances["volume"]
    v = e.rest + e.information @ e.solution
    whole, quarter = (
        weighed(Evidence({"volume": (m, x)}, {"volume": EFFECTS}), [(LEAK, onset)], overdispersion=k)
        for m, x, k in ((e.information, v, 4.0), (e.information / 4.0, v / 4.0, 1.0))
    )
    assert whole.size[0] == pytest.approx(quarter.size[0], rel=1e-9)
    assert whole.information[0] == pytest.approx(quarter.information[0], rel=1e-9)


def test_oil_that_warms_unmeasured_changes_coefficients() -> None:
    """However much a log tells: half of its length at the usual rate, in the viscosity's direction alone."""
    e = drawn(6, steady=True).balances["volume"]
    warms = replace(e.healthy, warming=np.array([0.01, 0.0, 0.0]))
    v = e.rest + e.information @ e.solution
    evidence = Evidence({"volume": (e.information, v)}, {"volume": warms})
    leak, other = (1.0 / weighed(evidence, [(h, 40)]).information[0] for h in (LEAK, DRIFT))
    assert leak == pytest.approx((0.01 * 0.5 * FRAMES * FRAME_S) ** 2, rel=0.05)
    assert other < 0.01 * leak
