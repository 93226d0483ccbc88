"""Amplitudes against what healthy coefficients depart by: closed forms, regimes, and SciPy's Student's t."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_evidence import DRIFT, EFFECTS, FRAMES, LEAK, NAME, drawn
from scipy.linalg import block_diag
from scipy.stats import t

from fdd.diagnosis.departures import (
    VAGUE,
    WITHIN_FRAMES,
    Array,
    Departures,
    as_normal,
    by_duty,
    departures,
    freedom,
    heavy_tailed,
)
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.hypotheses import STEP, Hypothesis, Shape, time_profile_of
from fdd.residuals.bins import FRAME_S
from fdd.residuals.effects import DUTY_SCALE, Effects, duty_profiles

GROWN = Shape("drift", 100)


def frames_of(seed: int, *, steady: bool = False) -> tuple[Array, Array]:
    """Information and its product with the coefficients of each frame."""
    e = drawn(seed, steady=steady).balances[NAME]
    return e.information, e.deviation + e.information @ e.healthy.mean


def told(information: Array, vector: Array, healthy: Effects = EFFECTS) -> Evidence:
    return Evidence({NAME: (information, vector)}, {NAME: healthy})


def weighed(
    evidence: Evidence, faults: list[tuple[Hypothesis, int]], *, overdispersion: float | Array = 1.0
) -> Departures:
    """The first of some faults beside the others."""
    columns = {NAME: np.array([[h.columns[NAME] for h, _ in faults]])}
    time_profiles = np.array([[time_profile_of(STEP, FRAMES, onset) for _, onset in faults]])
    parts = Parts(columns, time_profiles, np.full((1, len(faults)), VAGUE), np.zeros(1, np.bool_))
    factor = np.ones(1) * overdispersion
    return departures(evidence.balances, parts, factor, from_start=faults[0][1] == 0)


def variance(evidence: Evidence, fault: Hypothesis) -> float:
    """Of a fault that begins in the middle."""
    return float(1.0 / weighed(evidence, [(fault, 40)]).information[0])


def test_from_the_start_a_log_is_weighed_with_the_units_own_spread() -> None:
    """Test: one log. Expected: generalised least squares of its coefficients about the unit's."""
    evidence = drawn(3)
    e = evidence.balances[NAME]
    found = weighed(evidence, [(LEAK, 0)], overdispersion=2.0)
    g = LEAK.columns[NAME]
    estimate = np.linalg.solve(e.total, np.sum(frames_of(3)[1], axis=0))
    inverse = np.linalg.inv(EFFECTS.covariance + 2.0 * np.linalg.inv(e.total))
    information = g @ inverse @ g
    assert found.information[0] == pytest.approx(information, rel=1e-4)
    assert found.size[0] == pytest.approx(g @ inverse @ (estimate - EFFECTS.mean) / information, rel=1e-4)


