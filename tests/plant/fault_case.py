"""A run with a fault and the healthy one beside it, of either axis, and what the checks measure of them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from fdd.faults import CATALOGUE
from fdd.plant.duty import Levels, Steps
from fdd.plant.faults import FaultSpec
from fdd.plant.rig import ConstantLoad, NoLoad
from fdd.plant.scenario import Control, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.plant.state import Truth
from fdd.unit import Unit

ONSET = 2.0
Array = np.ndarray


def choices(names: Iterable[str]) -> list[tuple[Any, ...]]:
    """These faults with each of their sides, variants and laws."""
    return [
        (entry.id, *choice)
        for entry in (CATALOGUE[name] for name in names)
        for choice in product(entry.sides or (None,), entry.variants or (None,), entry.laws or (None,))
    ]


def _drained(name: str) -> Unit:
    """The axis with 15 % of its leakage through the case: oil that its check valves have to bring back."""
    unit = Unit.load(name)
    case = 0.15 * unit.pump.total_leakage
    split = {"case_leakage": case, "cross_port_leakage": unit.pump.total_leakage - 0.5 * case}
    return unit.model_copy(update={"pump": unit.pump.model_copy(update=split)})


UNITS = {1: _drained("axis_a"), 2: _drained("axis_b")}


def run(*faults: FaultSpec, axis: int = 1, unit: Unit | None = None, **changes: Any) -> Simulation:
    """Axis 1 alone, or axis 2 of a dual rig whose axes are driven alike, each with its own accumulator."""
    given: dict[str, Any] = {"duration": 5.0, "duty": Steps(amplitude=0.04, hold=0.8), "seed": 5}
    given |= {"load": ConstantLoad(level=600.0 * axis), "faults": list(faults)}
    given |= {"oil_temperature": UNITS[1].oil.reference_temperature, **changes}
    if axis == 1:
        return simulate(unit or UNITS[1], Scenario(**given))
    given |= {"partner": {"circuit": given["circuit"]} if "circuit" in given else {}, "accumulator": "each"}
    return simulate(UNITS[1], Scenario(**given), partner=unit or UNITS[2]).partner


_SOUND: dict[str, Simulation] = {}


def sound(axis: int = 1, **changes: Any) -> Simulation:
    """The axis's part of a healthy run, made once: many faults are compared with the same one."""
    asked = repr((axis, changes))
    if asked not in _SOUND:
        _SOUND[asked] = run(axis=axis, **changes)
    return _SOUND[asked]


@dataclass(frozen=True)
class Case:
    """A faulty run, the healthy one beside it, and which rows come after the onset."""

    spec: FaultSpec
    faulty: Simulation
    healthy: Simulation

    @property
    def axis(self) -> int:
        return self.spec.axis

    @property
    def unit(self) -> Unit:
        return UNITS[self.spec.axis]

    @property
    def truth(self) -> Truth:
        return self.faulty.truth

    @property
    def after(self) -> Array:
        # A late row at the onset may lie on either side of its millisecond.
        return self.truth.time > ONSET + 2e-3

    def again(self, onset: float = 0.0, **changes: Any) -> tuple[Truth, Truth]:
        """Truths of faulty and healthy in another run, the fault from its start on or an onset."""
        spec = self.spec.model_copy(update={"onset": onset})
        return run(spec, axis=self.axis, **changes).truth, sound(self.axis, **changes).truth

    def at_speeds(
        self, points: str | float, duration: float, offset: float = 0.0, **changes: Any
    ) -> tuple[Truth, Truth]:
        """The same at given pump speeds, from an offset on, without a load, in a perfect recording."""
        duty, loop = Levels(points=points, offset=offset), Control(mode="speed")
        given = {"load": NoLoad(), "recording": Recording.perfect(), **changes}
        return self.again(duration=duration, duty=duty, control=loop, **given)

    def pressed(self, side: int) -> dict[str, Any]:
        """The load that presses on a chamber."""
        return {"load": ConstantLoad(level=600.0 * self.axis * (1.0 if side == 1 else -1.0))}


Check = Callable[[Case], None]
CHECKS: dict[str, Check] = {}
"""By fault: what severity 1 is by the catalogue's words, measured from runs."""


def checked(check: Check) -> Check:
    """Enter a check under the fault whose name it has."""
    CHECKS[check.__name__] = check
    return check


def over_time(truth: Truth, values: Array, rows: Array) -> float:
    return float(np.trapezoid(values[rows], truth.time[rows]))


def lost(truth: Truth, rows: Array) -> float:
    """Oil (m³ at atmospheric pressure) that went outside, from what is still inside."""
    inside = (truth["oil_mass"] - truth["oil_lost"])[rows]
    return float(inside[0] - inside[-1])


def held(rows: Array, milliseconds: int = 40) -> Array:
    """Rows before which it has been so for that long: valves follow within some milliseconds."""
    return np.asarray(np.convolve(rows, np.ones(milliseconds), "full")[: rows.size] > milliseconds - 0.5)


def keeps_its_oil(truth: Truth) -> None:
    assert np.abs(truth["oil_mass"] / truth["oil_mass"][0] - 1.0).max() < 1e-9


def port_pressure(truth: Truth, side: int) -> Array:
    """Pa at the pump's port; half of the line losses lie on each side."""
    loss = 0.5 * (truth["port_difference"] - truth["pressure_difference"])
    return np.asarray(truth[f"pressure_{side}"] + (loss if side == 1 else -loss))
