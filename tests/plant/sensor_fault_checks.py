"""What severity 1 of each fault of a sensor is, by the catalogue's words, measured from runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from fault_case import ONSET, Array, Case, run

from fdd.plant.scenario import Recording
from fdd.plant.simulate import Simulation

LONG = 60.0
"""s, of runs whose shares and rates are counted."""


@cache
def _long_healthy(axis: int) -> Simulation:
    return run(axis=axis, duration=LONG, recording=Recording.perfect())


def only_measured(case: Case) -> None:
    for name in case.healthy.truth.columns:
        assert np.array_equal(case.truth[name], case.healthy.truth[name]), name


def _added(case: Case, channel: str) -> Array:
    return np.asarray((case.faulty.samples[channel] - case.healthy.samples[channel])[case.after])


def pressure_sensor_bias(case: Case) -> None:
    step, added = case.unit.sensors["pressure_difference"].resolution, _added(case, "pressure_difference")
    if case.spec.law == "zero":
        np.testing.assert_allclose(added, 250e3, atol=1.01 * step)
    elif case.spec.law == "gain":  # of what is measured, noise included: as much at the relief setting
        share = 250e3 / 3.44e6
        measured = case.healthy.samples["pressure_difference"][case.after]
        np.testing.assert_allclose(added, share * measured, atol=2e3 + 1.01 * step)
    else:
        assert case.spec.law == "hysteresis"
        assert 100e3 < np.abs(added).max() < 250e3 + 1.01 * step
    only_measured(case)


def pressure_sensor_drift(case: Case) -> None:
    since = case.faulty.samples.time[case.after] - ONSET
    if case.spec.law == "walk":  # `test_sensor_faults` has its rms over many seeds
        assert 0.0 < np.abs(_added(case, "pressure_difference")).max() < 1e6
        return
    # All reach what the line reaches within 50 s; a bound that is settled to, 95 % of it.
    expected = {
        "line": 5e3 * since,
        "root": 250e3 * np.sqrt(since / 50.0),
        "settling": 250e3 * (1.0 - np.exp(-3.0 * since / 50.0)),
    }[str(case.spec.law)]
    step = case.unit.sensors["pressure_difference"].resolution
    np.testing.assert_allclose(_added(case, "pressure_difference"), expected, atol=1.01 * step + 10.0)
    only_measured(case)


def position_sensor_slip(case: Case) -> None:
    """Within 5 mm, and the controller follows it; `test_recorder_blocks` has the walk's statistics."""
    spec = case.spec.model_copy(update={"onset": 0.0})
    long = run(spec, axis=case.axis, duration=LONG, recording=Recording.perfect())
    encoder = case.unit.sensor("position")
    slipped = long.samples["position"] - encoder.gain * long.truth["position"] - encoder.zero
    assert 1e-3 < np.abs(slipped).max() < 5.05e-3
    if case.axis == 1:
        error, usual = (
            np.median(np.abs(out.samples["position_setpoint"] - out.samples["position"]))
            for out in (long, _long_healthy(1))
        )
        assert error == pytest.approx(usual, rel=0.1), "the loop believes its encoder"
    else:
        only_measured(case)


def sensor_dropout(case: Case) -> None:
    variant = str(case.spec.variant)
    only_measured(case)
    if variant in ("noisy", "sticking", "clipped", "late"):  # `test_sensor_faults` has their closed forms
        assert np.nanmax(np.abs(_added(case, "pressure_difference"))) > 0.0
        return
    channel = "position" if variant.startswith("position") else "pressure_difference"
    values, sound = case.faulty.samples[channel], case.healthy.samples[channel]
    loop = case.unit.sensors["pressure_difference"].loop
    assert loop is not None and loop.offset == pytest.approx(1.724e6, rel=1e-3), "Appendix A, at 0 V"
    dead = loop.offset
    lost_all = values[case.after][500:]  # a contact opens within a tenth of a second or so
    if variant.endswith("missing"):
        assert np.isnan(lost_all).all()
    elif variant.endswith("held"):
        assert np.ptp(lost_all) == 0.0 and np.ptp(sound[case.after]) > 0.0
        assert lost_all[0] in sound, "a value that was seen"
    else:
        np.testing.assert_array_equal(lost_all, -dead)


SENSOR_CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check
    for check in (pressure_sensor_bias, pressure_sensor_drift, position_sensor_slip, sensor_dropout)
}
