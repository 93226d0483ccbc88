"""Severity 1 of a fault of a sensor in a whole run: the log is wrong, the plant as ever.

How wrong, `test_sensor_faults` and `test_recorder_blocks` compare with closed forms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fault_case import Case, run

from fdd.plant.scenario import Recording

LONG = 60.0
"""s, of runs whose shares and rates are counted."""


def measured(case: Case) -> None:
    channel = "position" if str(case.spec.variant).startswith("position") else "pressure_difference"
    faulty, sound = (log.samples[channel][case.after] for log in (case.faulty, case.healthy))
    assert not np.array_equal(faulty, sound, equal_nan=True)
    for name in case.healthy.truth.columns:
        assert np.array_equal(case.truth[name], case.healthy.truth[name]), name


def position_sensor_slip(case: Case) -> None:
    """Within 5 mm, and the controller follows it."""
    spec = case.spec.model_copy(update={"onset": 0.0})
    long, healthy = (
        run(*faults, axis=case.axis, duration=LONG, recording=Recording.perfect()) for faults in ((spec,), ())
    )
    encoder = case.unit.sensor("position")
    slipped = long.samples["position"] - encoder.gain * long.truth["position"] - encoder.zero
    assert 1e-3 < np.abs(slipped).max() < 5.05e-3
    if case.axis == 1:
        error, usual = (
            np.median(np.abs(out.samples["position_setpoint"] - out.samples["position"]))
            for out in (long, healthy)
        )
        assert error == pytest.approx(usual, rel=0.1), "the loop believes its encoder"


SENSOR_CHECKS: dict[str, Callable[[Case], None]] = {
    "pressure_sensor_bias": measured, "pressure_sensor_drift": measured, "sensor_dropout": measured,
    "position_sensor_slip": position_sensor_slip,
}  # fmt: skip
