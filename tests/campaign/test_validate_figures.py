"""Estimates against a known truth, laws that the training had, and what is written of outcomes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_generate import contents, small
from test_train_validate import cells, finding, label, outcome

from fdd.campaign import train
from fdd.campaign.card import card
from fdd.campaign.dataset import Dataset, Label
from fdd.campaign.generate import _trouble, generate
from fdd.campaign.loading import truth_table
from fdd.campaign.scores import Outcome
from fdd.campaign.validate import estimate_errors, summary
from fdd.diagnosis.answering import Z80
from fdd.diagnosis.findings import Trajectories
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.plant.truth import Truth
from fdd.residuals.oil import air_compliance
from fdd.unit import Unit

N = 4000
TIME = np.arange(N) * 0.01
LEAKAGE, BULK = 7e-12, 3e8


def truth(severity: np.ndarray | None = None, bulk: float = BULK) -> Truth:
    time = np.arange(800) * 0.05
    columns = {"leakage": np.full(time.size, LEAKAGE), "bulk_modulus": np.full(time.size, bulk)}
    return Truth(time, columns, {} if severity is None else {"aeration": np.interp(time, TIME, severity)})


def tracked(leak: np.ndarray, bulk: np.ndarray, seen: np.ndarray | None = None) -> Trajectories:
    flags = np.ones(N, dtype=bool) if seen is None else seen
    none = np.empty(0)
    return Trajectories(
        time=TIME, estimates={"ekf": {"leakage": leak, "bulk_modulus": bulk}}, stds={},
        observable={"leakage": flags, "bulk_modulus": flags}, nis={}, window_time=none, feature_names=[],
        features=none, statistic=none, threshold=0.0,
    )  # fmt: skip


def errors(found: Trajectories, of: Truth, profile: Unit | None = None) -> dict[str, tuple[float, float]]:
    axis = Unit.load("axis_a")
    return {n: e for (_, n), e in estimate_errors(found, of, profile or axis, axis).items()}


def test_an_estimates_error_is_its_median_while_it_is_observable_and_settled() -> None:
    leak = np.full(N, LEAKAGE * 1.1)
    leak[TIME <= 5.0] = 1.0  # the first five seconds do not count
    leak[TIME > 30.0] *= 1.1
    seen = TIME < 38.0
    found = errors(tracked(leak, np.full(N, 0.8 * BULK), seen), truth())
    assert found["leakage"] == (pytest.approx(0.1), pytest.approx(33.0 / 40.0, abs=1e-3))
    assert found["bulk_modulus"][0] == pytest.approx(0.2)
    none = errors(tracked(leak, leak, np.zeros(N, dtype=bool)), truth())
    assert np.isnan(none["leakage"][0]) and none["leakage"][1] == 0.0


def test_while_a_fault_changes_the_plant_and_shortly_after_no_estimate_counts() -> None:
    step = (TIME >= 20.0).astype(float)
    leak = np.where((TIME > 19.95) & (TIME < 24.9), 1.0, LEAKAGE)  # lost for as long as a filter may need
    found = errors(tracked(leak, np.full(N, BULK)), truth(step))
    assert found["leakage"][0] == 0.0
    assert found["leakage"][1] == pytest.approx((40.0 - 5.0 - 5.2) / 40.0, abs=0.01)


def test_leakage_is_compared_by_area_and_stiffness_by_volume_over_area() -> None:
    """A profile of 3 % more area and 8 % more volume gives estimates that are right for it."""
    profile = Unit.load("axis_a")
    c = profile.cylinder
    profile.cylinder = c.model_copy(
        update={"area_1": 1.03 * c.area_1, "volume_1": 1.08 * c.volume_1, "volume_2": 1.08 * c.volume_2}
    )
    found = errors(tracked(np.full(N, 1.03 * LEAKAGE), np.full(N, BULK * 1.08 / 1.03)), truth(), profile)
    assert found["leakage"][0] == pytest.approx(0.0, abs=1e-9)
    assert found["bulk_modulus"][0] == pytest.approx(0.0, abs=1e-9)


def test_bulk_modulus_is_compared_at_the_profiles_reference_pressure() -> None:
    """Of oil and free air in it, whose compliances add up (thesis eq. 5.21)."""
    axis = Unit.load("axis_a")
    oil = axis.oil

    def air(pressure: float) -> float:
        return float(air_compliance(pressure, oil.polytropic_index))

    here, there = oil.reference_pressure, 2.0 * oil.reference_pressure
    stiff, share = 1.0 / oil.bulk_modulus - oil.air_fraction * air(here), oil.air_fraction + 0.004
    profile = axis.model_copy(update={"oil": oil.model_copy(update={"reference_pressure": there})})
    found = errors(
        tracked(np.full(N, LEAKAGE), np.full(N, 1.0 / (stiff + share * air(there)))),
        truth(bulk=1.0 / (stiff + share * air(here))),
        profile,
    )
    assert found["bulk_modulus"][0] == pytest.approx(0.0, abs=1e-6)


def with_errors(one: Outcome, leakage: tuple[float, float]) -> Outcome:
    return Outcome(one.entry, one.found, {**one.errors, ("ekf", "leakage"): leakage})


def test_the_summary_counts_what_was_found_and_what_was_answered() -> None:
    leak, air = "internal_leakage", "aeration"
    text = summary([
        with_errors(outcome([label(leak)], [finding(leak)]), (0.01, 1.0)),
        with_errors(outcome([label(leak)], [finding("pump_wear", 11.0)]), (0.03, 0.5)),
        with_errors(outcome([label(leak)], []), (float("nan"), 0.0)),
        with_errors(outcome([label(air)], [finding(air, 5.0)]), (0.05, 0.5)),  # before anything was wrong
    ])  # fmt: skip
    rows = {name: row for name, *row in cells(text.splitlines())}
    assert rows["internal leakage"][:2] == ["3", "2"]
    assert set(rows["internal leakage"][2].split(", ")) == {"internal leakage 1", "pump wear 1"}
    assert rows["internal leakage"][3] == "2.8 s", "the median of 2.5 and 3 s"
    assert rows["aeration"] == ["1", "0", "-", "-"]
    assert rows["EKF leakage"] == ["3.0 %", "4.6 %", "3 of 4", "50 %"]


@pytest.mark.parametrize("true", [0.2, 0.39, 0.5, 0.9])
def test_a_severity_is_as_doubtful_as_its_interval_fell_short(true: float) -> None:
    """With that doubt beside the log's own error, the 80 % interval just reaches the true severity."""
    entry = outcome([label("aeration").model_copy(update={"severity": true})], []).entry
    size, own, known = 0.4, 0.03, 0.1
    half = Z80 * np.hypot(own, known * size)
    said = finding("aeration").model_copy(update={"severity_interval": (size - half, size + half)})
    doubt = train._doubt(entry, [said], known)
    reach = Z80 * np.hypot(own, doubt * size)
    assert reach == pytest.approx(max(abs(true - size), Z80 * own), rel=1e-6)


