"""Section 5.3: static friction of step starts (Table 5.1), and friction over velocity (Table 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.identification.experiments.friction import fit_curve
from fdd.identification.friction import curve
from fdd.plant.details import Details
from fdd.plant.simulate import Simulation
from fdd.unit import FrictionBranch, Unit
from reports.thesis.frequency_response import velocity
from reports.thesis.runs import PERIOD, VOLT, Array, Figures, run_speed


@dataclass(frozen=True)
class Mode:
    """One of the thesis's operating modes.

    `axis`, `sign`: A or B, and 1 forward or -1 reverse. `static`, `spread`: Table 5.1, mean and standard
    deviation (N). `branch`: Table 5.2 with eqs 5.15 to 5.18; Table 5.3 contradicts it for all but A forward.
    """

    axis: str
    sign: float
    static: float
    spread: float
    branch: FrictionBranch

    @property
    def name(self) -> str:
        """As the thesis names it."""
        return f"{self.axis} {'forward' if self.sign > 0 else 'reverse'}"


def _branch(coulomb: float, static: float, speed: float, exponent: float, viscous: float) -> FrictionBranch:
    stribeck = {"stribeck_velocity": speed, "stribeck_exponent": exponent}
    return FrictionBranch(coulomb=coulomb, static=static, viscous=viscous, **stribeck)


MODES = (
    Mode("A", 1.0, 510.4, 41.5, _branch(151.1, 510.2, 0.026, 0.590, 0.0)),
    Mode("A", -1.0, 448.0, 42.1, _branch(113.0, 448.0, 0.007, 0.776, 123.0)),
    Mode("B", 1.0, 467.7, 48.0, _branch(75.0, 472.2, 0.010, 0.743, 138.0)),
    Mode("B", -1.0, 479.2, 43.9, _branch(72.0, 479.2, 0.016, 0.835, 109.0)),
)
"""B forward: eq. 5.17 has 75 + 397.2 N at rest where Table 5.1 has 467.7 N."""

VOLTS = np.array([0.5, 0.75, *np.arange(1.0, 9.01, 0.5), 10.0])
"""Step sizes; the thesis steps between 0.5 and 10 V."""
_SURE = 2.0 / np.sqrt(2.0 * (VOLTS.size - 1))
"""Twice the relative sampling error of a standard deviation from that many trials."""
_REST = 200
_CREEP_VOLT, _CREEP_TIME = 0.13, 15.0
_ALIKE = 5.0

TRIALS = 24
LOWEST = 0.011
"""m/s from which the thesis has measured."""
_RUN_UP, _SLOW_RUN_UP, _LONGEST = 2.0, 8.0, 4.2
_ACCELERATION = 0.11
_SMOOTHING = 21
_SETTLED = 70
_AT = (0.03, 0.05, 0.11)


def drive_both(mode: Mode, units: dict[str, Unit], speed: Array, seed: int, details: Details) -> Simulation:
    """Drive one cylinder in one direction by both pumps, without load, from near the stroke's end.

    Flows of the pumps add, and so do the torques and inertias on what counts here as one shaft. The dual rig
    with open connect valves would carry the other cylinder, and its seals, along.

    `units`: A and B. `speed`: (n,) rad/s, magnitude commanded of both pumps. `seed`: of the trial. `details`:
    for one pump; its dry friction is doubled.
    """
    driven, other = units[mode.axis].model_copy(deep=True), units["B" if mode.axis == "A" else "A"]
    for part, names in (
        ("pump", ("displacement", "cross_port_leakage", "case_leakage")),
        ("drive", ("inertia", "viscous_friction", "current_limit")),
    ):
        mine, theirs = getattr(driven, part), getattr(other, part)
        for name in names:
            setattr(mine, name, getattr(mine, name) + getattr(theirs, name))
    twice = details.model_copy(update={"pump_coulomb_torque": 2.0 * details.pump_coulomb_torque})
    return run_speed(driven, mode.sign * speed, start=-0.12 * mode.sign, seed=seed, details=twice)


def force_of(mode: Mode, run: Simulation) -> Array:
    """Force of the measured pressure difference along the motion (N), (n,)."""
    area = 0.5 * (run.unit.cylinder.area_1 + run.unit.cylinder.area_2)
    return np.asarray(mode.sign * area * run.samples["pressure_difference"])


def peaks(
    mode: Mode, units: dict[str, Unit], seed: int, details: Details | None = None, volts: Array = VOLTS
) -> Array:
    """Peak force (N) of a step start at each of `volts`, a trial each."""
    found = []
    for i, volt in enumerate(volts):
        n = round(min(0.2 / (7.3e-4 * VOLT * volt), 1.0) / PERIOD)
        speed = np.concatenate([np.zeros(_REST), np.full(n, VOLT * volt)])
        found.append(np.max(force_of(mode, drive_both(mode, units, speed, seed + i, details or Details()))))
    return np.array(found)


def creeping_peaks(mode: Mode, units: dict[str, Unit], seed: int, trials: int = 10) -> Array:
    """Peak force where both pumps start so slowly that the pressure needs seconds to rise, (trials,) N.

    The sensor's noise is averaged over 0.25 s.
    """
    speed = np.full(round(_CREEP_TIME / PERIOD), VOLT * _CREEP_VOLT)
    forces = (force_of(mode, drive_both(mode, units, speed, seed + i, Details())) for i in range(trials))
    return np.array([np.max(np.convolve(f, np.full(250, 0.004), mode="valid")) for f in forces])


def _about_line(values: Array) -> float:
    """Standard deviation (N) of the peaks about a straight line over the step's size."""
    left = values - np.polyval(np.polyfit(VOLTS, values, 1), VOLTS)
    return float(np.std(left, ddof=2))


