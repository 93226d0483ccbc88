"""The verdict in words, against sentences written by hand."""

from pathlib import Path

import numpy as np
from pages import case

from fdd.diagnosis.findings import Quality
from fdd.report import tables
from fdd.report.tables import estimate_rows, number, with_std
from fdd.report.words import finding_words, headline, likely, percent, severity_one, span, verdict_words
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_fault_in_one_line_with_the_shares_of_its_group():
    diagnosis = case(rows=60_000).diagnosis
    words = verdict_words(diagnosis)
    assert words.headline == "Internal leakage or pump gear wear, since 20.3 s, severity 0.41, 97 % sure"
    (found,) = words.findings
    assert "pump gear wear" in found.alternatives and "internal leakage" not in found.alternatives
    assert found.detection == "Detected at 20.9 s, 0.6 s after its onset."
    diagnosis.faults[0].onset_interval = (19.5, 20.5)
    (found,) = verdict_words(diagnosis).findings
    assert found.detection.endswith(" after its onset. It began between 19.5 s and 20.5 s (80 %).")
    assert found.severity.startswith("Severity between 0.35 and 0.47 (80 %). Severity 1.0 means: ")
    assert "12e-12" in found.severity and found.place == ""
    assert found.check == "To confirm it: Block the rod and read the pump's speed."
    finding = diagnosis.faults[0]
    finding.ambiguity, finding.severity = ["internal_leakage"], None
    finding.side, finding.variant = 2, "loose_forward"
    (found,) = verdict_words(diagnosis).findings
    assert found.alternatives == "" and "severity" not in found.headline
    assert found.place == "Where and how: chamber 2, loose forward."
    finding.side, finding.variant, finding.channel = None, None, "pressure_1"
    assert finding_words(finding).place == "Where and how: pressure 1."
    finding = case(rows=6_000).diagnosis.faults[0]
    finding.ambiguity = ["internal_leakage", "pump_wear", "oil_degradation"]
    finding.shares = {"internal_leakage": 0.55, "pump_wear": 0.4, "oil_degradation": 0.05}
    words = finding_words(finding)
    assert words.headline.startswith("Internal leakage (55 %) or one of 2 others, since")
    assert words.alternatives.startswith(
        "It could as well be pump gear wear (40 %); less likely it is oil degradation (5 %): "
    )


def test_severity_one_is_that_of_the_unit():
    thesis, lift = Unit.load("axis_a"), Unit.from_yaml((EXAMPLES / "rig7.base.yaml").read_text())
    assert "+12e-12 m³/(s·Pa)" in severity_one("internal_leakage", None)
    assert severity_one("internal_leakage", thesis) == severity_one("internal_leakage", None)
    gross = 1e12 * Scales.of(lift).fault_leakage
    assert f"{gross:.3g}e-12" in severity_one("internal_leakage", lift)
    assert "250 kPa" not in severity_one("pressure_sensor_bias", lift)
    assert severity_one("coupling_wear", lift) == severity_one("coupling_wear", None)


def test_estimates_are_shown_with_their_change_and_what_the_log_could_not_tell_is_too():
    diagnosis = case(rows=6_000).diagnosis
    leakage, bulk = (diagnosis.estimates[name] for name in ("leakage", "bulk_modulus"))
    leakage.baseline, leakage.value, leakage.std = 6.5e-12, 9.75e-12, 1e-13
    bulk.observable, bulk.held, bulk.held_std, bulk.age_s = False, 3.2e8, 7e11, 4.0
    first, second, *_, last = estimate_rows(diagnosis)
    told = (first["quantity"], first["value"], first["change"])
    assert told == ("Leakage coefficient", "9.75 ± 0.10", "+50 %")
    told = (second["quantity"], second["change"], second["held"])
    assert told == ("Effective bulk modulus", "not seen", "")
    bulk.value = None
    second = estimate_rows(diagnosis)[1]
    assert (second["baseline"], second["value"], last["observable"]) == ("210", "–", "no")
    diagnosis = case("healthy", rows=6_000).diagnosis
    assert tables.sensor_rows(diagnosis) == [("motor current", "missing, since 20.0 s")]
    hidden = [("coupling wear", "at any severity"), ("internal leakage", "below severity 0.07")]
    assert tables.invisible_rows(diagnosis) == hidden
    diagnosis.samples, diagnosis.quality = 900, Quality(dropped_samples=100)
    rows = dict(tables.quality_rows(diagnosis))
    assert (rows["Dropped samples"], rows["Samples with missing values"]) == ("100 (10 %)", "0")


def test_inconclusive_says_why():
    diagnosis = case("inconclusive", rows=6_000).diagnosis
    assert diagnosis.quality.notes == []
    words = verdict_words(diagnosis)
    assert words.headline == "Inconclusive: no answer is sure enough after 6.0 s"
    assert words.remark == (
        "Most probable: leakage 40 %, healthy 34 %. Not observable in this log: viscous friction."
    )
    for estimate in diagnosis.estimates.values():
        estimate.observable = False
    assert "motion in this log" in headline(diagnosis)
    diagnosis.quality = Quality(notes=["The axis never moved."])
    assert headline(diagnosis) == "Inconclusive: The axis never moved"


def test_the_surest_of_several_faults_comes_first_each_with_its_own_probability():
    diagnosis = case(rows=6_000).diagnosis
    update = {"fault": "aeration", "ambiguity": [], "confidence": 0.99, "onset_s": 1.0, "severity": None}
    diagnosis.faults.append(diagnosis.faults[0].model_copy(update=update))
    words = verdict_words(diagnosis)
    assert words.headline == "Air in the oil, since 1.0 s, 99 % sure"
    assert len(words.findings) == 2
    assert words.remark == "2 faults found, the surest first."
    diagnosis.faults[0].confidence = 0.3
    assert verdict_words(diagnosis).remark == "The last is a hint, less likely than not."
    diagnosis.faults.append(diagnosis.faults[0])
    assert verdict_words(diagnosis).remark == "The last 2 are hints, less likely than not."
    diagnosis.faults = []
    assert headline(diagnosis).startswith("Faulty")
    # A second fault of 96 % was listed at the 1 % that the first leaves it.
    diagnosis = case(rows=60_000).diagnosis
    (first,) = diagnosis.faults
    first.confidence, first.ambiguity, first.shares = 0.99, ["internal_leakage"], {}
    air = first.model_copy(update={"fault": "aeration", "family": "aeration", "confidence": 0.96})
    diagnosis.faults.append(air)
    diagnosis.probabilities = {"leakage": 0.99, "aeration": 0.0096, "healthy": 0.0004}
    assert likely(diagnosis) == [("leakage", 0.99), ("aeration", 0.96)]


def test_shares_never_claim_certainty_and_spans_and_values_are_rounded():
    shares = {0.0: "under 1 %", 0.004: "under 1 %", 0.5: "50 %", 0.994: "99 %", 1.0: "over 99 %"}
    assert {share: percent(share) for share in shares} == shares
    spans = {4.51: "4.5 s", 60.0: "60 s", 1500.0: "25 min", 7200.0: "2.0 h"}
    assert {seconds: span(seconds) for seconds in spans} == spans
    values = {(9.8123, 0.1049): "9.81 ± 0.10", (-209.7, 12.2): "−210 ± 12", (5.0, np.inf): "5"}
    assert {value: with_std(*value) for value in values} == values
    assert with_std(None, 1.0) == "–" == number(float("nan"))
