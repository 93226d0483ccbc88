"""Labels and answers of made-up logs: of each only what a test asks about has to be said."""

from typing import Any

from fdd.campaign.labels import Conditions, Entry, Label
from fdd.diagnosis.findings import Diagnosis, FaultFinding, Quality
from fdd.faults import CATALOGUE

CONDITIONS = Conditions(
    load="spring", duty="steps", control="speed", oil_temperature=40.0, charge_factor=1.0, seed=1
)


def label(fault: str, onset: float = 10.0, severity: float = 0.5) -> Label:
    family = CATALOGUE[fault].family
    return Label(fault=fault, family=family, severity=severity, onset_s=onset, profile="step")


def entry(*faults: Label, **more: Any) -> Entry:
    given = {"file": "u/a", "truth": "u/t", "unit": "u", "base": "axis_a", "duration_s": 1800.0, "samples": 1}
    return Entry(faults=faults, scenario=CONDITIONS, truth_medians={}, **{**given, **more})


def finding(fault: str, onset: float = 10.5, **more: Any) -> FaultFinding:
    given = {"family": CATALOGUE[fault].family, "ambiguity": [fault], "confidence": 0.9}
    given |= {"severity": 0.4, "severity_interval": (0.3, 0.6), "detected_s": onset + 2.0}
    return FaultFinding(fault=fault, onset_s=onset, **{**given, **more})


def answer(verdict: str, *faults: FaultFinding, **more: Any) -> Diagnosis:
    given = {"log": "a", "axis": "axis", "unit": "u", "duration_s": 1800.0, "samples": 1, "probabilities": {}}
    told = {"verdict": verdict, "faults": list(faults), "estimates": {}, "quality": Quality()}
    return Diagnosis(**{**given, **told, **more})
