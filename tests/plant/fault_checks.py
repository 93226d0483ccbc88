"""Severity 1 of leaks, air, valves and sensors by the words of the catalogue, not of the code, from runs.

How wrong a sensor is, `test_sensor_faults` compares with closed forms.
"""

from typing import Any

import numpy as np
import pytest
from fault_case import CHECKS, ONSET, Case, checked, held, keeps_its_oil, lost, over_time, port_pressure, run

from fdd.plant.details import Details
from fdd.plant.duty import Levels, Sines, Strokes
from fdd.plant.faults import FaultScales
from fdd.plant.oil import viscosity_ratio
from fdd.plant.rig import NoLoad, SpringLoad
from fdd.plant.scenario import Recording


def by_laws(pressure: np.ndarray) -> np.ndarray:
    """Flow of a leak that passes 1 m³/s at 1 MPa: laminar, through a hole, through a gap that it opens."""
    share = pressure / 1e6
    return np.column_stack([share, np.sign(share) * np.sqrt(np.abs(share)), share * np.abs(share)])


@checked
def internal_leakage(case: Case) -> None:
    truth, ratio = case.truth, viscosity_ratio(case.unit.oil, case.truth["oil_temperature"])
    piston = case.spec.law == "piston"
    drop = truth["pressure_difference" if piston else "port_difference"]
    rows = case.after & (np.abs(drop) > 100e3)
    assert rows.sum() > 1000
    # By least squares; the oil is at its reference temperature but for its own losses, 1e-4 of viscosity.
    # Above 100 kPa an orifice's smooth start takes less than 0.3 % off its square root.
    flow = truth["bypass_flow" if piston else "cross_flow"]
    found = np.linalg.lstsq(by_laws(drop[rows]), flow[rows], rcond=None)[0]
    own = 0.0 if piston else 1e6 * case.unit.pump.cross_port_leakage
    added = {"mixed": (10.8e-6, 1.2e-6, 0.0), "orifice": (0.0, 12e-6, 0.0), "opening": (0.0, 0.0, 12e-6)}
    expected = np.array(added.get(str(case.spec.law), (12e-6, 0.0, 0.0)))
    expected[0] += own
    np.testing.assert_allclose(found, expected, atol=0.015 * 12e-6)
    if piston:
        np.testing.assert_array_equal(case.healthy.truth["bypass_flow"], 0.0)
        through = truth["cross_flow"] / truth["port_difference"] * ratio
        np.testing.assert_allclose(through[rows], case.unit.pump.cross_port_leakage, rtol=1e-6)
        return
    # The truth's coefficient is the secant: times the pressure it is the flow, with the case's half of L_T.
    whole = flow + 0.5 * case.unit.pump.case_leakage * drop / ratio
    np.testing.assert_allclose((truth["leakage"] * drop)[rows], whole[rows], rtol=2e-6)


@checked
def external_leakage(case: Case) -> None:
    truth, after = case.truth, case.after
    pressure = truth[f"pressure_{case.spec.side}"]
    assert pressure[after].min() > 50e3 and np.ptp(pressure[after]) > 50e3
    law = ["laminar", "orifice", "opening"].index(str(case.spec.law))
    expected = 6e-6 * by_laws(pressure)[:, law]
    # Counted at atmospheric density: compressed oil is up to 1 % denser. An orifice's flow starts smoothly.
    np.testing.assert_allclose(truth["outside_flow"][after], 1.005 * expected[after], rtol=0.012)
    assert lost(truth, after) == pytest.approx(1.005 * over_time(truth, expected, after), rel=0.012)
    assert abs(lost(case.healthy.truth, after)) < 1e-12
    drained = case.healthy.truth["pressure_accumulator"][-1] - truth["pressure_accumulator"][-1]
    assert drained > 5e3, "the accumulator drains"
    keeps_its_oil(truth)


