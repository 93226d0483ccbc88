"""Innovations of the tracker, channel by channel, from what it shows after each sample.

A Kalman filter's posterior tells its innovation. With the residual ``r = z − H x`` after the update
and ``A = R − H P H'`` (its covariance), the innovation before it was ``e = R A⁻¹ r``, of covariance
``S = R A⁻¹ R`` (Anderson and Moore 1979, Optimal Filtering, sections 5.3 and 5.4). So nothing of the
compiled loop is repeated here, and what is tested is what runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from estimators import eha_model as eha
from estimators.consistency import standardised
from estimators.eha_noise import Noise
from estimators.eha_tracker import EhaTracker
from fdd.logs.angles import accumulate_speed
from fdd.residuals.tracking import Channels, Tracking
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOTION = eha.P2 + 1
"""States that are measured or drive what is: position, velocity, angle, speed, two pressures."""
OUTLIER = 5.0
"""Sigmas of an innovation beyond which the tracker weighs a sample down (Huber)."""
SI_OF_STATE = np.array([1e-3, 1.0, 1.0, 1e3, 1e6, 1e6])
"""Model units (mm, mm/ms, rad, rad/ms, MPa) to SI."""

# Channel: column of the block, its factor to model units, states it adds up.
_CHANNELS: dict[str, tuple[int, float, dict[int, float]]] = {
    "position": (layout.POSITION, 1e3, {eha.X: 1.0}),
    "pump_angle": (layout.ANGLE, 1.0, {eha.TH: 1.0}),
    "pressure_1": (layout.PRESSURE_1, 1e-6, {eha.P1: 1.0}),
    "pressure_2": (layout.PRESSURE_2, 1e-6, {eha.P2: 1.0}),
    "pressure_difference": (layout.DIFFERENCE, 1e-6, {eha.P1: 1.0, eha.P2: -1.0}),
}
NOISE_OF_CHANNEL = {
    "position": "position",
    "pump_angle": "angle",
    "pressure_1": "pressure",
    "pressure_2": "pressure",
    "pressure_difference": "pressure_difference",
}
"""The measurement noise (field of `Noise`) behind each channel."""


@dataclass(frozen=True)
class Innovations:
    """What each sample told that the filter did not expect; n samples, m channels.

    Attributes
    ----------
    channels : names, in the order in which they are made independent.
    period : s. time : (n,) s.
    raw : (n, m) innovations, SI.
    std : (n, m) what the filter expects of each once the channels before it are known, SI.
    white : (n, m) in sigmas, each channel less what the channels before it told: N(0, 1) and
        white for a consistent filter. NaN where a channel is missing, where an outlier was weighed
        down, and for a pressure that the accumulator feeds (its volume balance is open by choice).
    repeats : (m,) share of samples that read exactly as the one before.
    nis : (n,) normalised innovation squared over all channels; NaN where one is missing.
    states : (n, 6) position m, velocity m/s, angle rad, speed rad/s, pressures Pa.
    outliers : samples that were weighed down.
    """

    channels: tuple[str, ...]
    period: float
    time: Array
    raw: Array
    std: Array
    white: Array
    repeats: Array
    nis: Array
    states: Array
    outliers: int

    def __len__(self) -> int:
        return int(self.time.size)


@dataclass(frozen=True)
class Prepared:
    """A log ready for trackers: its block of columns and how to set them up."""

    unit: Unit
    tracking: Tracking
    block: Array
    period: float

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured channels with an innovation."""
        pressures = ("pressure_1", "pressure_2") if self.tracking.channels.chambers else (
            "pressure_difference",
        )  # fmt: skip
        return ("position", "pump_angle", *pressures)

    def tracker(self, noise: Noise, decimation: int = 1) -> EhaTracker:
        """An EKF at its start, with this noise."""
        like = self.tracking.trackers["ekf"]
        return EhaTracker(
            self.tracking.model,
            noise,
            "ekf",
            period=self.period,
            pressures=like.pressures,
            angle=True,
            viscous_friction=float(like.x[eha.VISC]),
            air_fraction=self.unit.oil.air_fraction,
            decimation=decimation,
        )


def prepare(log: Samples, unit: Unit) -> Prepared:
    """Set trackers up for a log; where only the pump's speed is measured, it is summed up here.

    Parameters
    ----------
    log : position, pump_angle or pump_speed, and pressure_difference or both chamber pressures.
    unit : profile; its sensors' zeros and gains are taken out.
    """
    channels = Channels.of(log)
    period = float(np.median(np.diff(log.time)))
    tracking = Tracking(unit, channels, period, 1)
    block = tracking.block(log)
    if "pump_angle" not in channels.names:
        block[:, layout.ANGLE] = accumulate_speed(log.time, log["pump_speed"], period)
    return Prepared(unit, tracking, block, period)


