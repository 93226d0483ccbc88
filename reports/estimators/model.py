"""What the estimators' model takes for noise, said once more for those who measure it.

Written from the documentation of `estimators.eha.noise` and not by calling the tracker: the worlds that
are drawn, the bound and the peers have the same statement to start from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.eha import model as eha
from estimators.eha.noise import Noise
from estimators.eha.tracker import EhaTracker
from reports.estimators.compiled import njit

Array = NDArray[np.float64]

FORCE_PERIOD = 20
"""ms over which a force balance is averaged."""
SETTLING = 80
"""ms of sliding one way until the friction curve holds."""
LOW_SIDE, LOW_SIDE_TIME = 0.2, 1e4
"""MPa and ms: how near the low side stays to the accumulator, and for how long that is one and the same fact.
What the estimators hold against not knowing the mean pressure where only the difference is measured."""
MOTION_SPREAD = (1.0, 0.1, 1.0, 0.3, 0.3, 0.3)
"""Standard deviations of the motion states at the start, model units: wide, encoders and pressures set
them."""


class Sizes(NamedTuple):
    """Standard deviations of the noise of motion and measurement for one millisecond, model units.

    `small` and `large` are a chamber's unmodelled volume, shut and where it may be fed or relieved:
    within `margin` above the accumulator's pressure, or from the pressure difference `relief` on.
    """

    force: float
    acceleration: float
    small: float
    large: float
    margin: float
    relief: float
    position: float
    angle: float
    pressure: float
    difference: float
    force_mean: float


@dataclass(frozen=True)
class Assumed:
    """What the filter assumes before any data, model units.

    `start`, `spread`: (STATES,) its first estimate and standard deviations; wide for the motion states.
    `walk`: (STATES,) standard deviation of each state's noise over one second. `pull`: (STATES,) 1/s, rate at
    which it is drawn back to its start: a walk never gets less certain than the initial spread, which is the
    variance of an Ornstein-Uhlenbeck process with the rate q²/2σ₀².
    """

    start: Array
    spread: Array
    walk: Array
    pull: Array
    sizes: Sizes


def assumed(tracker: EhaTracker) -> Assumed:
    """What a tracker that has seen no data assumes."""
    noise = tracker.noise
    spread = np.sqrt(np.diag(tracker.P))
    spread[: eha.P2 + 1] = MOTION_SPREAD
    walk = np.where(spread > 0.0, _walks(noise), 0.0)
    pull = np.divide(0.5 * walk**2, spread**2, out=np.zeros_like(walk), where=spread > 0.0)
    pull[eha.LOAD] = 0.0  # a load goes where it likes
    return Assumed(tracker.x.copy(), spread, walk, pull, _sizes(noise, tracker.model))


def _walks(noise: Noise) -> Array:
    walk = np.zeros(eha.STATES)
    walk[eha.LEAK] = noise.leakage
    walk[[eha.VALVE1, eha.VALVE2]] = noise.valve
    walk[eha.AIR], walk[eha.SPLIT], walk[eha.GAIN] = noise.air * 1e3, noise.air_split * 1e3, noise.gain
    walk[eha.FRIC], walk[eha.VISC] = noise.friction, noise.viscous_friction
    walk[eha.SKEW], walk[eha.ZERO] = noise.viscous_skew, noise.zero * 1e-6
    walk[eha.LOAD], walk[eha.STIF] = noise.load, noise.stiffness * 1e-3
    walk[eha.THROT], walk[eha.INERT] = noise.throttle, noise.inertia
    return walk


def _sizes(noise: Noise, model: eha.Parameters) -> Sizes:
    per_step = float(np.sqrt(1e-3))
    return Sizes(
        force=noise.force / float(model.moving_mass) * per_step,  # m/s is mm/ms
        acceleration=noise.acceleration * 1e-3 * per_step,
        small=noise.flow * 1e9 * per_step,
        large=noise.flow_refeeding * 1e9 * per_step,
        margin=noise.refeed_margin * 1e-6,
        relief=noise.relief_pressure * 1e-6,
        position=noise.position * 1e3,
        angle=noise.angle,
        pressure=noise.pressure * 1e-6,
        difference=noise.pressure_difference * 1e-6,
        force_mean=noise.force_mean,
    )


@njit(error_model="numpy")
def chamber_noise(
    p1: float, p2: float, p_acc: float, known: bool, sizes: Sizes
) -> tuple[float, float]:  # fmt: skip
    """Standard deviation of each chamber's unmodelled volume (mm³) over one millisecond.

    Large where the accumulator may feed the chamber or the relief valve may open. Without a sensor of the
    accumulator's pressure (`known`), the low side always counts as fed.
    """
    fed1 = p1 < p_acc + sizes.margin if known else p1 <= p2
    fed2 = p2 < p_acc + sizes.margin if known else p2 < p1
    relieved = abs(p1 - p2) > sizes.relief
    small, large = sizes.small, sizes.large
    return large if relieved or fed1 else small, large if relieved or fed2 else small


def tested_channels(
    states: Array, accumulator: Array, model: eha.Parameters, sizes: Sizes, *, minimum: bool
) -> float:
    """Channels whose innovations can be tested, mean over a run, 0 to 4.

    Where the process noise lets a channel move by more than ten times its own noise within a millisecond,
    that channel drives the model like an input. Its innovation is then far smaller than its variance whatever
    the filter does, adds nothing to the NIS, and is not counted. Such are the encoders, and the pressure of a
    chamber that the accumulator may feed. With the minimum of sensors one chamber always is, so that the
    pressure difference tells nothing either.

    `states`: (n, STATES) true. `accumulator`: (n,) MPa. `sizes`: of `Assumed`.
    """
    encoders = float(sizes.force < 10.0 * sizes.position) + float(sizes.acceleration < 10.0 * sizes.angle)
    pressures = 1.0 if minimum else 2.0
    sensor = sizes.difference if minimum else sizes.pressure
    if sizes.large < 10.0 * sensor * model.volume_1 * model.stiff_compliance:
        return encoders + pressures
    return encoders + max(pressures - _fed_chambers(states, accumulator, not minimum, sizes), 0.0)


@njit(error_model="numpy")
def _fed_chambers(states: Array, accumulator: Array, known: bool, sizes: Sizes) -> float:
    """Chambers with the large noise, mean over a run."""
    total = 0.0
    for k in range(states.shape[0]):
        sd1, sd2 = chamber_noise(states[k, eha.P1], states[k, eha.P2], accumulator[k], known, sizes)
        total += (sd1 == sizes.large) + (sd2 == sizes.large)
    return total / states.shape[0]


def encoders_share(states: Array, sizes: Sizes) -> float:
    """What encoders that are not tested add to the NIS all the same, to be taken off: a per cent or two.

    Their innovation is the true change of velocity or speed within a millisecond, its variance that of the
    noise of motion.

    `states`: (n, STATES) true, model units. `sizes`: of `Assumed`.
    """
    share = 0.0
    if sizes.force >= 10.0 * sizes.position:
        share += float(np.mean(np.diff(states[:, eha.V]) ** 2)) / sizes.force**2
    if sizes.acceleration >= 10.0 * sizes.angle:
        share += float(np.mean(np.diff(states[:, eha.W]) ** 2)) / sizes.acceleration**2
    return share
