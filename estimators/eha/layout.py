"""Where what stands: columns of the tracker's blocks, measurements, records and memory."""

from __future__ import annotations

from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from estimators.compiled import Two, record_of
from estimators.eha import model as eha
from estimators.linalg import Array

# Columns of a block given to `EhaTracker.push`, SI; NaN where a channel has no value.
TIME, POSITION, ANGLE, SPEED, PRESSURE_1, PRESSURE_2, DIFFERENCE, ACCUMULATOR, VISCOSITY = range(9)
COLUMNS = 9

FLOW_PARAMETERS = 5
"""LEAK to SPLIT, see `estimators.eha.walk`."""

Flow = Annotated[Array, FLOW_PARAMETERS]


class Record(Protocol):
    """What the tracker gives every few samples, in the model's units where none is named."""

    time: float
    state: Annotated[Array, eha.STATES]
    variance: Annotated[Array, eha.STATES]
    nis: float  # sum of squared innovations over their variances, a mean over the record
    outside: float  # share of samples at which the SVSF's gain took over
    bulk_modulus: Two  # of each chamber, Pa
    viscosity: float
    unrest: float


class Memory(Protocol):
    """What the loop carries from sample to sample beside state and covariance."""

    # The grid of samples, and what was last known of the inputs.
    origin: float
    index: float
    angle: float
    speed: float
    accumulator_pressure: float
    viscosity: float
    # Of the record at hand.
    count: float
    started: float
    nis: float
    outside: float
    # Sums of the force balance, and how restless the load is: `estimators.eha.corrections`.
    force: float
    velocity: float
    position: float
    first_velocity: float
    direction: float
    force_span: float
    friction: float
    square_velocity: float
    unrest: float
    slid: float
    blind: float  # samples without position or angle
    # Scores of the flow parameters: `estimators.eha.walk`.
    score_span: float
    windows: float
    streak: float
    # Of the redundant difference: `estimators.eha.corrections`.
    gap: float
    pairs: float
    # Whether pressures move: `estimators.eha.corrections`.
    fast: Two
    slow: Two
    still: float
    # Sums of the scores, over a short and a long window: `estimators.eha.walk`.
    shift: Flow
    gained: Flow
    shift_long: Flow
    gained_long: Flow


RECORD, MEMORY = record_of(Record), record_of(Memory)
Records = NDArray[np.void]
"""(n,) of `RECORD`."""


def finite(records: Records) -> NDArray[np.bool_]:
    """Which records hold numbers alone, (n,) for contiguous (n,) of `RECORD`."""
    numbers = records.view(np.float64).reshape(records.size, RECORD.itemsize // 8)
    return np.asarray(np.isfinite(numbers).all(axis=1))
