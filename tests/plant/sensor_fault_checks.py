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


def _degraded(case: Case, variant: str) -> None:
    """A channel that is there all the time and wrong."""
    only_measured(case)
    spec = case.spec.model_copy(update={"onset": 0.0})
    faulty = run(spec, axis=case.axis, duration=LONG, recording=Recording.perfect())
    sound, name = _long_healthy(case.axis), "pressure_difference"
    shown, right, true = faulty.samples[name], sound.samples[name], sound.truth[name]
    step = case.unit.sensors[name].resolution
    if variant == "noisy":
        assert np.std(shown - right) == pytest.approx(345e3, rel=4.0 / np.sqrt(2 * shown.size))
    elif variant == "clipped":
        np.testing.assert_allclose(shown, np.minimum(right, 0.0), atol=step)
        assert right.max() > 100.0 * step
    elif variant == "sticking":
        moves = np.flatnonzero(np.diff(shown)) + 1
        assert moves.size > 5 and np.ptp(right[: moves[0]]) > 0.0
        stuck = np.concatenate([[0], moves])
        np.testing.assert_array_equal(shown[stuck], right[stuck])
        assert (np.abs(true[moves] - true[stuck[:-1]]) > 250e3).all()
        away = true - np.repeat(true[stuck], np.diff(stuck, append=true.size))
        assert np.abs(away).max() <= 250e3
    else:
        ages = [np.flatnonzero(right[max(i - 20, 0) : i + 1][::-1] == shown[i]) for i in range(shown.size)]
        assert all(age.size for age in ages), "a value of the last 20 ms"
        assert 0.05 < np.mean(shown == right) < 0.2, "about one in ten comes through at once"


def sensor_dropout(case: Case) -> None:
    variant = str(case.spec.variant)
    if variant in ("noisy", "sticking", "clipped", "late"):
        return _degraded(case, variant)
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