@pytest.mark.parametrize("onset", [0, 40])
def test_noise_of_twice_the_variance_is_half_of_the_information(
    onset: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside another fault too, and for several factors; to rounding where no variable is left out."""
    monkeypatch.setattr("fdd.diagnosis.departures.LEAST_INFORMATION", 0.0)
    m, v = frames_of(3)
    whole, half = told(m, v), told(0.5 * m, 0.5 * v)
    for faults in ([(LEAK, onset)], [(LEAK, onset), (DRIFT, 20)]):
        both = weighed(whole, faults, overdispersion=np.array([[1.0], [2.0]]))
        for k, alone in enumerate([weighed(whole, faults), weighed(half, faults)]):
            assert np.allclose([x[k] for x in both], alone, rtol=1e-6)


def test_where_nothing_is_known_before_an_onset_what_follows_resembles_nothing() -> None:
    """Rounding of what is before it, which is nothing, did."""
    healthy = replace(EFFECTS, log_variance=np.full(3, 0.2**2), within=np.full(3, 1e-3))
    wide = told(*frames_of(6, steady=True), healthy).balances[NAME]
    for before in (0.0, 1e-16, -1e-16):
        found = by_duty(wide, (1.0 - before) * wide.total[None])
        assert found[0, 0] == pytest.approx(2.0 * 0.2**2, rel=1e-3)


def test_another_duty_may_be_another_draw() -> None:
    """Where the second half is excited in other directions less is told of a change than where it is not."""
    m, v = frames_of(5)
    wide = replace(EFFECTS, log_variance=np.full(3, 0.2**2), within=np.full(3, 1e-3))
    turned = m.copy()
    for half, kept in ((slice(0, 40), [1.0, 0.05, 0.05]), (slice(40, 80), [0.05, 1.0, 1.0])):
        turned[half] *= np.sqrt(np.outer(kept, kept))
    assert variance(told(m, v, wide), LEAK) < 0.1**2
    assert variance(told(turned, v, wide), LEAK) > 0.2**2
    # A load's own coefficient is as it was: machines move other loads in other logs, not in another duty.
    loads = replace(wide, own=np.array([False, True, True]))
    assert variance(told(turned, v, loads), LEAK) < 0.1**2


@pytest.mark.parametrize("onset", [20, 40, 70])
def test_a_step_is_weighed_beside_a_random_walk(onset: int) -> None:
    """Expected: generalised least squares with the walk's whole covariance about its mean, frame by frame."""
    evidence = drawn(3, frames=FRAMES)
    e, n = evidence.balances[NAME], EFFECTS.mean.size
    within = np.array([0.3, 0.1, 0.2])
    walks = told(*frames_of(3), replace(EFFECTS, within=within, log_variance=np.zeros(n)))
    step = np.minimum.outer(np.arange(FRAMES), np.arange(FRAMES)) + 1.0  # covariance of a walk by frames
    centre = np.eye(FRAMES) - 1.0 / FRAMES
    walk = centre @ step @ centre / WITHIN_FRAMES
    covariance = np.kron(np.ones((FRAMES, FRAMES)), EFFECTS.covariance) + np.kron(walk, np.diag(within**2))
    rows = block_diag(*e.information)
    whole = np.linalg.solve(np.eye(len(rows)) + rows @ covariance, rows)  # information, changes marginalised
    g = np.kron(time_profile_of(STEP, FRAMES, onset), LEAK.columns[NAME])
    found = weighed(walks, [(LEAK, onset)])
    assert found.information[0] == pytest.approx(g @ whole @ g, rel=0.03)
    still = told(*frames_of(3), replace(EFFECTS, within=np.zeros(n)))
    assert weighed(still, [(LEAK, onset)]).information[0] > 1.5 * found.information[0]


@pytest.mark.parametrize("moved", [0.0, 0.6])
def test_a_step_is_weighed_beside_what_a_law_errs_by_at_other_loads(moved: float) -> None:
    """Expected: generalised least squares with the process's whole covariance over load and speed about its
    mean, frame by frame."""
    e, n = drawn(3, frames=FRAMES).balances[NAME], EFFECTS.mean.size
    std = np.array([0.3, 0.1, 0.2])
    load = np.random.default_rng(3).choice([-0.3, 0.0, 0.15], FRAMES) + moved * (np.arange(FRAMES) >= 40)
    duty = np.column_stack([load, np.repeat([0.0, 0.3], FRAMES // 2)])
    healthy = replace(EFFECTS, within=np.zeros(n), log_variance=std**2)
    evidence = Evidence({NAME: frames_of(3)}, {NAME: healthy}, duty=duty)
    alike = np.exp(-np.abs(duty[:, None] - duty).sum(axis=2) / DUTY_SCALE)
    centre = np.eye(FRAMES) - 1.0 / FRAMES
    covariance = np.kron(np.ones((FRAMES, FRAMES)), EFFECTS.covariance)
    covariance += np.kron(centre @ alike @ centre, np.diag(std**2))
    rows = block_diag(*e.information)
    whole = np.linalg.solve(np.eye(len(rows)) + rows @ covariance, rows)  # information, changes marginalised
    g = np.kron(time_profile_of(STEP, FRAMES, 40), LEAK.columns[NAME])
    found = weighed(evidence, [(LEAK, 40)]).information[0]
    assert found == pytest.approx(g @ whole @ g, rel=0.03)
    assert duty_profiles(np.tile([0.4, 0.2], (FRAMES, 1))).size == 0, "one duty: the error is the level's"


def test_a_log_drifts_no_further_than_two_logs_differ() -> None:
    """Of a walk the variance about its mean is a sixth of that at its end; 24 modes have 97 % of it."""
    for within, log_std, end in ((0.5, 0.03, 2.0 * 0.03**2), (0.02, 0.3, 0.02**2 * FRAMES / WITHIN_FRAMES)):
        healthy = replace(EFFECTS, within=np.full(3, within), log_variance=np.full(3, log_std**2))
        e = told(*frames_of(6, steady=True), healthy).balances[NAME]
        # All that the healthy columns let a coefficient vary by, less its level.
        spread = np.sum(np.square(e.basis), axis=2) - np.diag(healthy.covariance)
        assert np.mean(spread, axis=0) == pytest.approx(np.full(3, end / 6.0), rel=0.12)


def test_oil_that_warms_unmeasured_changes_coefficients() -> None:
    """However much a log tells: at the usual rate over 50 s, in the viscosity's direction alone."""
    warms = replace(
        EFFECTS, within=np.zeros(3), wander=1e-4 * EFFECTS.wander, warming=np.array([0.01, 0.0, 0.0])
    )
    evidence = told(*frames_of(6, steady=True), warms)
    parts = Parts({NAME: np.array([[h.columns[NAME]] for h in (LEAK, DRIFT)])},
                  np.tile(time_profile_of(GROWN, FRAMES, 0), (2, 1, 1)), np.full((2, 1), VAGUE),
                  np.zeros(2, np.bool_))  # fmt: skip
    leak, other = 1.0 / departures(evidence.balances, parts, np.ones(2), from_start=False).information
    # It is told by its mean over the log, as far as the level is known, and by its growth.
    mean, level = 0.5 * FRAMES / GROWN.frames, EFFECTS.covariance[0, 0]
    growth = (0.01 * GROWN.frames * FRAME_S) ** 2
    assert leak == pytest.approx(1.0 / (mean**2 / level + 1.0 / growth), rel=0.01)
    assert other < 0.01 * leak


def test_heavy_tailed_is_students_t_of_welchs_degrees_of_freedom() -> None:
    """Beside SciPy's densities: four degrees of freedom of few stretches, normal of many."""
    z = np.array([0.5, 3.0, 12.0])
    ratio, one = 0.5 * z**2, np.ones(3)
    for healthy, blocks, nu in ((1.0, 9.0, 4.0), (0.0, 1.0, 4.0), (0.0, 5.0, 20.0), (0.5, 1e9, 16.0)):
        found = freedom(healthy * one, blocks * one)
        np.testing.assert_allclose(found, nu)
        by_t = t.logpdf(0.0, nu) - t.logpdf(z, nu)
        np.testing.assert_allclose(heavy_tailed(ratio, found), by_t)
        np.testing.assert_allclose(as_normal(by_t, found), ratio)
    np.testing.assert_allclose(heavy_tailed(ratio, freedom(0.0 * one, 1e9 * one)), ratio, rtol=1e-3)
