"""Runs of many kinds with the usual steps and with steps half as long, over what no sensor can see."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fdd.plant import state as s
from fdd.plant.details import Details
from reports.plant.report import Case

SPRING, THROTTLE = {"name": "spring"}, {"name": "throttle"}
SINES, PRBS = {"name": "sines"}, {"name": "prbs", "lead_in": 0.1}
STIFFEST = Details(bristle_stiffness=Details.usual["bristle_stiffness"][1])
STILL = {"drive": "still", "circuit": {"blocked": True, "throttle": 0.3}}
CASES: dict[str, dict[str, Any]] = {
    "steps, constant load": {"duty": {"name": "steps", "hold": 1.0}, "load": {"name": "constant"}},
    "sines, spring, leakage": {
        "duty": SINES, "load": SPRING,
        "faults": [{"fault": "internal_leakage", "severity": 0.6, "onset": 0.02}],
    },
    "sawtooth, throttle, loose seal": {
        "duty": {"name": "sawtooth"}, "load": THROTTLE,
        "faults": [{"fault": "seal_wear", "severity": 1.0, "variant": "loose"}],
    },
    "flight, gust, aeration": {
        "duty": {"name": "flight", "lead_in": 0.1}, "load": {"name": "gust"},
        "faults": [{"fault": "aeration", "severity": 1.0, "onset": 0.02, "profile": "ramp"}],
    },
    "prbs, stiffest bristles": {"duty": {**PRBS, "amplitude": 0.01}, "details": STIFFEST, "load": SPRING},
    "prbs of speed, coupling and check valve": {
        "duty": {**PRBS, "speed": 60.0}, "control": {"mode": "speed"}, "load": THROTTLE,
        "faults": [{"fault": "coupling_wear", "severity": 1.0},
                   {"fault": "check_valve_stuck_open", "severity": 0.7}],
    },
    "two axes, sines, connected": {
        "duty": SINES, "load": SPRING, "partner": {}, "connect": {"line_1": 0.1, "line_2": 0.1},
    },
    "two axes, one throttled": {"duty": {"name": "steps", "hold": 1.0}, "partner": STILL},
}  # fmt: skip


def half_steps(name: str, duration: float) -> dict[str, float]:
    """Rms differences by channel, over the rms of its sensor's white noise and of its rounding, LSB/√12.

    With a loop that sees the position without the encoder's steps: the plant's numerics alone.
    """
    case = Case.of(name, **CASES[name])
    sensors = dict(case.unit.sensors)
    sensors["position"] = sensors["position"].model_copy(update={"resolution": 0.0})
    smooth = replace(case, unit=case.unit.model_copy(update={"sensors": sensors}))
    off = smooth.states(duration)[0] - smooth.states(duration, 2.0)[0]
    rms: dict[str, float] = {}
    for axis, unit in enumerate(filter(None, (case.unit, case.partner))):
        own = off[:, s.SHARED + axis * s.AXIS_STATES :]
        for channel, error in (
            ("position", off[:, s.X]), ("pump_speed", own[:, s.SPEED]),
            ("pressure_difference", own[:, s.P1] - own[:, s.P2]), ("motor_current", own[:, s.CURRENT]),
            ("pump_angle", own[:, s.ANGLE]),
        ):  # fmt: skip
            sensor = unit.sensor(channel)
            unseen = np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0))
            rms[channel] = max(rms.get(channel, 0.0), float(np.sqrt(np.mean(error**2)) / unseen))
    return rms
