"""What severity 1 of a valve's fault is, by the catalogue's words, measured from runs by physics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fault_case import ONSET, Case, held, keeps_its_oil, over_time, port_pressure

from fdd.plant.duty import Levels, Strokes
from fdd.plant.faults.spec import FaultScales
from fdd.plant.load import SpringLoad
from fdd.plant.scenario import Control, Recording


def check_valve_stuck_open(case: Case) -> None:
    (_sticks if case.spec.law == "sticking" else _stays_open)(case)


def _stays_open(case: Case) -> None:
    side = case.spec.side or 1
    truth, healthy = case.again(**case.pressed(side))
    over = port_pressure(truth, side) - truth["pressure_accumulator"]
    rows = held(over > 50e3)
    assert rows.sum() > 100
    # Counted at atmospheric density, under 1 %; so small a drop is turbulent to within 1 %.
    np.testing.assert_allclose(
        -truth[f"refeed_flow_{side}"][rows], 1e-4 * np.sqrt(over[rows] / 1e6), rtol=0.015
    )
    stuck, *sound = (
        over_time(each, np.maximum(-each[f"refeed_flow_{k}"], 0.0), each.time > 0.0)
        for each, k in ((truth, side), (healthy, side), (truth, 3 - side))
    )
    assert max(sound) < 0.01 * stuck, "but for what passes while a poppet shuts"
    # The chamber keeps only what the pump gives beside the valve's flow.
    sign = 1.0 if side == 1 else -1.0
    inward = sign * (truth["pump_flow"] - truth["cross_flow"]) - 0.5 * truth["drain_flow"]
    area = case.unit.cylinder.area_1 if side == 1 else case.unit.cylinder.area_2
    passed = float(np.mean(truth[f"refeed_flow_{side}"]))
    assert passed < -1e-6
    moved = sign * area * np.mean(truth["velocity"])
    assert np.mean(inward) + passed == pytest.approx(moved, abs=0.05 * abs(passed))
    keeps_its_oil(truth)


SWINGING: dict[str, Any] = {
    "duration": 12.0, "duty": Strokes(amplitude=0.06, rate=0.04), "recording": Recording.perfect(),
}  # fmt: skip
"""Against a spring, which leaves a chamber low and then presses on it."""


def _sticks(case: Case) -> None:
    """The poppet stays up until the chamber presses on it: by 0.8 MPa, or as much as is asked."""
    side = case.spec.side or 1
    spring = {**SWINGING, "load": SpringLoad(rate=6e4 * case.axis)}
    truth, healthy = case.again(**spring)
    less, _ = case.again(**spring, fault_scales=FaultScales(check_valve_sticking=30e3))
    found = []
    for each in (truth, less, healthy):
        over, back = port_pressure(each, side) - each["pressure_accumulator"], -each[f"refeed_flow_{side}"]
        assert (back < -1e-6).sum() > 100, "it is refed while the other chamber is pressed on"
        found.append(
            (
                over_time(each, np.maximum(back, 0.0), each.time > 0.0),
                over[back > 1e-7].max(initial=0.0),
                over.max(),
            )
        )
    (much, up_to, _), (some, up_to_less, highest), (usual, _, sound) = found
    assert much > some > 20.0 * usual and up_to < 800e3
    # Pressed by that much it shuts within some ms, and the chamber presses as ever.
    assert 29e3 < up_to_less < 300e3 and highest > 0.5 * sound
    keeps_its_oil(truth)


def check_valve_clogged(case: Case) -> None:
    side, law = case.spec.side or 1, case.spec.law
    # Only the chamber that the load leaves low is refed at all, by much where the load swings.
    swinging = {
        **SWINGING, "load": SpringLoad(rate=6e4 * case.axis),
        "fault_scales": FaultScales(check_valve_cracking=150e3),
    }  # fmt: skip
    truth, healthy = case.again(**(swinging if law == "cracking" else case.pressed(3 - side)))
    flow, usual_flow = truth[f"refeed_flow_{side}"], healthy[f"refeed_flow_{side}"]
    assert usual_flow.max() > 1e-6
    low, usual = (port_pressure(each, side) - each["pressure_accumulator"] for each in (truth, healthy))
    if law == "cracking":
        # By that much more before it opens, and from there on as ever; at severity 1 by the charge.
        opening = (flow > 1e-7) & (np.gradient(flow) > 0.0)
        assert flow.max() > 1e-6 and low[opening].max() < -(150e3 + 4e3)
        assert low.min() == pytest.approx(usual.min() - 150e3, abs=20e3)
        most = case.again(**{**swinging, "fault_scales": FaultScales()})[0]
        fallen = port_pressure(most, side) - most["pressure_accumulator"]
        assert fallen.min() < -200e3
        assert fallen[most[f"refeed_flow_{side}"] > 1e-7].max(initial=-np.inf) < -(480e3 + 4e3)
    else:
        assert np.abs(flow).max() <= (0.05 * usual_flow.max() if law == "conductance" else 0.0)
    # Below the accumulator less cracking as never when healthy, yet never below vacuum.
    pressure, sound = truth[f"pressure_{side}"].min(), healthy[f"pressure_{side}"].min()
    assert -101_325.0 < pressure < sound - 30e3
    keeps_its_oil(truth)


def relief_valve_stuck_open(case: Case) -> None:
    (_opens_early if case.spec.law == "setting" else _held_open)(case)


def _opens_early(case: Case) -> None:
    """At a tenth of the setting, as a sound one opens at the whole of it."""
    truth, healthy = case.again(ONSET, **SWINGING, load=SpringLoad(rate=2e4 * case.axis))
    tenth, drop = 0.1 * case.unit.accumulator.relief_pressure, np.abs(truth["port_difference"])
    flow = truth["relief_flow"] * np.sign(truth["port_difference"])
    after = truth.time > ONSET
    assert not healthy["relief_flow"].any() and not flow[~after].any()
    # It follows within some ms: a while above, or a while below.
    for rows, passes in ((drop > tenth + 30e3, True), (drop < 0.9 * tenth - 20e3, False)):
        steady = held(rows & after, 50)  # ten of its lags
        assert steady.sum() > 50
        assert (flow[steady] > 1e-7).all() if passes else np.abs(flow[steady]).max() < 1e-7
    assert not truth["stuck_relief_flow"].any()
    keeps_its_oil(truth)


def _held_open(case: Case) -> None:
    truth, after, drop = case.truth, case.after, case.truth["port_difference"]
    rows = after & (np.abs(drop) > 50e3)
    assert rows.sum() > 200
    flow = truth["stuck_relief_flow"]
    expected = 1e-4 * np.sign(drop) * np.sqrt(np.abs(drop) / 1e6)
    np.testing.assert_allclose(flow[rows], expected[rows], rtol=0.012)
    assert np.all(np.abs(flow[after]) <= np.abs(expected[after]) + 1e-12)
    assert not case.healthy.truth["stuck_relief_flow"].any()
    assert np.abs(truth["relief_flow"]).max() < 1e-9, "the other valve stays shut"
    keeps_its_oil(truth)
    # Against what pump and piston leave over: what chamber 1 gets, on average, is what the piston makes room
    # for, but for the case's leakage and its own compression.
    got = np.mean((truth["pump_flow"] - flow - truth["cross_flow"] - 0.5 * truth["drain_flow"])[after])
    moved = case.unit.cylinder.area_1 * np.mean(truth["velocity"][after])
    assert got == pytest.approx(moved, abs=0.05 * np.mean(np.abs(flow[after])))
    np.testing.assert_allclose(truth["leakage"], case.healthy.truth["leakage"], rtol=1e-3)


def relief_valve_stuck_shut(case: Case) -> None:
    """The pump presses the piston into a stiff spring; a sound valve ends it a little above its setting."""
    truth, healthy = case.again(
        duration=3.0, duty=Levels(points=200.0), control=Control(mode="speed"),
        load=SpringLoad(rate=4e5 * case.axis), recording=Recording.perfect(),
    )  # fmt: skip
    setting = case.unit.accumulator.relief_pressure
    usual, drop = healthy["port_difference"], truth["port_difference"]
    assert setting < usual[-500:].mean() < 1.2 * setting and healthy["relief_flow"][-500:].min() > 1e-5
    assert drop[-500:].mean() > 1.5 * setting
    passing = truth["relief_flow"] > 1e-9
    if case.spec.law == "setting":
        assert drop[passing].min() > 2.8 * setting and drop[-500:].mean() < 3.3 * setting
    else:
        excess = drop[-500:] - setting
        sound = case.unit.accumulator.relief_flow_gain * excess
        assert truth["relief_flow"][-500:].mean() < 0.05 * sound.mean()
    keeps_its_oil(truth)


VALVE_CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check
    for check in (
        check_valve_stuck_open, check_valve_clogged, relief_valve_stuck_open, relief_valve_stuck_shut,
    )
}  # fmt: skip
