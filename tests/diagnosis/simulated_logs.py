"""Simulated logs of axis A, healthy and with one fault, each made once."""

from functools import cache
from typing import Any

from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

LOADS: dict[str, dict[str, Any]] = {
    "spring": {"name": "spring"},
    "push": {"name": "constant"}, "pull": {"name": "constant", "level": -1000.0},
    "gust": {"name": "gust"},
}  # fmt: skip
ONSET_S = 17.3
DURATION_S = 32.0
HEALTHY = ((1, "spring"), (2, "push"), (3, "pull"))


@cache
def simulated(
    seed: int, load: str, fault: str = "", severity: float = 0.7, side: int | None = None
) -> Samples:
    """One log of axis A; from `ONSET_S` on with a fault."""
    faults = [{"fault": fault, "severity": severity, "onset": ONSET_S, "side": side}] if fault else []
    scenario = Scenario(duration=DURATION_S, load=LOADS[load], seed=seed, faults=faults)
    return simulate(Unit.load("axis_a"), scenario).samples
