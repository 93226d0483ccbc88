"""Where what stands: columns of the tracker's blocks, and its records: noise, memory, what it gives."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass
class Noise:
    """Noise of model and measurements, SI; each default says why.

    Rates are standard deviations after one second of random walk.
    """

    position: float = 5e-7
    """m; a 1 µm encoder rounds with 0.3 µm, the rest is its mounting."""
    angle: float = 1e-4
    """rad; one count of 65536 per turn."""
    pressure: float = 9e3
    """Pa; white noise of the same spectral density as the chamber transducers' below 100 Hz."""
    pressure_difference: float = 7e3
    """Pa; Appendix A.2.2."""
    force: float = 100.0
    """N·√s: load inertia, bristles and gusts are not modelled; motion follows the encoder instead.

    With less of it the filter would read the bulk modulus off the resonance, and take an unknown
    inertia of the load for a change of the oil."""
    force_mean: float = 20.0
    """N: how well the friction curve fits the mean force over `FORCE_PERIOD` while sliding."""
    acceleration: float = 630.0
    """rad/s/√s: the drive may change the speed by 20 rad/s within one millisecond."""
    flow: float = 1e-7
    """m³/√s: unmodelled flow (gear ripple, line losses, leakage that is not laminar): half a percent
    of the pump's flow at a third of its speed, correlated over 0.1 s."""
    flow_refeeding: float = 1e-4
    """m³/√s: a chamber that the accumulator feeds has no volume balance."""
    leakage: float = 0.02
    """1/√s relative: a ramp of 10 % in 25 s. What is faster is a jump, see `estimators.eha.walk`."""
    valve: float = 0.02
    """1/√s relative to the healthy leakage: a closed valve stays closed for long."""
    air: float = 5e-4
    """1/√s, of the oil's volume: a tenth of a percent of free air comes or goes within seconds."""
    air_split: float = 1e-4
    """1/√s; one chamber's oil is exchanged with the other's by the pump within a stroke or two."""
    gain: float = 1e-4
    """1/√s; the displacement changes with wear only, the rest is temperature."""
    friction: float = 0.05
    """1/√s relative to the healthy curve."""
    viscous_friction: float = 10.0
    viscous_skew: float = 1.0
    """N·s/m/√s; directions differ by how the seals were fitted, which does not change soon."""
    zero: float = 300.0
    """Pa/√s; temperature moves a sensor's zero by some kilopascals within minutes."""
    load: float = 100.0
    """N/√s to begin with; how restless the load really is follows from the force balance itself."""
    stiffness: float = 1e3
    """N/m/√s."""
    throttle: float = 5e3
    """N/(m/s)²/√s."""
    inertia: float = 1.0
    """kg/√s."""
    initial_leakage: float = 0.3
    initial_valve: float = 0.03
    initial_air: float = 1e-3
    initial_air_split: float = 1e-3
    """A seventh of the usual compliance: the chambers' dead volumes are known to some 15 %."""
    initial_gain: float = 3e-3
    initial_zero: float = 2e4
    """Pa: zeros of two sensors of 0.1 % of 10 MPa each."""
    initial_friction: float = 0.3
    initial_viscous_friction: float = 100.0
    initial_viscous_skew: float = 30.0
    initial_load: float = 1000.0
    initial_stiffness: float = 1e4
    initial_throttle: float = 1e6
    initial_inertia: float = 30.0
    jump_leakage: float = 1.0
    """Relative to the healthy leakage: what a fault may add at once. Severity 1 of the catalogue is 1.8."""
    jump_valve: float = 5.0
    """Likewise; a valve stuck open passes 15."""
    jump_air: float = 1e-2
    """Severity 1 is 2.5 %."""
    compression: float = 0.0
    """Relative: how well the oil's compliance is known beside its air, which hardly shows at high pressure.
    The flow that compresses it is known no better, for `COMPRESSED` each time."""
    smoothing: float = 0.0
    """s over which the piston's velocity is averaged where the flow is linearised; an encoder of micrometres
    needs none. See `estimators.eha.tracker.track`."""
    refeed_margin: float = 3e4
    """Pa above the accumulator below which a chamber may be fed: cracking pressure and sensor zeros."""
    relief_pressure: float = 3.1e6
    """Pa of difference from which the relief valve may open."""

    def numbers(self) -> Noise:
        """The same as a record of `NOISE`, for compiled code."""
        numbers: Noise = np.zeros(1, NOISE)[0]
        for name in NOISE.names or ():
            setattr(numbers, name, getattr(self, name))
        return numbers


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
    # Where the flow is linearised, mm/ms, and the reduced chi-square of the innovations over some seconds.
    velocity_mean: float
    misfit: float
    # Sums of the force balance, and how restless the load is: `estimators.eha.walk`.
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
    # Of the redundant difference: `estimators.eha.walk`.
    gap: float
    pairs: float
    # Whether pressures move: `estimators.eha.walk`.
    fast: Two
    slow: Two
    still: float
    # Sums of the scores, over a short and a long window: `estimators.eha.walk`.
    shift: Flow
    gained: Flow
    shift_long: Flow
    gained_long: Flow


NOISE, RECORD, MEMORY = record_of(Noise), record_of(Record), record_of(Memory)
Records = NDArray[np.void]
"""(n,) of `RECORD`."""


def finite(records: Records) -> NDArray[np.bool_]:
    """Which records hold numbers alone, (n,) for contiguous (n,) of `RECORD`."""
    numbers = records.view(np.float64).reshape(records.size, RECORD.itemsize // 8)
    return np.asarray(np.isfinite(numbers).all(axis=1))
