"""Epochs: an hour's frames at most, what stops end, what faults leave out, and their sums."""

from __future__ import annotations

import numpy as np

from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S
from fdd.residuals.effects import first_effects, usual_conditions
from fdd.residuals.epochs import BalanceSums, Epochs

EFFECTS = {name: first_effects(name) for name in BALANCES}
MINUTE = round(60.0 / FRAME_S)


def told(seed: int, *names: str) -> BalanceSums:
    """Normal equations of some balances, of many rows."""
    rng, out = np.random.default_rng(seed), {}
    for name in names:
        x = rng.normal(size=(200, len(BALANCES[name].columns)))
        out[name] = x.T @ x, x.T @ rng.normal(size=200)
    return out


def minutes(epochs: Epochs, start: int, count: int, what: BalanceSums) -> None:
    epochs.add(range(start * MINUTE, (start + count) * MINUTE), what)


def test_a_stop_ends_an_epoch_of_two_minutes_in_motion_or_more() -> None:
    epochs, one, other = Epochs(), told(1, "refeed"), told(2, "refeed")
    minutes(epochs, 10, 1, one)
    epochs.stop()
    assert len(epochs) == epochs.completed == 0, "too short: the next flight goes on with it"
    minutes(epochs, 500, 1, other)
    assert len(epochs) == 0, "nor before the stop"
    epochs.stop()
    assert len(epochs) == epochs.completed == 1
    assert epochs.starts().tolist() == [600.0]
    # One draw of what differs between logs, however many frames it has: variances add up.
    m, v = (a + b for a, b in zip(one["refeed"], other["refeed"], strict=True))
    wide, kept = epochs.marginalised(EFFECTS)["refeed"]
    between = EFFECTS["refeed"].between_logs(usual_conditions(EFFECTS["refeed"].noise))
    right = np.linalg.inv(np.linalg.inv(m) + np.diag(between))
    np.testing.assert_allclose(wide, right[None], rtol=1e-8)
    np.testing.assert_allclose(kept[0], right @ np.linalg.solve(m, v), rtol=1e-8)
    epochs.stop()
    assert epochs.completed == 1, "a stop alone is no epoch"


def hours(*starts: int) -> Epochs:
    epochs = Epochs()
    for start in starts:
        minutes(epochs, 60 * start, 60, told(start, "refeed", *["torque"] * (start > 2)))
    return epochs


def test_epochs_that_began_while_a_fault_stood_are_forgotten() -> None:
    epochs = hours(0, 1, 2, 3, 4)
    minutes(epochs, 300, 5, told(9, "refeed"))
    epochs.forget(3600.0, 3 * 3600.0)
    assert (epochs.starts() / 3600.0).tolist() == [0.0, 3.0, 4.0], "with its onset, up to its end"
    expected = hours(0, 3, 4).marginalised(EFFECTS)
    for name, parts in epochs.marginalised(EFFECTS).items():
        for one, other in zip(parts, expected[name], strict=True):
            np.testing.assert_array_equal(one, other)
    epochs.forget(0.0, 1e9)
    assert len(epochs) == 0
    epochs.stop()
    assert epochs.starts().tolist() == [18_000.0], "what is not complete yet was not looked at"


def test_beyond_sixteen_of_one_length_the_two_oldest_become_one_of_twice_it() -> None:
    epochs, value = Epochs(), (np.eye(4), np.ones(4))
    for hour in range(70):
        minutes(epochs, 60 * hour, 60, {"refeed": value})
        lengths = np.diff([*(epochs.starts() / 3600.0), hour + 1]).astype(int).tolist()
        assert lengths == sorted(lengths, reverse=True), "the older, the longer"
        assert set(lengths) <= {1, 2, 4} and all(lengths.count(n) <= 16 for n in (1, 2, 4))
        if hour in (16, 17):
            assert lengths == [2] + [1] * (hour - 1)
        sums = [float(each["refeed"][0][0, 0]) for each in epochs._sums]
        assert sums == lengths, "each has the hours that it spans"
