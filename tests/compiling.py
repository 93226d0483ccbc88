"""``python -m tests.compiling PART``: compiles what most tests call, before they start.

Workers that met an empty cache would each compile the same. Where all is compiled, it takes seconds.
"""

import doctest
import importlib
import pkgutil
import sys
from pathlib import Path

import estimators
from fdd.diagnosis.pipeline import Pipeline
from fdd.identification.identify import identify_unit
from fdd.logs import read_log
from fdd.plant.faults import parse_fault
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.unit import Unit

DEMO = Path(__file__).parents[1] / "fdd" / "demo" / "demo.mcap"


def plant() -> None:
    """The simulator, of one axis and of two, and its sensors."""
    sensor = parse_fault("sensor_dropout:severity=0.5")
    for partner in (None, {"unit": "axis_b"}):
        simulate(Unit.load("axis_a"), Scenario(duration=1.0, partner=partner, faults=[sensor]))


def diagnosis() -> None:
    """Reading a log, both filters on an axis, the balances, identification."""
    samples, unit = read_log(DEMO).samples, Unit.load("axis_a")
    pipeline = Pipeline(unit)
    pipeline.push(samples)
    pipeline.finish()
    identify_unit([samples], unit)


def filters() -> None:
    """The estimators' docstrings call each of them."""
    for found in pkgutil.walk_packages(estimators.__path__, "estimators."):
        doctest.testmod(importlib.import_module(found.name))


if __name__ == "__main__":
    {"plant": plant, "diagnosis": diagnosis, "filters": filters}[sys.argv[1]]()