@checked
def pump_wear(case: Case) -> None:
    """Share of the displacement, ripple, leakage across, into the case and for each rad/s, of each law."""
    left, ripple, across, drained, by_speed = {
        "mixed": (0.98, 0.05, 0.0, 0.0, 12e-14),
        "displacement": (0.9, 0.05, 0.0, 0.0, 0.0),
        "gap": (1.0, 0.05, 8.4e-12, 3.6e-12, 0.0),
        "speed": (1.0, 0.0, 0.0, 0.0, 12e-14),
    }[str(case.spec.law)]
    truth, after, pump = case.truth, case.after, case.unit.pump
    speed, drop = truth["pump_speed"], truth["port_difference"]
    turning = after & (np.abs(speed) > 30.0)
    share = truth["pump_flow"][turning] / (pump.displacement * speed[turning])
    # The gear's teeth ripple as a cosine of their angle, beside the healthy ripple.
    teeth = Details().pump_teeth * truth["pump_angle"][turning]
    # By least squares: a mean over steady speeds meets the same few angles again and again.
    waves = np.column_stack([np.ones(teeth.size), np.cos(teeth), np.sin(teeth)])
    mean, cosine, sine = np.linalg.lstsq(waves, share, rcond=None)[0]
    assert mean == pytest.approx(left, abs=2e-3)
    assert np.hypot(cosine, sine) == pytest.approx(left * (Details().pump_ripple + ripple), rel=0.01)
    pressed = turning & (np.abs(drop) > 100e3)
    assert pressed.sum() > 1000
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"])
    leaking = truth["cross_flow"][pressed] / drop[pressed] * ratio[pressed]
    expected = pump.cross_port_leakage + across + by_speed * np.abs(speed[pressed])
    np.testing.assert_allclose(leaking, expected, rtol=1e-5)
    into_case(case, pump.case_leakage + drained, pump.case_leakage + drained)


def into_case(case: Case, leakage_1: float, leakage_2: float) -> None:
    """Oil of both ports goes into the case, which its check valve holds 5 kPa above the accumulator."""
    truth = case.truth
    above = [port_pressure(truth, k) - truth["pressure_case"] for k in (1, 2)]
    rows = case.after & (np.minimum(*above) > 20e3)
    rows = rows if rows.sum() > 200 else case.after & (above[0] + above[1] > 40e3)
    assert rows.sum() > 200
    expected = leakage_1 * above[0] + leakage_2 * above[1]
    np.testing.assert_allclose(truth["drain_flow"][rows], expected[rows], rtol=0.03)


@checked
def case_drain_seal_failure(case: Case) -> None:
    truth, healthy, own = case.truth, case.healthy.truth, case.unit.pump.case_leakage
    added = (48e-12, 0.0) if case.spec.law == "one" else (24e-12, 24e-12)
    into_case(case, own + added[0], own + added[1])
    draining = case.after & (truth["drain_flow"] > 1e-7)
    cracking = case.unit.accumulator.case_cracking_pressure
    excess = (truth["pressure_case"] - truth["pressure_accumulator"])[draining]
    assert excess.min() > 0.9 * cracking and excess.max() < 2.0 * cracking
    rise = (truth["pressure_accumulator"] - healthy["pressure_accumulator"])[case.after]
    assert np.mean(rise[-1000:]) > 3e3, "its pressure rises"
    assert lost(truth, case.after) == pytest.approx(0.0, abs=1e-12), "it stays inside"
    keeps_its_oil(truth)


@checked
def shaft_seal_wear(case: Case) -> None:
    """1 cm³/min at 487 kPa; by the running law a quarter of it at rest, and as much at 100 rad/s."""
    truth, _ = case.at_speeds("0:0/1.5:100", 3.0, -0.05)
    for low, high, drips in ((0.5, 1.4, 0.25), (2.0, 2.9, 1.0)):
        rows = (truth.time > low) & (truth.time < high)
        minutes = np.ptp(truth.time[rows]) / 60.0
        at_487_kpa = 487e3 / np.mean(truth["pressure_case"][rows])
        expected = 1e-6 if case.spec.law == "steady" else drips * 1e-6
        assert lost(truth, rows) / minutes * at_487_kpa == pytest.approx(expected, rel=0.02), low
    assert lost(case.truth, case.after) > 1e-8
    assert abs(lost(case.healthy.truth, case.after)) < 1e-12
    keeps_its_oil(truth)


