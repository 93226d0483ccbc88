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
    step = case.unit.sensors["pressure_difference"].resolution
    np.testing.assert_allclose(_added(case, "pressure_difference"), 250e3, atol=1.01 * step)
    only_measured(case)


def pressure_sensor_drift(case: Case) -> None:
    expected = 5e3 * (case.faulty.samples.time[case.after] - ONSET)
    step = case.unit.sensors["pressure_difference"].resolution
    np.testing.assert_allclose(_added(case, "pressure_difference"), expected, atol=1.01 * step + 10.0)
    only_measured(case)


def position_sensor_slip(case: Case) -> None:
    """About once a second by 0.5 to 1.5 mm, to either side, within 5 mm; the controller follows it."""
    spec = case.spec.model_copy(update={"onset": 0.0})
    long = run(spec, axis=case.axis, duration=LONG, recording=Recording.perfect())
    encoder = case.unit.sensor("position")
    slipped = long.samples["position"] - encoder.gain * long.truth["position"] - encoder.zero
    # The encoder's own errors are microns; a slip is a step from one millisecond to the next.
    jumps, where = np.diff(slipped), slipped[:-1]
    jumped = np.abs(jumps) > 0.2e-3
    jumps, where = jumps[jumped], where[jumped]
    assert abs(jumps.size - LONG) < 4.0 * np.sqrt(LONG), "a Poisson process"
    # Reflected at the walls a slip may show smaller; no slip from here reaches them.
    sizes = np.abs(jumps[np.abs(where) < 3.4e-3])
    assert sizes.min() > 0.49e-3 and sizes.max() < 1.51e-3
    assert np.mean(sizes) == pytest.approx(1e-3, abs=0.15e-3)
    assert 0.25 < np.mean(jumps > 0.0) < 0.75
    assert np.abs(slipped).max() < 5.05e-3
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
    only_measured(case)
    # At 0.3 it is lost 30 % of the time, in bursts of about 0.1 s: the mean of a telegraph signal with the
    # correlation time of 0.1 s has the variance 2·p(1 - p)·0.1 s over the log's length.
    part = case.spec.model_copy(update={"severity": 0.3, "onset": 0.0})
    values = run(part, axis=case.axis, duration=LONG, recording=Recording.perfect()).samples[channel]
    spread = np.sqrt(2.0 * 0.3 * 0.7 * 0.1 / LONG)
    if variant.endswith("held"):
        # A value again where the healthy log, of the same truth, has another.
        changed = np.diff(_long_healthy(case.axis).samples[channel]) != 0.0
        assert changed.mean() > 0.3
        share = (np.diff(values)[changed] == 0.0).mean()
        assert share == pytest.approx(0.3, abs=4.0 * spread)
        return
    gone = np.isnan(values) if variant.endswith("missing") else values == -dead
    assert gone.mean() == pytest.approx(0.3, abs=3.0 * spread)
    bursts = int((np.diff(gone.astype(int)) == 1).sum())
    assert gone.sum() * 1e-3 / bursts == pytest.approx(0.1 / 0.7, rel=0.25)


SENSOR_CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check
    for check in (pressure_sensor_bias, pressure_sensor_drift, position_sensor_slip, sensor_dropout)
}
