"""May a profile be used, and may a log be held against it: what a fitter and a reader of logs get wrong."""

from pathlib import Path

import numpy as np
import pytest
from made_units import only, scaled, spread_unit, with_swapped_chambers, work
from scipy.ndimage import uniform_filter1d

import fdd
from fdd import InputError, Scenario, Unit, read_log, simulate
from fdd.diagnosis.baseline import add_baseline
from fdd.identification.identify import identify_unit
from fdd.identification.judgement import Judgement, judge
from fdd.identification.log_scales import StreamScales, check_scales
from fdd.identification.signs import NEAR
from fdd.samples import PRESSURES, Samples
from fdd.sections import Provenance
from tests.refusal import refused as one_line

PLAN = (("strokes", "constant"), ("steps", "spring"), ("flight", "gust"))
MINIMAL = ("position", "pump_speed", "pressure_difference")


def judged(logs: list[Samples], base: Unit | None = None) -> Judgement:
    base = base or Unit.load("axis_a")
    labels = [f"log{k}" for k in range(len(logs))]
    found = identify_unit(logs, base, labels=labels)
    return judge(found, add_baseline(found.unit, logs), base, logs, labels)


def refused(logs: list[Samples], base: Unit | None = None) -> str:
    """Why these logs make no profile: in one line, whether the fit or the judgement says so."""
    try:
        result = judged(logs, base)
    except InputError as error:
        return str(error)
    assert result.verdict == "not usable", result.sentence
    assert "\n" not in result.sentence
    return result.sentence


@pytest.fixture(scope="module")
def healthy() -> list[Samples]:
    unit = spread_unit(1)
    return [work(unit, 40 + k, duty=duty, load=load) for k, (duty, load) in enumerate(PLAN)]


def test_a_healthy_unit_is_usable_gusts_and_all(healthy: list[Samples]) -> None:
    assert judged(healthy).verdict == "usable"


def test_a_gust_that_drives_the_piston_against_the_pump_is_no_wrong_sign() -> None:
    """The pressures do negative work over the whole log, and still hold the piston: oil leaks their way."""
    unit = spread_unit(2)
    gust = {"name": "gust", "deviation": 3000.0, "bandwidth_hz": 0.3}
    log = simulate(unit, Scenario(duration=32.0, duty={"name": "sines"}, load=gust, seed=3)).samples
    log = log.rows(22_000, 32_000)
    drop = uniform_filter1d(log["pressure_1"] - log["pressure_2"], 51)
    done = drop * np.gradient(uniform_filter1d(log["position"], 51))
    assert np.sum(done) < -0.5 * np.sum(np.abs(done))
    assert identify_unit([log], Unit.load("axis_a")).unit.pump.total_leakage > 0.0
    assert "swap pressure_1 and pressure_2" in refused([with_swapped_chambers(log)])


@pytest.mark.slow
@pytest.mark.parametrize("severity", [0.25, 0.5])
def test_the_leaking_log_among_healthy_ones_is_named(healthy: list[Samples], severity: float) -> None:
    fault = {"fault": "internal_leakage", "severity": severity, "onset": 0.0}
    leaking = work(spread_unit(1), 77, duty="steps", load="spring", fault=fault)
    sentence = refused([*healthy[:2], leaking, healthy[2]])
    assert "log2 disagrees with the others: leakage" in sentence


@pytest.mark.slow
def test_a_fault_that_comes_within_a_log_is_named(healthy: list[Samples]) -> None:
    leak = {"fault": "internal_leakage", "severity": 0.8, "onset": 15.0}
    leaking = work(spread_unit(1), 78, duty="steps", load="spring", fault=leak)
    assert "log1 does" in refused([healthy[0], leaking, healthy[2]])


def test_swapped_chambers_and_a_turned_difference(healthy: list[Samples]) -> None:
    channels = ("position", "pump_angle", "pressure_1", "pressure_2")
    swapped = [only(with_swapped_chambers(log), *channels) for log in healthy]
    turned = [scaled(only(log, *MINIMAL), -1.0, "pressure_difference") for log in healthy]
    beside = [scaled(log, -1.0, "pressure_difference") for log in healthy]
    for log in (*swapped, *turned, *beside):
        assert "swap pressure_1 and pressure_2" in refused([log])
    # One among right ones, too.
    assert "swap pressure_1 and pressure_2" in refused([healthy[0], swapped[1], *healthy[2:]])


