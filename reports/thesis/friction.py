"""Section 5.3: static friction of step starts (Table 5.1), and friction over velocity (Table 5.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.identification.experiments.friction import fit_curve
from fdd.identification.friction import curve
from fdd.plant.details import Details
from fdd.plant.simulate import Simulation
from fdd.unit import FrictionBranch, Unit
from reports.thesis.runs import PERIOD, VOLT, Figures, both_pumps, changed, run_speed, velocity
from reports.writing import Panel

Array = NDArray[np.float64]


class Mode(NamedTuple):
    """An operating mode: axis A or B, sign 1 forward or -1 reverse.

    `static`, `spread`: Table 5.1, mean and standard deviation (N). `branch`: Table 5.2 with eqs 5.15 to 5.18;
    Table 5.3 contradicts it for all but A forward.
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
_SMOOTHING = 21
_SETTLED = 70
_AT = (0.03, 0.05, 0.11)
_LATE = Details(friction_memory=0.04)


def drive_both(mode: Mode, units: dict[str, Unit], speed: Array, seed: int, details: Details) -> Simulation:
    """Drive one cylinder by both pumps, without load, from near the stroke's end, at a `speed` (n,) rad/s;
    `details` are for one pump, its dry friction is doubled."""
    other = "B" if mode.axis == "A" else "A"
    driven = both_pumps(units[mode.axis], units[other])
    twice = details.model_copy(update={"pump_coulomb_torque": 2.0 * details.pump_coulomb_torque})
    return run_speed(driven, mode.sign * speed, start=-0.12 * mode.sign, seed=seed, details=twice)


def force_of(mode: Mode, unit: Unit, pressure: Array) -> Array:
    """Force of a pressure difference along the motion (N), (n,)."""
    return np.asarray(mode.sign * 0.5 * (unit.cylinder.area_1 + unit.cylinder.area_2) * pressure)


def peaks(
    mode: Mode, units: dict[str, Unit], seed: int, details: Details | None = None, volts: Array = VOLTS
) -> tuple[Array, Array]:
    """Peak force of a step start at each of `volts`, a trial each: by the sensor and in truth, (20,) N."""
    found = []
    for i, volt in enumerate(volts):
        n = round(min(0.2 / (7.3e-4 * VOLT * volt), 1.0) / PERIOD)
        speed = np.concatenate([np.zeros(_REST), np.full(n, VOLT * volt)])
        out = drive_both(mode, units, speed, seed + i, details or Details())
        logs = (out.samples, out.truth)
        found.append([np.max(force_of(mode, out.unit, log["pressure_difference"])) for log in logs])
    measured, true = np.array(found).T
    return measured, true


def creeping_peaks(mode: Mode, units: dict[str, Unit], seed: int, trials: int = 10) -> Array:
    """Peak force, mean over 0.25 s, where both pumps start so slowly that the pressure needs seconds to rise,
    (trials,) N."""
    found, speed = [], np.full(round(_CREEP_TIME / PERIOD), VOLT * _CREEP_VOLT)
    for i in range(trials):
        out = drive_both(mode, units, speed, seed + i, Details())
        force = force_of(mode, out.unit, out.samples["pressure_difference"])
        found.append(float(np.max(np.convolve(force, np.full(250, 0.004), mode="valid"))))
    return np.array(found)


def _line(values: Array) -> tuple[float, float]:
    """Slope (N/V) of a straight line through the peaks over the step's size, and their std (N) about it."""
    line = np.polyfit(VOLTS, values, 1)
    return float(line[0]), float(np.std(values - np.polyval(line, VOLTS), ddof=2))


def _rise(mode: Mode, units: dict[str, Unit], seed: int, as_is: Array) -> dict[str, Array]:
    """One mode's peaks with one thing changed at a time."""
    masses = {name: 0.1 * unit.cylinder.moving_mass for name, unit in units.items()}
    lighter = {name: changed(unit, "cylinder", moving_mass=masses[name]) for name, unit in units.items()}
    return {
        "as it is": as_is,
        f"all steps of {_ALIKE:g} V": peaks(mode, units, seed, volts=np.full(VOLTS.size, _ALIKE))[0],
        "a tenth of the piston's mass": peaks(mode, lighter, seed)[0],
        "no resistance of the seal to quick changes": peaks(mode, units, seed, Details(seal_damping=0.0))[0],
        "the friction's lag 10 ms": peaks(mode, units, seed, Details(friction_memory=0.01))[0],
    }