def static_friction(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Table 5.1: static friction as the pressure peak of step starts, in all four modes."""
    units = {"A": axis_a, "B": axis_b}
    found = {m.name: peaks(m, units, seed + 1000 * k) for k, m in enumerate(MODES)}
    slopes = {name: float(np.polyfit(VOLTS, values, 1)[0]) for name, values in found.items()}
    steepest = max(MODES, key=lambda m: slopes[m.name])
    its_seed = seed + 1000 * MODES.index(steepest)
    return {
        "modes": MODES,
        "peaks": found,
        "creeping": {m.name: creeping_peaks(m, units, seed + 1000 * k + 500) for k, m in enumerate(MODES)},
        "slopes": slopes,
        "alike": peaks(steepest, units, its_seed, volts=np.full(VOLTS.size, _ALIKE)),
        "about_line": _about_line,
        "sure": _SURE,
        "drawn": {name: unit.friction.trial_spread for name, unit in units.items()},
        "plain": peaks(MODES[0], units, seed, Details(breakaway=0.0)),
        "at_slowest": MODES[0].branch.coulomb + 359.1 * np.exp(-((0.011 / 0.026) ** 0.590)),
    }


def run_up(mode: Mode, units: dict[str, Unit], seed: int, seconds: float = _RUN_UP) -> tuple[Array, Array]:
    """Speed (m/s) and friction (N) while the cylinder goes from 0 towards 0.22 m/s, (n,) each.

    Friction is pressure force less mass times acceleration, both over 21 ms.
    """
    ramp = np.linspace(0.0, 10.0 * VOLT, round(seconds / PERIOD))[: round(_LONGEST / PERIOD)]
    out = drive_both(mode, units, np.concatenate([np.zeros(_REST), ramp]), seed, Details())
    speed = mode.sign * velocity(out.samples["position"], PERIOD, 50.0)
    inertia = out.unit.cylinder.moving_mass * np.gradient(speed, PERIOD)
    window = np.full(_SMOOTHING, 1.0 / _SMOOTHING)
    friction = np.convolve(force_of(mode, out) - inertia, window, mode="same")
    speed = np.convolve(speed, window, mode="same")
    # Not the start itself: the piston breaks away with a jump that takes this long to settle.
    moving = int(np.flatnonzero(speed > LOWEST)[0])
    part = slice(moving + _SETTLED, -_SMOOTHING)
    return np.asarray(speed[part]), np.asarray(friction[part])


def start_of(mode: Mode, friction: Array) -> tuple[FrictionBranch, tuple[str, ...]]:
    """Where the fit of section 5.3 starts, static friction given, and what it frees."""
    viscous = mode.branch.viscous > 0.0
    start = _branch(0.5 * float(np.min(friction)), mode.branch.static, 0.02, 0.7, 100.0 if viscous else 0.0)
    free = ("coulomb", "stribeck_velocity", "stribeck_exponent")
    return start, (*free, "viscous") if viscous else free


def at_speeds(speed: Array, friction: Array, grid: Array) -> Array:
    """Median friction near each speed of the grid, within 3 % or 2 mm/s, same shape; NaN where none is."""
    near = np.maximum(0.03 * grid, 2e-3)
    there = (np.abs(speed - v) < w for v, w in zip(grid, near, strict=True))
    return np.array([float(np.median(friction[t])) if t.any() else float("nan") for t in there])


def sliding_friction(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Table 5.2: friction over velocity from a linear run-up in all four modes, and the curve through it."""
    units, at = {"A": axis_a, "B": axis_b}, np.array(_AT)
    grid = np.concatenate([at, np.linspace(LOWEST, 0.20, 24)])
    modes, lag, seal = [], Details().friction_memory, Details().seal_damping
    for k, mode in enumerate(MODES):
        seeds = range(seed + 1000 * k, seed + 1000 * k + TRIALS)
        table = np.array([at_speeds(*run_up(mode, units, i), grid) for i in seeds])
        reached = np.isfinite(table).any(axis=0)
        points = np.full(grid.size, np.nan)
        points[reached] = np.nanmean(table[:, reached], axis=0)
        slow = np.nanmean([at_speeds(*run_up(mode, units, i, _SLOW_RUN_UP), at) for i in seeds], axis=0)
        used = reached & (np.arange(grid.size) >= at.size)
        fit = fit_curve(grid[used], points[used], *start_of(mode, points[used]))
        expected, fitted = curve(mode.branch, grid), curve(fit, grid)
        modes.append({
            "name": mode.name,
            "thesis": mode.branch,
            "fit": fit,
            "at": list(zip(_AT, expected, fitted, points, slow, strict=False)),
            "lagged": curve(mode.branch, at - _ACCELERATION * lag) + seal * _ACCELERATION * lag,
            "off_fit": np.sqrt(np.nanmean((points - fitted) ** 2)),
            "off_thesis": np.sqrt(np.nanmean((points - expected) ** 2)),
        })  # fmt: skip
    return {"modes": modes, "trials": TRIALS}