def test_one_log_cannot_tell_a_leak_from_a_leaky_unit() -> None:
    fault = {"fault": "internal_leakage", "severity": 0.5, "onset": 0.0}
    axis = Unit.load("axis_a")
    leaking = work(axis, 79, duty="steps", load="spring", fault=fault)
    result = judged([leaking])
    assert result.verdict == "usable with limits"
    assert "one log" in " ".join(result.remarks)
    assert float(result.sentence.split("leakage is ")[1].split(" times")[0]) > 1.5
    assert identify_unit([leaking], axis).unit.pump.total_leakage > 1.5 * axis.pump.total_leakage


@pytest.mark.slow
def test_farther_than_manufacturing_leaves_open(healthy: list[Samples]) -> None:
    base = Unit.load("axis_a")
    base.pump.cross_port_leakage *= 5.0
    base.pump.case_leakage *= 5.0
    assert "leakage is 0." in (line := refused(healthy, base)) and "leaves a factor of 3.1 open" in line
    base = Unit.load("axis_a")
    base.pump.displacement *= 1.6
    assert "travel per rad of the pump is 0.6" in refused(healthy, base)


def test_a_throttled_load_is_no_turned_sign() -> None:
    """A load that goes with the speed, whose force a free gain takes for oil flowing backwards."""
    unit = Unit.load("axis_a")
    log = work(unit, 5, duty="steps", load="throttle")
    own = add_baseline(identify_unit([log], unit).unit, [log])
    check_scales(log, own, "log")
    swapped = with_swapped_chambers(log).with_columns({"pressure_difference": -log["pressure_difference"]})
    assert "oil flows against" in one_line(lambda: check_scales(swapped, own, "log"))


def test_a_retracting_single_rod_is_no_turned_sign() -> None:
    """As it stands and with the profile's gain off by twice its own uncertainty."""
    unit = spread_unit(3)
    unit.cylinder.area_2 = 0.6 * unit.cylinder.area_1
    log = work(unit, 7, duty="sines", load="spring")
    own = add_baseline(unit, [log])
    own.pump.provenance["displacement"] = Provenance(source="test", std=0.005 * unit.pump.displacement)
    for off in (1.0, 1.01, 0.99):
        own.pump.displacement = off * unit.pump.displacement
        check_scales(log, own, "log")


def test_wander_beside_a_small_load_is_no_other_unit() -> None:
    """Wander of 46 %, a gain 5 % off: a slope of 0.95 / (1 + 0.46²) = 0.785, which sound sensors may have."""
    unit = spread_unit(4)
    log = work(unit, 8, duty="sines", load="none")
    drop = uniform_filter1d(log["pressure_1"] - log["pressure_2"], 51)
    wander = uniform_filter1d(np.random.default_rng(11).normal(size=len(log)), 301)
    wander *= 0.46 * drop.std() / wander.std()
    log = log.with_columns({"pressure_1": log["pressure_1"] + wander, "pressure_difference": 0.95 * drop})
    seen = uniform_filter1d(log["pressure_1"] - log["pressure_2"], 51)
    assert 0.74 < np.polyfit(seen, 0.95 * drop, 1)[0] < 1.0 / NEAR
    check_scales(log, unit, "log")
    in_psi = log.with_columns({"pressure_difference": 14.5 * 0.95 * drop})
    assert "psi" in one_line(lambda: check_scales(in_psi, unit, "log"))


DEMO = Path(fdd.__file__).parent / "demo"


@pytest.fixture(scope="module")
def shipped() -> Samples:
    """The shipped log before its leak begins at 16 s."""
    samples = read_log(DEMO / "demo.mcap").samples
    return samples.rows(0, int(np.searchsorted(samples.time, samples.time[0] + 15.5)))


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load(DEMO / "unit.yaml")


def test_a_sound_log_passes_without_a_word(shipped: Samples, unit: Unit) -> None:
    assert check_scales(shipped, unit, "log") == []


