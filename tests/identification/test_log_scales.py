"""Logs in another unit of measure, or under another unit's profile, are told before they are diagnosed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_units import only, scaled

import fdd
from fdd import InputError, Samples, Unit, read_log
from fdd.identification.log_scales import StreamScales, check_scales
from fdd.samples import PRESSURES

DEMO = Path(fdd.__file__).parent / "demo"


@pytest.fixture(scope="module")
def healthy() -> Samples:
    """The shipped log before its leak begins at 16 s."""
    samples = read_log(DEMO / "demo.mcap").samples
    return samples.rows(0, int(np.searchsorted(samples.time, samples.time[0] + 15.5)))


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load(DEMO / "unit.yaml")


def test_a_sound_log_passes_without_a_word(healthy: Samples, unit: Unit) -> None:
    assert check_scales(healthy, unit, "log") == []


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
def test_another_unit_of_measure_is_refused_in_one_line(healthy, unit, channels, factor, hint) -> None:
    with pytest.raises(InputError, match=hint) as caught:
        check_scales(scaled(healthy, factor, *channels), unit, "log")
    assert str(caught.value).startswith("log: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("channel", ["pressure_1", "pressure_2", "pressure_accumulator"])
@pytest.mark.parametrize("factor, hint", [(0.1, "MPa read as bar"), (0.0689476, "bar read as psi")])
def test_one_pressure_in_another_unit_is_refused_by_name(healthy, unit, channel, factor, hint) -> None:
    """Without a measured difference, which would tell it: a reader makes it of what it reads."""
    wrong = scaled(healthy, factor, channel)
    made = {"pressure_difference": wrong["pressure_1"] - wrong["pressure_2"]}
    with pytest.raises(InputError, match=f"channel {channel}.*{hint}"):
        check_scales(wrong.with_columns(made), unit, "log")


def test_a_transducer_that_reads_high_is_no_other_unit(healthy: Samples, unit: Unit) -> None:
    """Its gain is before the converter, whose counts stay as they are."""
    step = unit.sensor("pressure_1").resolution
    high = {"pressure_1": step * np.rint(1.02 * healthy["pressure_1"] / step)}
    assert check_scales(healthy.with_columns(high), unit, "log") == []


def test_rpm_are_no_centimetres(healthy: Samples, unit: Unit) -> None:
    """Both make the travel per rad about a tenth; a map without a unit makes the pump's mistake alone."""
    speed_alone = only(healthy, *(c for c in healthy.channels if c != "pump_angle"))
    fast = scaled(speed_alone, 30.0 / np.pi, "pump_speed")
    with pytest.raises(InputError, match=r"looks like pump in rpm read as rad/s\)"):
        check_scales(fast, unit, "log")


def test_milliseconds_read_as_seconds_are_refused(healthy: Samples, unit: Unit) -> None:
    with pytest.raises(InputError, match=r"channel time.*ms read as s"):
        check_scales(Samples(1e3 * healthy.time, healthy.columns), unit, "log")


def test_another_units_profile_is_told_in_a_note(healthy: Samples, unit: Unit) -> None:
    """Displacement 10 % off, which a worn pump could be as well."""
    other = unit.model_copy(deep=True)
    other.pump.displacement *= 1.1
    assert any("of another unit" in note for note in check_scales(healthy, other, "log"))


def test_a_log_at_rest_tells_nothing(healthy: Samples, unit: Unit) -> None:
    motion = [name for name in ("position", "pump_angle", "pump_speed") if name in healthy]
    still = healthy.with_columns({name: np.full(len(healthy), healthy[name][0]) for name in motion})
    assert check_scales(still, unit, "log") == []


def parts(log: Samples) -> list[Samples]:
    return [log.rows(a, a + 500) for a in range(0, len(log), 500)]


def test_a_stream_is_held_against_its_profile_once_it_moved(healthy: Samples, unit: Unit) -> None:
    still, sound, wrong = (StreamScales(unit, "axis A1", 10.0) for _ in range(3))
    resting = healthy.with_columns({"position": np.zeros(len(healthy))})
    for part in parts(resting):
        assert still.push(part) == [] and not still.done, "at rest it tells nothing"
    for part in parts(healthy):
        assert sound.push(part) == []
    assert sound.done
    paused = StreamScales(unit, "axis A1", 10.0)
    *early, late = parts(healthy)[:18]
    for part in (*early, Samples(late.time + 3600.0, late.columns)):
        assert paused.push(part) == [] and not paused.done, "neither side of a pause is long enough"
    with pytest.raises(InputError, match=r"axis A1: .*bar read as psi"):
        for part in parts(scaled(healthy, 0.0689476, *PRESSURES)):
            assert wrong.push(part) == [] and part.time[-1] < 10.0
