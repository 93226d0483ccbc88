"""The parts of identification, each against something independent; its door, and how more logs count."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from made_units import calibration_logs, identified, random_unit
from scipy import signal
from scipy.signal import butter, sosfilt
from typer.testing import CliRunner

from fdd import Samples, Scenario, identify
from fdd.cli.app import app
from fdd.cli.simulate import write_simulation
from fdd.identification.friction import curve, fit_friction
from fdd.identification.identify import identify_unit
from fdd.identification.record import Record, effective_noise, resolution, welch
from fdd.plant import oil as plant_oil
from fdd.residuals.oil import air_compliance, free_air
from fdd.unit import Cylinder, Unit


@given(st.floats(-5e4, 5e6), st.floats(1.0, 1.6))
def test_shrinkage_is_the_integral_of_compliance(pressure: float, index: float) -> None:
    step = 50.0
    slope = (free_air(pressure + step, index)[0] - free_air(pressure - step, index)[0]) / (2.0 * step)
    assert -float(slope) == pytest.approx(float(air_compliance(pressure, index)), rel=1e-4)


@given(st.floats(1e-7, 1e3), st.integers(0, 2**32 - 1))
def test_resolution_is_the_quantum_of_a_quantised_signal(quantum: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    signal = np.cumsum(rng.normal(0.0, 1.3, 3000)) + rng.normal(0.0, 0.4, 3000)
    assert resolution(quantum * np.rint(signal)) == pytest.approx(quantum, rel=1e-3)


def test_noise_is_that_of_the_low_frequencies() -> None:
    """Band-limited noise with a tone: neighbours differ little, the density below 100 Hz is three times."""
    rng = np.random.default_rng(3)
    time = np.arange(120_000) * 1e-3
    sections = butter(6, 150.0, fs=1000.0, output="sos")
    coloured = sosfilt(sections, rng.normal(0.0, 5.0, time.size)) + 4.0 * np.sin(2 * np.pi * 355.0 * time)
    assert effective_noise(coloured, 1e-3) == pytest.approx(5.0, rel=0.12)


@pytest.mark.parametrize("length", [64, 125])
def test_spectral_densities_are_those_of_scipy(length: int) -> None:
    segments = np.cumsum(np.random.default_rng(1).normal(size=(3, 500)), axis=1)
    expected = signal.welch(segments, 500.0, nperseg=length, detrend="linear", axis=1)
    for mine, theirs in zip(welch(segments, 2e-3, length), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)


def test_noise_is_taken_where_nothing_moves() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(40_000) * 1e-3
    moving = np.where(time < 20.0, 0.0, 50.0 * np.sin(2 * np.pi * 30.0 * time))
    assert effective_noise(rng.normal(0.0, 1.0, time.size) + moving, 1e-3) == pytest.approx(1.0, rel=0.12)
    assert effective_noise(np.zeros(100), 1e-3) is None


def _gusty(seed: int, factor: float, gust: float) -> tuple[Record, Unit]:
    """Two minutes of strokes at 10 to 80 mm/s against friction and gusts (N, lasting a fifth of a second)."""
    unit, period, rng = Unit.load("axis_a"), 2e-3, np.random.default_rng(seed)
    time = np.arange(0.0, 120.0, period)
    strokes = np.cumsum(np.tile([4.0, 2.0, 1.0, 0.5], 16))  # s for 40 mm, there and back in turn
    position = np.interp(time, np.append(0.0, strokes), np.arange(strokes.size + 1) % 2 * 0.04 - 0.02)
    speed = np.gradient(position, period)
    blows = sosfilt(butter(1, 1.0, fs=1.0 / period, output="sos"), rng.standard_normal(time.size))
    blows *= gust / blows.std()
    out, back = (curve(branch, np.abs(speed)) for branch in (unit.friction.forward, unit.friction.reverse))
    friction = np.where(speed > 0, out, back)
    p = (factor * friction * np.sign(speed) + blows + 400.0) / unit.cylinder.area_1
    level = np.full(time.size, 5e5)
    record = Record(
        period=period, angle=position / 3.66e-4, position=position,
        pressure_1=level + np.maximum(p, 0.0), pressure_2=level + np.maximum(-p, 0.0), accumulator=level,
        difference=p, gap=np.zeros(time.size, dtype=bool), chambers_measured=True,
        accumulator_measured=True, has_difference=False, current=None, temperature=None,
    )  # fmt: skip
    return record, unit


def test_friction_is_seen_through_gusts_or_kept() -> None:
    """Gusts as large as it leave twice the base's within three deviations; 30 times as large hide it."""
    coulomb = Unit.load("axis_a").friction.forward.coulomb
    for seed in range(4):
        record, unit = _gusty(seed, 2.0, 600.0)
        fits, _ = fit_friction([record], unit.cylinder, unit.friction)
        found = fits["forward"].estimates["coulomb"]
        assert set(fits) == {"forward", "reverse"}
        assert abs(found.value - 2.0 * coulomb) < 3.0 * found.std < 2.0 * coulomb
    record, unit = _gusty(9, 2.0, 18_000.0)
    fits, notes = fit_friction([record], unit.cylinder, unit.friction)
    assert not fits and "not sharp enough" in notes[0]


