"""What ``python -m reports plant`` measures: peers solve the same problem; what its report says."""

import numpy as np
import pytest

from fdd.plant import state as s
from reports.plant.cases import Cases
from reports.plant.numerics import RealTime, against_half_steps, integrate, real_time, work_precision
from reports.plant.report import Measured, Plan, draw_work, report_lines
from reports.plant.wild import Outcome

pytestmark = pytest.mark.slow
CASES = Cases()


def test_a_peer_solves_the_same_problem():
    """RK45 on commands that arrive a millisecond late: the plant's own states to its tolerance."""
    duration = 0.12
    states, _, commands = CASES.work.states(duration, 8.0)
    peer = integrate(CASES.work, commands, "RK45", 1e-9, 1e-2, duration)
    assert np.ptp(states[:, s.SHARED + s.SPEED]) > 30.0
    np.testing.assert_allclose(peer.states[:, s.SHARED + s.P1], states[:, s.SHARED + s.P1], atol=0.1)
    assert peer.evaluations > 120 * 6 and peer.cpu > 0.0


def test_a_case_is_timed():
    timed = real_time(CASES.speed[0], 2.5, 1)
    assert timed.integration > timed.whole > 1.0
    assert 1.0 <= timed.steps < 10.0


@pytest.fixture(scope="module")
def measured() -> Measured:
    work, trust = work_precision(CASES.work, 0.06, 1)
    halved = against_half_steps(CASES.numerics[1], 1.5)
    return Measured(
        Plan(), [RealTime("steps", 320.0, 400.0, 1.5), RealTime("two axes", 100.0, 120.0, 1.5)], work, trust,
        [halved], [halved], [halved], [Outcome(0, [], 1e4, 0.5, -0.1, 2.0), Outcome(7, ["NaN"])],
    )  # fmt: skip


def test_errors_fall_as_work_rises(measured):
    ours = [point for point in measured.work if point.solver == "this plant"]
    assert [point.evaluations for point in ours] == sorted(point.evaluations for point in ours)
    assert ours[-1].pressure < ours[0].pressure
    assert {point.solver for point in measured.work} == {
        "this plant",
        "SciPy RK45",
        "SciPy LSODA",
        "SciPy Radau",
    }


def test_the_report_says_what_was_found(measured):
    text = "\n".join(report_lines(measured))
    for told in (
        "320",
        "steps, has 320: met",
        "seed 7: NaN",
        "refine 1",
        "SciPy Radau",
        "28 µrad",
        "performance-work.png",
    ):
        assert told in text
    slow = [RealTime("sines", 299.0, 400.0, 1.5)]
    missed = "\n".join(report_lines(Measured(measured.plan, slow, measured.work, measured.trust)))
    assert "299: missed" in missed and "Robustness" not in missed


def test_the_picture_is_drawn(tmp_path, measured):
    path = tmp_path / "work.png"
    draw_work(measured.work, path)
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