LEAK, WORN, AIR = "internal_leakage", "pump_wear", "aeration"


def test_labels_truth_table_and_card_carry_law_and_course(tmp_path: Path) -> None:
    recipe = small(units=1, logs_per_unit=3, healthy_share=0.0, faults={LEAK: {"laws": ["opening"]}},
                   profiles={"exponential": 1}, population="stated")  # fmt: skip
    data = Dataset.load(generate(recipe, tmp_path / "set"))
    assert {(f.law, f.profile) for e in data.logs for f in e.faults} == {("opening", "exponential")}
    assert set(truth_table(data)["law"]) == {"opening"}
    text = card(data)
    assert "| opening 3 | exponential 3 |" in text and "fdd.campaign.population" in text
    plain = data.logs[0].faults[0].model_dump()
    del plain["law"]
    assert Label(**plain).law is None, "labels of before the laws"
    assert contents(generate(recipe, tmp_path / "again")) == contents(data.directory)


def test_a_relief_valve_whose_setting_fell_may_relieve() -> None:
    """Else every log in which it shows would be drawn anew."""
    run = simulate(Unit.load("axis_a"), Scenario(
        duration=3.0, load={"name": "constant", "level": 2500.0}, duty={"name": "standstill"},
        faults=[{"fault": "relief_valve_stuck_open", "severity": 0.65, "law": "setting"}],
    ))  # fmt: skip
    assert np.mean(np.abs(run.truth["relief_flow"]) > 1e-7) > 0.5 and not _trouble(run)
    healthy = run.scenario.model_copy(update={"faults": []})
    assert "relief valve" in _trouble(replace(run, scenario=healthy))
