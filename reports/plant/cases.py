"""The runs that numerics and speed are measured on: several duties, loads and faults, one axis and two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.plant.details import Details
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import raw_blocks
from fdd.unit import Unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A run that is measured; `settings` are the scenario's, beside its duration."""

    name: str
    unit: Unit
    partner: Unit | None
    settings: dict[str, Any]

    def scenario(self, duration: float, *, whole: bool = True) -> Scenario:
        """The run of `duration` s; `whole` keeps every sample at its millisecond."""
        recording = {"recording": Recording.perfect()} if whole else {}
        return Scenario(
            **{"unit": self.unit.name, "seed": 4, **self.settings, **recording, "duration": duration}
        )

    def prepared(self, duration: float, refine: float = 1.0) -> Prepared:
        """The run, ready."""
        return prepare(self.unit, self.scenario(duration), partner=self.partner, refine=refine)

    def without_encoder_steps(self) -> Case:
        """The same with a loop that sees the position as it is: the plant's numerics alone."""
        sensors = dict(self.unit.sensors)
        sensors["position"] = sensors["position"].model_copy(update={"resolution": 0.0})
        return Case(self.name, self.unit.model_copy(update={"sensors": sensors}), self.partner, self.settings)

    def states(self, duration: float, refine: float = 1.0) -> tuple[Array, Array]:
        """States (n, …) and commands (n, 2) of the run, at every millisecond."""
        rows = self.scenario(duration).rows
        block = next(iter(raw_blocks(self.prepared(duration, refine), block=rows)))
        return block.states, block.commands


class Cases:
    """Cases by what they are for, on the shipped units."""

    def _case(self, name: str, **settings: Any) -> Case:
        partner = Unit.load("axis_b") if "partner" in settings else None
        return Case(name, Unit.load("axis_a"), partner, settings)

    @property
    def numerics(self) -> list[Case]:
        """For step halving and the reference solver."""
        stiffest = Details(bristle_stiffness=Details.usual["bristle_stiffness"][1])
        leak = {"fault": "internal_leakage", "severity": 0.6, "onset": 0.02}
        loose = {"fault": "seal_wear", "severity": 1.0, "variant": "loose"}
        air = {"fault": "aeration", "severity": 1.0, "onset": 0.02, "profile": "ramp"}
        worn = [{"fault": "coupling_wear", "severity": 1.0},
                {"fault": "check_valve_stuck_open", "severity": 0.7}]  # fmt: skip
        slow, fast = {"amplitude": 0.01, "lead_in": 0.1}, {"speed": 60.0, "lead_in": 0.1}
        still = {"drive": "still", "circuit": {"blocked": True, "throttle": 0.3}}
        steps, sines, prbs = {"name": "steps", "hold": 1.0}, {"name": "sines"}, {"name": "prbs"}
        spring, throttle = {"name": "spring"}, {"name": "throttle"}
        return [
            self._case("steps, constant load", duty=steps, load={"name": "constant"}),
            self._case("sines, spring, leakage", duty=sines, load=spring, faults=[leak]),
            self._case("sawtooth, throttle, loose seal", duty={"name": "sawtooth"}, load=throttle,
                       faults=[loose]),
            self._case("flight, gust, aeration", duty={"name": "flight", "lead_in": 0.1},
                       load={"name": "gust"}, faults=[air]),
            self._case("prbs, stiffest bristles", duty={**prbs, **slow}, details=stiffest, load=spring),
            self._case("prbs of speed, coupling and check valve", duty={**prbs, **fast},
                       control={"mode": "speed"}, faults=worn, load=throttle),
            self._case("two axes, sines, connected", duty=sines, load=spring, partner={},
                       connect={"line_1": 0.1, "line_2": 0.1}),
            self._case("two axes, one throttled", duty=steps, partner=still),
        ]  # fmt: skip

    @property
    def speed(self) -> list[Case]:
        """For the real-time factor: everything on, one fault injected."""
        fault = [{"fault": "internal_leakage", "severity": 0.5, "onset": 2.0}]
        settings: dict[str, dict[str, Any]] = {
            "steps": {"duty": {"name": "steps"}, "load": {"name": "constant"}},
            "sines": {"duty": {"name": "sines"}, "load": {"name": "spring"}},
            "sawtooth": {"duty": {"name": "sawtooth"}, "load": {"name": "inertia"}},
            "strokes": {"duty": {"name": "strokes"}, "load": {"name": "throttle"}},
            "flight, gust": {"duty": {"name": "flight"}, "load": {"name": "gust"}},
            "prbs": {"duty": {"name": "prbs", "amplitude": 0.01}},
            "two axes, steps": {"duty": {"name": "steps"}, "partner": {}},
            "two axes, sines": {"duty": {"name": "sines"}, "load": {"name": "spring"}, "partner": {}},
        }
        return [self._case(name, faults=fault, **each) for name, each in settings.items()]

    @property
    def work(self) -> Case:
        """For error over work: open-loop speeds, the same commands for every solver."""
        duty = {"name": "prbs", "bit": 0.1, "speed": 60.0, "lead_in": 0.05}
        return self._case("prbs of speed, throttle", duty=duty, control={"mode": "speed"},
                          load={"name": "throttle"})  # fmt: skip