def static_friction(axis_a: Unit, axis_b: Unit, seed: int) -> Figures:
    """Table 5.1: static friction as the pressure peak of step starts, in all four modes."""
    units = {"A": axis_a, "B": axis_b}
    both = {m.name: peaks(m, units, seed + 1000 * k) for k, m in enumerate(MODES)}
    found = {name: measured for name, (measured, _) in both.items()}
    creeping = {m.name: creeping_peaks(m, units, seed + 1000 * k + 500) for k, m in enumerate(MODES)}
    slopes = {name: _line(values)[0] for name, values in found.items()}
    steepest = max(MODES, key=lambda m: slopes[m.name])
    return {
        "modes": MODES,
        "peaks": found,
        "creeping": creeping,
        "slopes": slopes,
        "steepest": steepest.name,
        "rise": _rise(steepest, units, seed + 1000 * MODES.index(steepest), found[steepest.name]),
        "line": _line,
        "sure": _SURE,
        "noise": np.mean([np.mean(measured - true) for measured, true in both.values()]),
        "lower": [found[m.name].mean() - creeping[m.name].mean() for m in MODES],
        "plain": peaks(MODES[0], units, seed, Details(breakaway=0.0))[0],
        "at_slowest": float(curve(MODES[0].branch, np.array(LOWEST))),
    }


def run_up(
    mode: Mode, units: dict[str, Unit], seed: int, seconds: float = _RUN_UP, details: Details | None = None
) -> tuple[Array, Array]:
    """Speed (m/s) and friction (N), pressure force less mass times acceleration, while the cylinder goes from
    0 towards 0.22 m/s, (n,) each, over 21 ms."""
    ramp = np.linspace(0.0, 10.0 * VOLT, round(seconds / PERIOD))[: round(_LONGEST / PERIOD)]
    out = drive_both(mode, units, np.concatenate([np.zeros(_REST), ramp]), seed, details or Details())
    speed = mode.sign * velocity(out.samples["position"], 50.0)
    inertia = out.unit.cylinder.moving_mass * np.gradient(speed, PERIOD)
    window = np.full(_SMOOTHING, 1.0 / _SMOOTHING)
    force = force_of(mode, out.unit, out.samples["pressure_difference"])
    friction = np.convolve(force - inertia, window, mode="same")
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
    fine = np.linspace(1e-3, 0.22, 400)
    scatters, first, panels, modes = [], [], [], []
    for k, mode in enumerate(MODES):
        seeds = range(seed + 1000 * k, seed + 1000 * k + TRIALS)
        runs = [run_up(mode, units, i) for i in seeds]
        table = np.array([at_speeds(*run, grid) for run in runs])
        reached = np.isfinite(table).any(axis=0)
        points = np.full(grid.size, np.nan)
        points[reached] = np.nanmean(table[:, reached], axis=0)
        scatters += np.nanstd(table[:, : at.size], axis=0, ddof=1).tolist()
        slow = np.nanmean([at_speeds(*run_up(mode, units, i, _SLOW_RUN_UP), at) for i in seeds], axis=0)
        late = np.nanmean([at_speeds(*run_up(mode, units, i, details=_LATE), at) for i in seeds[:8]], axis=0)
        first += [float(speed[0]) for speed, _ in runs]
        used = reached & (np.arange(grid.size) >= at.size)
        fit = fit_curve(grid[used], points[used], *start_of(mode, points[used]))
        expected, fitted = curve(mode.branch, grid), curve(fit, grid)
        modes.append({
            "name": mode.name,
            "thesis": mode.branch,
            "fit": fit,
            "at": list(zip(_AT, expected, fitted, points, slow, late, strict=False)),
            "off_fit": np.sqrt(np.nanmean((points - fitted) ** 2)),
            "off_thesis": np.sqrt(np.nanmean((points - expected) ** 2)),
        })  # fmt: skip
        curves = [
            (grid, points, "C0o", f"plant, mean of {TRIALS} trials"),
            (fine, curve(mode.branch, fine), "k--", "thesis, Table 5.2"),
        ]
        axes = {"title": f"axis {mode.name}", "xlabel": "speed (m/s)", "ylabel": "friction (N)"}
        panels.append(Panel(curves, {**axes, "ylim": (0, 520)}))
    return {"modes": modes, "first": first, "scatters": scatters, "trials": TRIALS, "picture": panels}
