"""An hour at standstill after some motion: do the estimates stay where they are?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from evidence.estimators import drawing
from evidence.estimators.cases import LOADS, Case
from evidence.estimators.model import assumed
from evidence.estimators.trajectory import QUANTITIES
from fdd.plant.duty import Levels
from fdd.plant.programme import Programme
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import stream
from fdd.residuals.tracking import METHODS, Channels, Tracking, estimates
from fdd.unit import Unit

Array = NDArray[np.float64]

HOUR = 3600.0
MOTION, SETTLED = 20.0, 30.0
"""s of motion at the start, and s from which on standstill counts."""
EVERY = 1000
"""ms between the rows that are kept."""


@dataclass(frozen=True)
class StillOutcome:
    """What the estimates of one run did.

    Attributes
    ----------
    case : name.
    time : (k,) s.
    moved : (methods, quantities, k) estimate less truth, less the same at `SETTLED`, over the standard
        deviation
        that was claimed at `SETTLED`.
    std : (methods, quantities, k) claimed standard deviation over that at `SETTLED`.
    """

    case: str
    time: Array
    moved: Array
    std: Array


def still_run(case: Case, seed: tuple[int, ...], duration: float = HOUR) -> StillOutcome:
    """One run of the plant: steps for `MOTION` seconds, then nothing until `duration`."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    unit = Unit.load("axis_a")
    tracking = Tracking(unit, Channels(case.channels), 1e-3)
    rig = drawing.draw_rig(unit, assumed(tracking.trackers["ekf"]), rng)
    times = np.arange(0.0, MOTION + 1e-9, 1.0)
    points = tuple(
        (float(t), float(x)) for t, x in zip(times, rng.uniform(-0.05, 0.05, times.size), strict=True)
    )
    scenario = Scenario(
        unit=unit.name, duration=duration, duty=Levels(points=Programme(points=points)),
        load=LOADS[case.load], details=rig.details, seed=int(rng.integers(2**62)),
        recording=Recording.perfect(),
    )  # fmt: skip
    kept: dict[str, list[layout.Records]] = {method: [] for method in METHODS}
    true: list[Array] = []
    for (axis,) in stream(rig.unit, scenario):
        for method, records in tracking.push(tracking.block(axis.samples)).items():
            each = EVERY // tracking.trackers["ekf"].decimation
            kept[method].append(records[each - 1 :: each])
        truth = np.array([axis.truth[name] for name in QUANTITIES])
        true.append(truth[:, EVERY - 1 :: EVERY])
    whole: Array = np.concatenate(true, axis=1)
    moved = np.empty((len(METHODS), *whole.shape))
    stds = np.empty_like(moved)
    time = (np.arange(whole.shape[1]) + 1.0) * EVERY * 1e-3
    at = int(np.searchsorted(time, SETTLED))
    for m, method in enumerate(METHODS):
        records = np.concatenate(kept[method])
        with np.errstate(invalid="ignore"):
            values, sigmas = estimates(records, unit, tracking.model)
        for i, name in enumerate(QUANTITIES):
            error = values[name] - whole[i]
            moved[m, i] = (error - error[at]) / sigmas[name][at]
            stds[m, i] = sigmas[name] / sigmas[name][at]
    return StillOutcome(case.name, np.asarray(time[at:]), moved[:, :, at:], stds[:, :, at:])