@checked
def aeration(case: Case) -> None:
    law, truth, healthy, oil = case.spec.law, case.truth, case.healthy.truth, case.unit.oil
    added = (0.025 * (law != "chamber_2"), 0.025 * (law != "chamber_1"))
    # Once it has settled, over the last second.
    last = truth.time > truth.time[-1] - 1.0
    for k, more in zip((1, 2), added, strict=True):
        ratio = (truth[f"bulk_modulus_{k}"] / healthy[f"bulk_modulus_{k}"])[last]
        # Beside the oil it presses on itself at first.
        low, high = ((0.3, 0.9) if law == "ingress" else (0.25, 0.7)) if more else (0.9, 1.1)
        assert low < ratio.min() and ratio.max() < high, (k, ratio.min(), ratio.max())
    keeps_its_oil(truth)
    quiet = {"details": Details(pump_ripple=0.0, air_law="free"), "recording": Recording.perfect()}
    _comes_in(case, quiet)
    # As the chambers show it: what flows in and is not made room for, over the pressure's rise.
    shaking = Sines(amplitude=0.01, low_hz=3.0, high_hz=8.0, count=4)
    faulty, sound = case.again(**quiet, duration=4.0, duty=shaking, seed=3)
    for shaken, air in ((faulty, added), (sound, (0.0, 0.0))):
        for k, sign in ((1, 1.0), (2, -1.0)):
            cylinder, p = case.unit.cylinder, shaken[f"pressure_{k}"]
            volume, area = getattr(cylinder, f"volume_{k}"), getattr(cylinder, f"area_{k}")
            leak = case.unit.pump.case_leakage * (port_pressure(shaken, k) - shaken["pressure_case"])
            across = shaken["pump_flow"] - shaken["cross_flow"] - shaken["bypass_flow"]
            inflow = sign * (across - area * shaken["velocity"]) - leak + shaken[f"refeed_flow_{k}"]
            # By the polytropic law itself (eqs 5.20 and 5.21): the air at atmospheric pressure.
            absolute, reference = p + 101_325.0, oil.reference_pressure + 101_325.0
            gas, at_reference = ((101_325.0 / a) ** (1.0 / 1.4) / (1.4 * a) for a in (absolute, reference))
            own = oil.air_fraction
            compliance = 1.0 / oil.bulk_modulus - own * at_reference + (own + air[k - 1]) * gas
            taken = (volume + sign * area * shaken["position"]) * compliance * np.gradient(p, shaken.time)
            # From the second second on: air that comes in beside the oil is there within one.
            taken, inflow = taken[2000:-1], inflow[2000:-1]
            assert (taken @ inflow) / (taken @ taken) == pytest.approx(1.0, abs=0.03), (k, air)


def _comes_in(case: Case, quiet: dict[str, Any]) -> None:
    """Air in place of oil moves no pressure, its volume of oil is lost; beside it, oil has to give way."""
    law, unit, onset = case.spec.law, case.unit, 1.0
    truth, sound = case.again(onset, **quiet, duration=4.0, duty=Levels(points=0.0), load=NoLoad())
    at = int(np.searchsorted(truth.time, onset))
    moved = max(np.ptp(truth[f"pressure_{k}"][at - 5 : at + 10]) for k in (1, 2))
    gone, stored = (truth[name][-1] - sound[name][-1] for name in ("oil_lost", "oil_stored"))
    if law == "ingress":
        assert moved > 50e3 and abs(gone) < 1e-12
        assert stored > 1e-7, "the accumulator takes the oil that gives way"
        return
    struck = [k for k in (1, 2) if law in ("exchange", f"chamber_{k}")]
    within = sum(getattr(unit.cylinder, f"volume_{k}") for k in struck)
    taken = 0.025 * (101_325.0 / (unit.accumulator.charge_pressure + 101_325.0)) ** (1.0 / 1.4)
    assert moved < 2e3
    assert gone == pytest.approx(taken * within, rel=0.03)


@checked
def check_valve_stuck_open(case: Case) -> None:
    (_sticks if case.spec.law == "sticking" else _stays_open)(case)