@pytest.mark.parametrize(
    ("channels", "factor", "hint"),
    [
        (PRESSURES, 0.0689476, "bar read as psi"),
        (PRESSURES, 10.0, "bar read as MPa"),
        (PRESSURES, 0.01, "bar read as kPa"),
        (("pump_angle",), 180.0 / np.pi, "deg read as rad"),
        (("pump_angle",), np.pi / 180.0, "rad read as deg"),
        (("position",), 10.0, "mm read as cm"),
        (("position",), 1e-3, "m read as mm"),
        (("pump_speed",), 30.0 / np.pi, "rpm read as rad/s"),
    ],
)
def test_another_unit_of_measure_is_refused_in_one_line(shipped, unit, channels, factor, hint) -> None:
    line = one_line(lambda: check_scales(scaled(shipped, factor, *channels), unit, "log"))
    assert line.startswith("log: ") and hint in line


@pytest.mark.parametrize("channel", ["pressure_1", "pressure_2", "pressure_accumulator"])
@pytest.mark.parametrize("factor, hint", [(0.1, "MPa read as bar"), (0.0689476, "bar read as psi")])
def test_one_pressure_in_another_unit_is_refused_by_name(shipped, unit, channel, factor, hint) -> None:
    """Without a measured difference, which would tell it: a reader makes it of what it reads."""
    wrong = scaled(shipped, factor, channel)
    made = {"pressure_difference": wrong["pressure_1"] - wrong["pressure_2"]}
    line = one_line(lambda: check_scales(wrong.with_columns(made), unit, "log"))
    assert f"channel {channel}" in line and hint in line


def test_a_transducer_that_reads_high_is_no_other_unit(shipped: Samples, unit: Unit) -> None:
    """Its gain is before the converter, whose counts stay as they are."""
    step = unit.sensor("pressure_1").resolution
    high = {"pressure_1": step * np.rint(1.02 * shipped["pressure_1"] / step)}
    assert check_scales(shipped.with_columns(high), unit, "log") == []


def test_rpm_are_no_centimetres(shipped: Samples, unit: Unit) -> None:
    """Both make the travel per rad about a tenth; a map without a unit makes the pump's mistake alone."""
    speed_alone = only(shipped, *(c for c in shipped.channels if c != "pump_angle"))
    fast = scaled(speed_alone, 30.0 / np.pi, "pump_speed")
    assert "looks like pump in rpm read as rad/s)" in one_line(lambda: check_scales(fast, unit, "log"))


def test_milliseconds_read_as_seconds_are_refused(shipped: Samples, unit: Unit) -> None:
    slow = Samples(1e3 * shipped.time, shipped.columns)
    line = one_line(lambda: check_scales(slow, unit, "log"))
    assert "channel time" in line and "ms read as s" in line


def test_another_units_profile_is_told_in_a_note(shipped: Samples, unit: Unit) -> None:
    """Displacement 10 % off, which a worn pump could be as well."""
    other = unit.model_copy(deep=True)
    other.pump.displacement *= 1.1
    assert any("of another unit" in note for note in check_scales(shipped, other, "log"))


def test_a_log_at_rest_tells_nothing(shipped: Samples, unit: Unit) -> None:
    motion = [name for name in ("position", "pump_angle", "pump_speed") if name in shipped]
    still = shipped.with_columns({name: np.full(len(shipped), shipped[name][0]) for name in motion})
    assert check_scales(still, unit, "log") == []


def parts(log: Samples) -> list[Samples]:
    return [log.rows(a, a + 500) for a in range(0, len(log), 500)]


def test_a_stream_is_held_against_its_profile_once_it_moved(shipped: Samples, unit: Unit) -> None:
    still, sound, wrong = (StreamScales(unit, "axis A1", 10.0) for _ in range(3))
    resting = shipped.with_columns({"position": np.zeros(len(shipped))})
    for part in parts(resting):
        assert still.push(part) == [] and not still.done, "at rest it tells nothing"
    for part in parts(shipped):
        assert sound.push(part) == []
    assert sound.done
    paused = StreamScales(unit, "axis A1", 10.0)
    *early, late = parts(shipped)[:18]
    for part in (*early, Samples(late.time + 3600.0, late.columns)):
        assert paused.push(part) == [] and not paused.done, "neither side of a pause is long enough"
    with pytest.raises(InputError, match=r"axis A1: .*bar read as psi"):
        for part in parts(scaled(shipped, 0.0689476, *PRESSURES)):
            assert wrong.push(part) == [] and part.time[-1] < 10.0
