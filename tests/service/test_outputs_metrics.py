"""Metrics as Prometheus's own parser reads them, and as `promtool check metrics` wants them."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from outputs_fakes import transition
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_open
from prometheus_client.parser import text_string_to_metric_families as parse

from fdd.service.outputs.metrics import MOST_AXES, UNITS, Metrics
from fdd.service.status import AxisStatus

DASHBOARD = Path(__file__).parents[2] / "deploy" / "grafana" / "fdd.json"
OUTPUTS = {
    "mqtt": {"delivered": 5, "failed": 2, "given_up": 1, "pending": 3, "lost": 4, "last_error": "away"},
    "recording": {"files": 2, "running": 1, "lost_blocks": 6, "last_error": ""},
}
SOURCES = {"mqtt": {"name": "mqtt", "connected": True, "received": 9, "refused": 2, "reconnects": 1}}


def axis(name: str = "A1", **given: Any) -> AxisStatus:
    keys = ("unit", "baseline", "value", "std", "observable")
    estimates = {
        name: dict(zip(keys, given, strict=True))
        for name, given in {
            "leakage": ("m^3/(s*Pa)", 6.5e-12, 9.8e-12, 1e-13, True),
            "bulk_modulus": ("Pa", 1e9, 8.5e8, 2e7, False),
            "coulomb_friction": ("N", 3e2, None, None, False),
            "viscous_friction": ("N*s/m", 2e3, 2.1e3, math.nan, True),
        }.items()
    }
    usual = {
        "name": name, "unit": "axis_a", "headline": "", "state": "healthy", "last_wall": 1.7e9,
        "lag_s": 0.3, "samples": 60000,
        "rate_hz": 1000.0, "probabilities": {"healthy": 0.9, "leakage": 0.1}, "estimates": estimates,
        "quality": {"dropped": 1, "overrun": 2},
    }  # fmt: skip
    return AxisStatus.model_validate({**usual, **given})


def metrics_of(*axes: AxisStatus, alarms: Any = lambda states: ()) -> Metrics:
    fleet = SimpleNamespace(axes=lambda: axes, sources=lambda: SOURCES, store_errors=2.0)
    outputs = SimpleNamespace(status=lambda: OUTPUTS)
    return Metrics(fleet, SimpleNamespace(alarms=alarms), outputs)  # type: ignore[arg-type]


def families(*axes: AxisStatus, alarms: Any = lambda states: [transition()["alarm"]]) -> list[Any]:
    return list(parse(metrics_of(*axes, alarms=alarms)()[0].decode()))


def scraped(*axes: AxisStatus, alarms: Any = lambda states: ()) -> dict[tuple[str, ...], float]:
    """Name and label values to value."""
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in families(*axes, alarms=alarms)
        for sample in family.samples
    }


def test_values_arrive() -> None:
    found = scraped(axis())
    assert found["fdd_samples_total", "A1"] == 60000
    assert found["fdd_dropped_samples_total", "A1"] == 3
    assert found["fdd_block_lag_seconds", "A1"] == 0.3
    assert found["fdd_axis_up", "A1"] == 1
    assert found["fdd_axis_state", "A1", "healthy"] == 1 and found["fdd_axis_state", "A1", "silent"] == 0
    assert found["fdd_leakage_cubic_meters_per_pascal_second", "A1"] == 9.8e-12
    assert found["fdd_bulk_modulus_stddev_pascals", "A1"] == 2e7
    assert found["fdd_estimate_observable", "A1", "bulk_modulus"] == 0
    assert found["fdd_fault_probability", "A1", "leakage"] == 0.1
    assert found["fdd_store_errors_total",] == 2
    assert found["fdd_output_failures_total", "mqtt"] == 2
    assert found["fdd_source_connected", "mqtt"] == 1 and found["fdd_source_blocks_total", "mqtt"] == 9
    assert (
        found["fdd_source_refused_total", "mqtt"] == 2 and found["fdd_source_reconnects_total", "mqtt"] == 1
    )
    assert found["fdd_output_pending", "mqtt"] == 3
    assert found["fdd_output_lost_blocks_total", "recording"] == 6
    assert found["process_resident_memory_bytes",] > 1e6


def test_what_is_not_known_is_not_told() -> None:
    found = scraped(axis(rate_hz=None, last_wall=None, estimates={}))
    names = {key[0] for key in found}
    assert not names & {"fdd_last_sample_timestamp_seconds", "fdd_sample_rate_hertz"}
    assert not any("leakage" in name for name in names)
    found = scraped(axis())
    assert ("fdd_coulomb_friction_newtons", "A1") not in found
    assert ("fdd_viscous_friction_stddev_newton_seconds_per_meter", "A1") not in found


def test_an_axis_is_up_while_it_sends_and_is_diagnosed() -> None:
    for state, up in (("healthy", 1), ("in alarm", 1), ("silent", 0), ("failed", 0)):
        assert scraped(axis(state=state))["fdd_axis_up", "A1"] == up
    found = scraped(axis(state="unacknowledged", silent=True))
    assert found["fdd_axis_up", "A1"] == 0 and found["fdd_axis_state", "A1", "silent"] == 1
    assert found["fdd_axis_state", "A1", "unacknowledged"] == 1
    assert scraped(axis(state="failed", quality={"refused": 7}))["fdd_dropped_samples_total", "A1"] == 7


def test_alarms_are_counted() -> None:
    alarms = [transition(id=1)["alarm"], transition(id=2)["alarm"], transition(axis="gone")["alarm"]]
    found = scraped(axis(), alarms=lambda states: alarms)
    counts = {key[1:]: value for key, value in found.items() if key[0] == "fdd_alarms"}
    # Labels in the order of their names: axis, family, priority, state.
    assert counts == {("A1", "leakage", "high", "UNACK"): 2}


def test_a_store_in_trouble_takes_only_the_alarms_away() -> None:
    def fail(states: Any) -> Any:
        raise RuntimeError("locked")

    names = {family.name for family in families(axis(), alarms=fail)}
    assert "fdd_alarms" not in names and {"fdd_store_errors", "fdd_samples"} <= names


def test_series_are_bounded() -> None:
    found = scraped(*(axis(f"axis-{k:05}") for k in range(MOST_AXES + 50)))
    assert found["fdd_axes",] == MOST_AXES + 50 and found["fdd_axes_omitted",] == 50
    assert len({key[1] for key in found if key[0] == "fdd_samples_total"}) == MOST_AXES
    per_axis = sum("axis-00001" in key for key in found)
    assert per_axis <= 40
    assert len(found) <= MOST_AXES * per_axis + 60


def test_openmetrics_is_answered_where_it_is_asked_for() -> None:
    body, kind = metrics_of(axis())("application/openmetrics-text; version=1.0.0")
    assert kind.startswith("application/openmetrics-text") and body.endswith(b"# EOF\n")
    assert "fdd_axis_up" in {family.name for family in parse_open(body.decode())}


def expressions(node: Any) -> list[str]:
    if isinstance(node, dict):
        own = [node["expr"]] if "expr" in node else []
        own += [node["query"]["query"]] if isinstance(node.get("query"), dict) else []
        return own + [e for value in node.values() for e in expressions(value)]
    return [e for item in node for e in expressions(item)] if isinstance(node, list) else []


def test_the_dashboard_asks_for_metrics_that_exist() -> None:
    known = {
        name: {"unit": "", "baseline": 1.0, "value": 1.0, "std": 1.0, "observable": True} for name in UNITS
    }
    labels = dict[str, set[str]]()
    for family in families(axis(estimates=known)):
        for sample in family.samples:
            labels.setdefault(sample.name, set()).update(sample.labels)
    dashboard = json.loads(DASHBOARD.read_text("utf-8"))
    asked = expressions(dashboard)
    assert len(asked) >= 15
    used = set()
    for expression in asked:
        names = set(re.findall(r"\b(?:fdd|process)_\w+", expression))
        assert names and names <= set(labels), expression
        used |= names
        for name, inside in re.findall(r"\b((?:fdd|process)_\w+)\{([^}]*)\}", expression):
            assert set(re.findall(r"(\w+)\s*(?:=|!)", inside)) <= labels[name], expression
        for inside in re.findall(r"\bby\s*\(([^)]*)\)", expression):
            words = {word.strip() for word in inside.split(",")}
            assert words <= set().union(*(labels[n] for n in names)), expression
    wanted = {f"fdd_{q}{part}_{unit}" for q, unit in UNITS.items() for part in ("", "_stddev")}
    wanted |= {"fdd_alarms", "fdd_axis_state", "fdd_block_lag_seconds", "fdd_dropped_samples_total"}
    assert wanted <= used


def test_the_page_names_every_metric() -> None:
    page = (Path(__file__).parents[2] / "docs" / "serve-outputs.md").read_text("utf-8")
    ours = {sample.name for family in families(axis()) for sample in family.samples if "fdd_" in sample.name}
    assert {name for name in ours if f"`{name}`" not in page and "_stddev" not in name} == set()