def _stays_open(case: Case) -> None:
    side = case.spec.side or 1
    truth, healthy = case.again(**case.pressed(side))
    over = port_pressure(truth, side) - truth["pressure_accumulator"]
    rows = held(over > 50e3)
    assert rows.sum() > 100
    # Counted at atmospheric density, under 1 %; so small a drop is turbulent to within 1 %.
    refed = truth[f"refeed_flow_{side}"]
    np.testing.assert_allclose(-refed[rows], 1e-4 * np.sqrt(over[rows] / 1e6), rtol=0.015)
    stuck, *sound = (
        over_time(each, np.maximum(-each[f"refeed_flow_{k}"], 0.0), each.time > 0.0)
        for each, k in ((truth, side), (healthy, side), (truth, 3 - side))
    )
    assert max(sound) < 0.01 * stuck, "but for what passes while a poppet shuts"
    # The chamber keeps only what the pump gives beside the valve's flow.
    sign = 1.0 if side == 1 else -1.0
    inward = sign * (truth["pump_flow"] - truth["cross_flow"]) - 0.5 * truth["drain_flow"]
    passed = float(np.mean(refed))
    assert passed < -1e-6
    moved = sign * getattr(case.unit.cylinder, f"area_{side}") * np.mean(truth["velocity"])
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
        let_back = over_time(each, np.maximum(back, 0.0), each.time > 0.0)
        found.append((let_back, over[back > 1e-7].max(initial=0.0), over.max()))
    (much, up_to, _), (some, up_to_less, highest), (usual, _, sound) = found
    assert much > some > 20.0 * usual and up_to < 800e3
    # Pressed by that much it shuts within some ms, and the chamber presses as ever.
    assert 29e3 < up_to_less < 300e3 and highest > 0.5 * sound
    keeps_its_oil(truth)


@checked
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


@checked
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


@checked
def relief_valve_stuck_shut(case: Case) -> None:
    """The pump presses the piston into a stiff spring; a sound valve ends it a little above its setting."""
    truth, healthy = case.at_speeds(200.0, 3.0, load=SpringLoad(rate=4e5 * case.axis))
    setting = case.unit.accumulator.relief_pressure
    usual, drop = healthy["port_difference"], truth["port_difference"]
    assert setting < usual[-500:].mean() < 1.2 * setting and healthy["relief_flow"][-500:].min() > 1e-5
    assert drop[-500:].mean() > 1.5 * setting
    passing = truth["relief_flow"] > 1e-9
    if case.spec.law == "setting":
        assert drop[passing].min() > 2.8 * setting and drop[-500:].mean() < 3.3 * setting
    else:
        sound = case.unit.accumulator.relief_flow_gain * (drop[-500:] - setting)
        assert truth["relief_flow"][-500:].mean() < 0.05 * sound.mean()
    keeps_its_oil(truth)


def measured(case: Case) -> None:
    channel = "position" if str(case.spec.variant).startswith("position") else "pressure_difference"
    faulty, sound = (log.samples[channel][case.after] for log in (case.faulty, case.healthy))
    assert not np.array_equal(faulty, sound, equal_nan=True)
    for name in case.healthy.truth.columns:
        assert np.array_equal(case.truth[name], case.healthy.truth[name]), name


@checked
def position_sensor_slip(case: Case) -> None:
    """Within 5 mm, and the controller follows it."""
    spec = case.spec.model_copy(update={"onset": 0.0})
    long, healthy = (
        run(*faults, axis=case.axis, duration=60.0, recording=Recording.perfect()) for faults in ((spec,), ())
    )
    encoder = case.unit.sensor("position")
    slipped = long.samples["position"] - encoder.gain * long.truth["position"] - encoder.zero
    assert 1e-3 < np.abs(slipped).max() < 5.05e-3
    if case.axis == 1:
        error, usual = (
            np.median(np.abs(out.samples["position_setpoint"] - out.samples["position"]))
            for out in (long, healthy)
        )
        assert error == pytest.approx(usual, rel=0.1), "the loop believes its encoder"


CHECKS |= dict.fromkeys(("pressure_sensor_bias", "pressure_sensor_drift", "sensor_dropout"), measured)
