"""The hidden Markov chain of a fault that comes and goes, beside the sum over all paths."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from made_up_evidence import LEAK, drawn

from fdd.diagnosis.decision import decide
from fdd.diagnosis.hypotheses import AT_START, SWITCHES, coming_and_going


@pytest.mark.parametrize("seed", range(4))
def test_begun_and_acting_are_those_of_all_paths(seed: int) -> None:
    log_odds = np.random.default_rng(seed).normal(scale=3.0, size=6)
    begins, stays = 1.0 / 6.0, 1.0 - SWITCHES
    first = [1.0 - AT_START, AT_START, 0.0]  # not yet, acting, away
    step = [[1.0 - begins, begins, 0.0], [0.0, stays, SWITCHES], [0.0, SWITCHES, stays]]
    total, begun, acting = 0.0, np.zeros(6), np.zeros(6)
    for path in product(range(3), repeat=6):
        states = np.array(path)
        weight = first[path[0]] * np.prod([step[a][b] for a, b in pairwise(path)])
        weight *= np.exp(log_odds[states == 1].sum())
        total, begun, acting = total + weight, begun + weight * (states > 0), acting + weight * (states == 1)
    found = coming_and_going(log_odds)
    np.testing.assert_allclose(found, [begun / total, acting / total], rtol=1e-9, atol=1e-12)
    begun, acting = coming_and_going(np.repeat([-1e6, 1e6], 50))
    assert begun[:50].max() < 1e-6 and acting[50:].min() > 0.999, "any size of odds leaves numbers"


@pytest.mark.parametrize("seed", range(4))
def test_a_leak_that_comes_and_goes_is_dated_and_sized_by_when_it_acts(seed: int) -> None:
    switches = [(LEAK, (-1) ** k * 0.8, frame) for k, frame in enumerate((24, 36, 46, 54, 68))]
    (found, *_), _ = decide(drawn(seed, switches), [LEAK], 4.0)
    assert found.lead.onset == pytest.approx(24, abs=1)
    assert found.lead.active_amplitude == pytest.approx(0.8, abs=0.1)
    acts = found.lead.size * found.lead.time_profile / found.lead.active_amplitude
    true = [any(a <= h < b for a, b in ((24, 36), (46, 54), (68, 80))) for h in range(80)]
    assert np.mean((acts > 0.5) == true) > 0.95
    earliest, latest = found.lead.onset_quantiles(0.1, 0.9)
    assert earliest <= 25 and latest >= 23 and latest - earliest < 8
    doubted = replace(found.lead, begun=np.linspace(0.0, 0.6, 80))
    assert doubted.onset_quantiles(0.5, 0.9) == [66, 79], "no later than the last frame"


def test_a_steady_leak_does_not_come_and_go() -> None:
    """Twenty of them: none explains by breaks more than a law errs by."""
    for seed in range(20):
        (found, *_), _ = decide(drawn(seed, [(LEAK, 0.8, 30)]), [LEAK], 4.0)
        assert found.lead.begun is None