def unit_of(seed: int, scale_1: float, scale_2: float, bulk: float = 1.0) -> tuple[Unit, list[Samples]]:
    """A random unit with scaled volumes, and healthy logs of it."""
    unit = random_unit(seed)
    unit.cylinder.volume_1 *= scale_1
    unit.cylinder.volume_2 *= scale_2
    unit.oil.bulk_modulus *= bulk
    return unit, calibration_logs(unit, seed)


def gain_and_split(cylinder: Cylinder, base: Cylinder) -> tuple[float, float]:
    """Mean volume of the base over that of the cylinder; half the chambers' difference over their mean."""
    total = cylinder.volume_1 + cylinder.volume_2
    return (base.volume_1 + base.volume_2) / total, (cylinder.volume_1 - cylinder.volume_2) / total


@pytest.mark.parametrize(("seed", "scale"), [(2, (0.8, 0.9)), (1, (1.0, 1.3))])
def test_volumes_of_both_chambers_are_found(seed: int, scale: tuple[float, float]) -> None:
    truth, logs = unit_of(seed, *scale)
    base = Unit.load("axis_a")
    found = identify_unit(logs, base)
    gain, split = gain_and_split(found.unit.cylinder, base.cylinder)
    true_gain, true_split = gain_and_split(truth.cylinder, base.cylinder)
    assert gain == pytest.approx(true_gain, abs=0.08)
    assert split == pytest.approx(true_split, abs=0.01)
    assert found.unit.cylinder.position_compliance == 1.0
    for chamber in ("volume_1", "volume_2"):
        error = getattr(found.unit.cylinder, chamber) - getattr(truth.cylinder, chamber)
        assert abs(error) < 3.0 * identified(found, f"cylinder.{chamber}")[1]
    # Volume in hand, bulk modulus is no longer relative to the base's: without it it would be up to 15 % off.
    beta = float(plant_oil.bulk_modulus(truth.oil, found.unit.oil.reference_pressure))
    assert found.unit.oil.bulk_modulus == pytest.approx(beta, rel=0.06)
    assert abs(found.unit.oil.bulk_modulus - beta) < 3.0 * identified(found, "oil.bulk_modulus")[1]
    assert any("volumes follow from" in note for note in found.notes)
    assert not any("volumes stay" in note for note in found.notes)


def test_a_gain_of_two_is_no_volume() -> None:
    """A unit of half the volumes and half the bulk modulus: in mid-stroke as compliant as its base."""
    truth, logs = unit_of(1, 0.5, 0.5, 0.5)
    base = Unit.load("axis_a")
    found = identify_unit(logs, base)
    gain, split = gain_and_split(found.unit.cylinder, base.cylinder)
    assert gain == pytest.approx(1.0, abs=1e-9)
    assert split == pytest.approx(0.0, abs=0.01)
    assert found.unit.cylinder.position_compliance == pytest.approx(2.0, abs=0.08)
    _, std = identified(found, "cylinder.position_compliance")
    assert abs(found.unit.cylinder.position_compliance - 2.0) < 3.0 * std < 0.5
    assert any("volumes stay the base's" in note for note in found.notes)
    # Bulk modulus goes with the volumes: twice that of the oil, as the volumes are.
    beta = float(plant_oil.bulk_modulus(truth.oil, found.unit.oil.reference_pressure))
    assert found.unit.oil.bulk_modulus == pytest.approx(2.0 * beta, rel=0.05)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("strokes") / "one.mcap"
    duty = {"name": "constant_speed", "amplitude": 0.08, "speeds": (60.0, 105.0), "turn": 5.0, "dwell": 0.3}
    load = {"name": "throttle", "pressure": 1.5e6}
    scenario = Scenario(duration=21, duty=duty, control={"mode": "speed"}, load=load, seed=6)
    write_simulation(path, Unit.load("axis_a"), scenario)
    return path


def told(unit: Unit) -> dict:
    """The profile without the minute that it was made in."""
    data = yaml.safe_load(unit.to_yaml())
    del data["origin"]["date"]
    return data


@pytest.mark.slow
def test_it_gives_the_profile_of_the_command_line(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "unit.yaml"
    assert CliRunner().invoke(app, ["identify", str(log), "-o", str(out)]).exit_code == 0
    unit = identify([log])
    assert told(unit) == told(Unit.load(out))
    assert unit.baseline and unit.name.startswith("axis_a-")
    unit.save(tmp_path / "again.yaml")
    assert told(Unit.load(tmp_path / "again.yaml")) == told(unit)