def innovations(prepared: Prepared, noise: Noise, settle: float = 3.0) -> Innovations:
    """Run the EKF over a log and reconstruct its innovations (see the module's text).

    Parameters
    ----------
    prepared : the log. noise : of the filter.
    settle : s at the start that are left out, while the parameters find their place.

    Returns
    -------
    Innovations : n samples less those that settle.
    """
    tracker, block = prepared.tracker(noise), prepared.block
    n = block.shape[0]
    x, P = np.empty((n, MOTION)), np.empty((n, MOTION, MOTION))
    # Row by row, to see the covariance after each: some 10 µs a row, and once per identification.
    for row in range(n):
        tracker.push(block[row : row + 1])
        x[row], P[row] = tracker.x[:MOTION], tracker.P[:MOTION, :MOTION]
    keep = block[:, layout.TIME] >= block[0, layout.TIME] + settle
    return _reconstructed(prepared, noise, block[keep], x[keep], P[keep])


def _reconstructed(prepared: Prepared, noise: Noise, block: Array, x: Array, P: Array) -> Innovations:
    names = prepared.channels
    m, n = len(names), block.shape[0]
    H = np.zeros((m, MOTION))
    z, sigma, si = np.empty((n, m)), np.empty(m), np.empty(m)
    for i, name in enumerate(names):
        column, factor, parts = _CHANNELS[name]
        z[:, i] = block[:, column] * factor
        sigma[i] = getattr(noise, NOISE_OF_CHANNEL[name]) * factor
        si[i] = 1.0 / factor
        for state, weight in parts.items():
            H[i, state] = weight
    # In sigmas of the measurement noise: A = I − H P H' and S = A⁻¹.
    residual = (z - x @ H.T) / sigma
    A = np.eye(m) - (H @ P @ H.T) / np.outer(sigma, sigma)
    whole: Flags = np.asarray(np.isfinite(residual).all(axis=1) & np.isfinite(A).all(axis=(1, 2)))
    sound: Flags = whole.copy()
    # An outlier's noise was raised: then A is no covariance, or the residual impossibly large.
    sound[whole] = np.linalg.eigvalsh(A[whole])[:, 0] > 0.0
    S = np.full((n, m, m), np.nan)
    S[sound] = np.linalg.inv(A[sound])
    S = 0.5 * (S + np.swapaxes(S, 1, 2))
    e = np.einsum("nij,nj->ni", S, residual)
    variance = np.diagonal(S, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        sound &= (np.abs(e) <= OUTLIER * np.sqrt(variance)).all(axis=1)
    white, std = np.full((n, m), np.nan), np.full((n, m), np.nan)
    nis = np.full(n, np.nan)
    if sound.any():
        white[sound] = standardised(e[sound], S[sound])
        nis[sound] = (white[sound] ** 2).sum(axis=1)
        std[sound] = np.diagonal(np.linalg.cholesky(S[sound]), axis1=1, axis2=2)
    white[_fed(names, block, x, noise, prepared.unit)] = np.nan
    e[~sound] = np.nan
    return Innovations(
        channels=names, period=prepared.period, time=block[:, layout.TIME], raw=e * sigma * si,
        std=std * sigma * si, white=white, repeats=np.mean(np.diff(z, axis=0) == 0.0, axis=0), nis=nis,
        states=x * SI_OF_STATE, outliers=int(np.sum(whole & ~sound)),
    )  # fmt: skip


def _fed(names: tuple[str, ...], block: Array, x: Array, noise: Noise, unit: Unit) -> Flags:
    """(n, m) pressures whose chamber the accumulator may feed, or the relief valve relieve."""
    tank = block[:, layout.ACCUMULATOR]
    tank = np.where(np.isfinite(tank), tank, unit.accumulator.charge_pressure)
    pressures = x[:, [eha.P1, eha.P2]] * 1e6
    known = bool(np.isfinite(block[:, layout.ACCUMULATOR]).any())
    if known:
        fed = pressures < (tank + noise.refeed_margin)[:, None]
    else:  # as the tracker has it: the lower one
        fed = pressures <= pressures[:, ::-1]
    fed |= (np.abs(pressures[:, 0] - pressures[:, 1]) > noise.relief_pressure)[:, None]
    out = np.zeros((x.shape[0], len(names)), dtype=bool)
    for i, name in enumerate(names):
        if name == "pressure_1":
            out[:, i] = fed[:, 0]
        elif name == "pressure_2":
            out[:, i] = fed[:, 1]
        elif name == "pressure_difference":
            # One of the two is fed nearly always; the other's volume balance is what is left.
            out[:, i] = fed.all(axis=1)
    return out
