"""Laws of faults: what labels, models and validation say of those that the training had and never saw."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from test_generate import contents, small
from test_train_validate import cells, drawn, finding, label, outcome

from fdd.campaign.card import card
from fdd.campaign.dataset import Dataset, Label
from fdd.campaign.generate import _trouble, generate
from fdd.campaign.loading import truth_table
from fdd.campaign.scores import Outcome
from fdd.campaign.train import learnt
from fdd.campaign.validate import HAD, NEVER, UNSIGNED, by_law, outcomes_csv, summary
from fdd.diagnosis.model import Model
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.unit import Unit

LEAK, WORN, AIR = "internal_leakage", "pump_wear", "aeration"


def of_law(fault: str, law: str | None, said: str = "", *others: str) -> Outcome:
    true = label(fault).model_copy(update={"law": law})
    return outcome([true], [finding(said, 10.5, 0.9, *others)] if said else [])


OUTCOMES = [
    of_law(LEAK, "mixed", LEAK),
    of_law(LEAK, "opening", WORN, LEAK),  # the group has it
    of_law(LEAK, "opening", AIR),
    of_law(LEAK, "opening"),
    of_law(WORN, "gap", WORN),
    of_law("relief_valve_stuck_shut", "shut"),
    of_law("oil_degradation", None, "oil_degradation"),  # has no laws
    outcome([label(LEAK), label(AIR)], [finding(LEAK)]),
    outcome([], []),
]


def test_laws_are_counted_by_whether_the_training_had_them() -> None:
    one, none = "1.00 (0.21 to 1.00) of 1", "0.00 (0.00 to 0.79) of 1"
    assert cells(by_law(OUTCOMES, Model.load())) == [
        [HAD, "", "", one, one, one],
        [NEVER, "", "", "0.75 (0.30 to 0.95) of 4", "0.25 (0.05 to 0.70) of 4", "0.50 (0.15 to 0.85) of 4"],
        [UNSIGNED, "", "", none, none, none],
        ["internal leakage", "mixed", HAD, one, one, one],
        ["internal leakage", "opening", NEVER, "0.67 (0.21 to 0.94) of 3", "0.00 (0.00 to 0.56) of 3",
         "0.33 (0.06 to 0.79) of 3"],
        ["pump wear", "gap", NEVER, one, one, one],
        ["relief valve stuck shut", "shut", UNSIGNED, none, none, none],
    ]  # fmt: skip
    taught = Model.load().model_copy(update={"laws": {LEAK: ["opening"]}})
    assert [row[2] for row in cells(by_law(OUTCOMES, taught))[3:6]] == [HAD, HAD, NEVER], (
        "signatures have the first anyway"
    )
    assert "law it never saw" in summary(OUTCOMES) and "law it never saw" in summary(OUTCOMES, taught)
    plain = [outcome([label(LEAK)], [finding(LEAK)])]
    assert not by_law(plain, taught), "data of before the laws"
    lines = list(csv.DictReader(io.StringIO(outcomes_csv(OUTCOMES))))
    assert [r["true_law"] for r in lines[4:8]] == ["gap", "shut", "-", "- -"]
    assert [r["true_profile"] for r in lines[6:]] == ["step", "step step", ""]


def test_a_model_says_which_laws_it_was_taught(tmp_path: Path) -> None:
    logs = drawn()
    logs[-1] = replace(logs[-1], faults=(LEAK,), laws=((LEAK, "opening"),))
    logs[-2] = replace(logs[-2], faults=(LEAK, WORN), laws=((LEAK, "mixed"), (WORN, "gap")))
    model = learnt(logs, "made up")
    assert model.laws == {LEAK: ["mixed", "opening"], WORN: ["gap"]}
    model.save(tmp_path / "model.json")
    again = Model.load(tmp_path / "model.json")
    assert again == model and again.had(LEAK, "opening") and not again.had(LEAK, "piston")
    assert again.had(WORN, "mixed"), "the first law is in the signature"
    older = learnt(drawn(), "made up")
    older.save(tmp_path / "older.json")
    assert older.laws is None and "laws" not in json.loads((tmp_path / "older.json").read_text())
    assert older.had(LEAK, "mixed") and not older.had(LEAK, "opening")


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
