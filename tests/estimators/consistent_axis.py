"""An axis that is exactly what the tracker believes: the reduced model driven by the tracker's own noise.

Whatever a filter shows on it is the filter's doing, not that of a plant which differs from its model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import estimators
from estimators.compiled import compiler
from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.noise import Noise

njit = compiler(Path(estimators.__file__).parent, Path(__file__).parent)
ACCUMULATOR = 1.0  # MPa
PERIOD = 1e-3
# Parameters that walk, as (field of the noise, factor from SI to the model's unit), from its documentation.
WALKS = {
    eha.LEAK: ("leakage", 1.0), eha.AIR: ("air", 1e3), eha.SPLIT: ("air_split", 1e3), eha.GAIN: ("gain", 1.0),
    eha.FRIC: ("friction", 1.0), eha.VISC: ("viscous_friction", 1.0), eha.SKEW: ("viscous_skew", 1.0),
    eha.STIF: ("stiffness", 1e-3), eha.THROT: ("throttle", 1.0), eha.INERT: ("inertia", 1.0),
    eha.ZERO: ("zero", 1e-6),
}  # fmt: skip
VISCOUS = 1000.0  # N·s/m: instead of dry friction, whose reversal is no matter of these tests


def model() -> eha.Array:
    """Axis A of the thesis without case drain, so that the mean pressure stays, and little dry friction."""
    return eha.parameters(
        area_1=1.52e-3, area_2=1.52e-3, volume_1=2.16e-3, volume_2=2.16e-3, moving_mass=3.688,
        displacement=5.57e-7, cross_port_leakage=6.5e-12, case_leakage=0.0, bulk_modulus=2.1e8,
        air_fraction=0.003, polytropic_index=1.4, reference_pressure=4.82e5,
        friction_forward=(20.0, 20.0, 0.02, 1.0), friction_reverse=(20.0, 20.0, 0.02, 1.0),
        accumulator_pressure=ACCUMULATOR * 1e6,
    )  # fmt: skip


def quiet_noise(**changes: float) -> Noise:
    """Less force noise than the default's, which stands for what models leave out; no refeeding or relief."""
    values = {"force": 2.0, "pressure": 3e3, "refeed_margin": -1e8, "relief_pressure": 1e9}
    return Noise(**{**values, **changes})


def typical_state(**parameters: float) -> eha.Array:
    """At rest in mid-stroke against a spring; parameters by the names of `eha`, healthy where not given."""
    x = np.zeros(eha.STATES)
    x[[eha.P1, eha.P2]] = ACCUMULATOR
    values = {"LEAK": 1.0, "AIR": 3.0, "FRIC": 1.0, "VISC": VISCOUS, "STIF": 30.0, **parameters}
    for name, value in values.items():
        x[getattr(eha, name)] = value
    return x


@njit()
def _run(
    x: eha.Array, q: eha.Array, drive: eha.Array, walks: eha.Array, closed: float, hold: float,
    vented: bool, at: int, jump: eha.Array,
) -> eha.Array:  # fmt: skip
    """States after each step; `drive` (n, 4) is noise on the motion, `walks` (n, STATES) on parameters."""
    n = drive.shape[0]
    out, truth = np.empty(eha.STATES), np.empty((n, eha.STATES))
    F, G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
    for i in range(n):
        if i == at:
            x += jump
        eha.step(x, PERIOD * 1e3, 1.0, ACCUMULATOR, np.nan, np.nan, q, out, F, G)
        x[:] = out + G @ drive[i]
        x[eha.W] -= hold * (0.5 * x[eha.W] + 1e-3 * x[eha.X])
        for j in (eha.VALVE1, eha.VALVE2):  # an open valve's leakage changes in proportion
            walks[i, j] *= np.sqrt(1.0 + (x[j] / (3.0 * closed)) ** 2)
        x += walks[i]
        if vented:
            x[eha.P2] = ACCUMULATOR
        truth[i] = x
    return truth


def simulate(
    start: eha.Array,
    noise: Noise,
    seconds: float,
    rng: np.random.Generator,
    *,
    walks: dict[int, float] | None = None,
    jump: dict[int, float] | None = None,
    at: float = np.inf,
    vented: bool = False,
    hold: float = 0.02,
) -> tuple[eha.Array, eha.Array]:
    """Blocks for `EhaTracker.push`, and the states behind them.

    Parameters
    ----------
    walks : standard deviations of the parameters' walks per √s, by state; none by default.
    jump, at : what is added to which state at `at` seconds.
    vented : chamber 2 is joined to the accumulator.
    hold : draws speed and position back, so that they stay in reach: small against the noise on speed,
        so that the filter need not know of it.

    Returns
    -------
    (n, COLUMNS) block and (n, STATES) truth.
    """
    n, h, q = round(seconds / PERIOD), PERIOD * 1e3, model()
    variances = [
        (1e-3 / q.moving_mass * noise.force) ** 2 * 1e3 * h,
        (noise.acceleration * 1e-3) ** 2 * 1e-3 * h,
        (noise.flow * 1e9) ** 2 * 1e-3 * h,
        (noise.flow * 1e9) ** 2 * 1e-3 * h,
    ]
    steps, rates = np.zeros(eha.STATES), walks or {}
    for state, size in (jump or {}).items():
        steps[state] = size
    wandering = np.zeros((n, eha.STATES))
    for state, rate in rates.items():
        wandering[:, state] = rate * np.sqrt(PERIOD) * rng.standard_normal(n)
    truth = _run(
        start.copy(), q, rng.standard_normal((n, 4)) * np.sqrt(variances), wandering, noise.initial_valve,
        hold, vented, round(at / PERIOD) if np.isfinite(at) else -1, steps,
    )  # fmt: skip
    block = np.full((n, layout.COLUMNS), np.nan)
    block[:, layout.TIME] = PERIOD * np.arange(n)
    for column, state, scale, sigma in (
        (layout.POSITION, eha.X, 1e-3, noise.position),
        (layout.ANGLE, eha.TH, 1.0, noise.angle),
        (layout.PRESSURE_1, eha.P1, 1e6, noise.pressure),
        (layout.PRESSURE_2, eha.P2, 1e6, noise.pressure),
    ):
        block[:, column] = truth[:, state] * scale + sigma * rng.standard_normal(n)
    block[:, layout.ACCUMULATOR] = ACCUMULATOR * 1e6
    block[:, layout.VISCOSITY] = 1.0
    return block, truth
