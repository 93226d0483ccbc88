"""Section 5.3, Table 5.2: friction over velocity, from a linear run-up, and the curve through it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.frequency_response import velocity
from evidence.thesis.friction_modes import MODES, Mode, drive_both, measured_force
from evidence.thesis.runs import PERIOD, VOLT
from fdd.identification.experiments.friction import fit_curve
from fdd.identification.friction import curve
from fdd.plant.details import Details
from fdd.unit import FrictionBranch, Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

TRIALS = 24
LOWEST = 0.011
"""m/s from which the thesis has measured."""
_RUN_UP, _SLOW_RUN_UP, _LONGEST = 2.0, 8.0, 4.2
_ACCELERATION = 0.11
_REST = 200
_SMOOTHING = 21
_SETTLED = 70
_AT = (0.03, 0.05, 0.11)
_LATE = Details(friction_memory=0.04)


def run_up(
    mode: Mode,
    units: dict[str, Unit],
    seed: int,
    seconds: float = _RUN_UP,
    details: Details | None = None,
) -> tuple[Array, Array]:
    """Speed (m/s) and friction (N) while the cylinder goes from 0 towards 0.22 m/s, (n,) each.

    Friction is pressure force less mass times acceleration, both over 21 ms.
    """
    ramp = np.linspace(0.0, 10.0 * VOLT, round(seconds / PERIOD))[: round(_LONGEST / PERIOD)]
    out = drive_both(mode, units, np.concatenate([np.zeros(_REST), ramp]), seed, details or Details())
    speed = mode.sign * velocity(out.samples["position"], PERIOD, 50.0)
    inertia = out.unit.cylinder.moving_mass * np.gradient(speed, PERIOD)
    window = np.full(_SMOOTHING, 1.0 / _SMOOTHING)
    friction = np.convolve(measured_force(mode, out) - inertia, window, mode="same")
    speed = np.convolve(speed, window, mode="same")
    # Not the start itself: the piston breaks away with a jump that takes this long to settle.
    moving = int(np.flatnonzero(speed > LOWEST)[0])
    part = slice(moving + _SETTLED, -_SMOOTHING)
    return np.asarray(speed[part]), np.asarray(friction[part])


def start_of(mode: Mode, friction: Array) -> tuple[FrictionBranch, tuple[str, ...]]:
    """Where the fit of section 5.3 starts, static friction given, and what it frees."""
    viscous = mode.branch.viscous > 0.0
    start = FrictionBranch(
        coulomb=0.5 * float(np.min(friction)), static=mode.branch.static, stribeck_velocity=0.02,
        stribeck_exponent=0.7, viscous=100.0 if viscous else 0.0,
    )  # fmt: skip
    free = ("coulomb", "stribeck_velocity", "stribeck_exponent")
    return start, (*free, "viscous") if viscous else free


def at_speeds(speed: Array, friction: Array, grid: Array) -> Array:
    """Median friction near each speed of the grid, within 3 % or 2 mm/s, same shape; NaN where none is."""
    near = np.maximum(0.03 * grid, 2e-3)
    there = (np.abs(speed - v) < w for v, w in zip(grid, near, strict=True))
    return np.array([float(np.median(friction[t])) if t.any() else float("nan") for t in there])


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Run up all four modes and fit their curves."""
    units = {"A": axis_a, "B": axis_b}
    grid = np.concatenate([np.array(_AT), np.linspace(LOWEST, 0.20, 24)])
    rows, cells, read, found, scatters, first = [], [], [], {}, [], []
    lag, seal = Details().friction_memory, Details().seal_damping
    for k, mode in enumerate(MODES):
        runs = [run_up(mode, units, seed + 1000 * k + i) for i in range(TRIALS)]
        table = np.array([at_speeds(*run, grid) for run in runs])
        reached = np.isfinite(table).any(axis=0)
        points, spread = np.full(grid.size, np.nan), np.full(grid.size, np.nan)
        points[reached] = np.nanmean(table[:, reached], axis=0)
        spread[reached] = np.nanstd(table[:, reached], axis=0, ddof=1)
        found[mode.name] = points, spread
        scatters += [float(x) for x in spread[: len(_AT)]]
        slow = [run_up(mode, units, seed + 1000 * k + i, _SLOW_RUN_UP) for i in range(TRIALS)]
        slow_points = np.nanmean([at_speeds(*run, np.array(_AT)) for run in slow], axis=0)
        first += [float(speed[0]) for speed, _ in runs]
        used = reached & (np.arange(grid.size) >= len(_AT))
        fit = fit_curve(grid[used], points[used], *start_of(mode, points[used]))
        expected, fitted = curve(mode.branch, grid), curve(fit, grid)
        quick = np.nanmean(
            [at_speeds(*run_up(mode, units, seed + 1000 * k + i, details=_LATE), grid[:3]) for i in range(8)],
            axis=0,
        )
        read.append(
            (
                mode.name,
                *(
                    f"{expected[i]:.0f} / {fitted[i]:.0f} / {points[i]:.0f} / {slow_points[i]:.0f} / "
                    f"{quick[i]:.0f}"
                    for i in range(len(_AT))
                ),
            )
        )
        lagged = curve(mode.branch, grid - _ACCELERATION * lag) + seal * _ACCELERATION * lag
        for i, v in enumerate(_AT):
            rows.append(
                Row(
                    f"friction at {v:g} m/s, {mode.name}", "eqs 5.12 to 5.18", float(expected[i]),
                    float(fitted[i]), "N",
                    why=f"Friction lags the rising speed by {1e3 * lag:.0f} ms in the plant, where the "
                    f"curve is steep: with that, eq. 5.12 gives {lagged[i]:.0f} N. The same trials with a "
                    f"run-up of {_SLOW_RUN_UP:g} s read {slow_points[i]:.0f} N.",
                )
            )  # fmt: skip
        thesis, cell = mode.branch, "{:.0f} / {:.0f}".format
        cells.append(
            (
                mode.name, cell(thesis.coulomb, fit.coulomb),
                f"{thesis.stribeck_velocity:.3f} / {fit.stribeck_velocity:.3f}",
                f"{thesis.stribeck_exponent:.3f} / {fit.stribeck_exponent:.3f}",
                cell(thesis.viscous, fit.viscous),
                f"{np.sqrt(np.nanmean((points - fitted) ** 2)):.1f}",
                f"{np.sqrt(np.nanmean((points - expected) ** 2)):.1f}",
            )
        )  # fmt: skip

    def draw(figure: Figure) -> None:
        fine = np.linspace(1e-3, 0.22, 400)
        for axes, mode in zip(figure.subplots(2, 2, sharex=True, sharey=True).flat, MODES, strict=True):
            points, spread = found[mode.name]
            order = np.argsort(grid)
            axes.errorbar(
                grid[order], points[order], spread[order], fmt="o", markersize=3, linewidth=0.8,
                label=f"plant, {TRIALS} trials ± standard deviation",
            )  # fmt: skip
            axes.plot(fine, curve(mode.branch, fine), "k--", linewidth=1.2, label="thesis, Table 5.2")
            if mode.other is not None:
                axes.plot(fine, curve(mode.other, fine), "C1:", label="thesis, Table 5.3")
            axes.set_title(f"axis {mode.name}", fontsize=10)
            axes.set_ylim(0.0, 520.0)
            axes.legend(fontsize=8)
        figure.supxlabel("speed (m/s)", fontsize=10)
        figure.supylabel("friction (N)", fontsize=10)

    return Finding(
        "Sliding friction",
        "Section 5.3 runs the cylinder, driven by both pumps, from 0 to 0.22 m/s in two seconds, takes "
        "pressure force less mass times acceleration as friction and fits eq. 5.12 with the static "
        f"friction of Table 5.1. Here the same, {TRIALS} trials in each mode, friction read at up to 24 "
        "speeds and eq. 5.12 fitted to them; the rows compare the fitted curves, as the thesis has no other "
        "numbers. The two pumps count as one on one shaft.",
        rows,
        tables=[
            Table(
                "Coefficients of eq. 5.12, thesis (Table 5.2) / fitted to the plant, and distance from "
                "the points",
                ("mode", "Coulomb (N)", "Stribeck velocity (m/s)", "exponent", "viscous (N·s/m)",
                 "rms to the fit (N)", "rms to the thesis's curve (N)"),
                cells,
            ),
            Table(
                f"Friction (N): thesis / plant's curve / plant's points / run-up of {_SLOW_RUN_UP:g} s / a "
                f"lag of {1e3 * _LATE.friction_memory:.0f} ms instead of {1e3 * lag:.0f} ms",
                ("mode", *(f"{v:g} m/s" for v in _AT)),
                read,
            ),
        ],
        remarks=[
            f"The readings begin at {1e3 * min(first):.0f} to {1e3 * max(first):.0f} mm/s: first the pumps' "
            "oil goes into raising the pressure to the static friction, then the piston jumps ahead, and "
            f"{_SETTLED} ms pass until the jump has died away. The thesis plots from {1e3 * LOWEST:.0f} mm/s "
            "on.",
            f"The trials scatter by {min(scatters):.0f} to {max(scatters):.0f} N, their means by "
            f"{min(scatters) / np.sqrt(TRIALS):.1f} to {max(scatters) / np.sqrt(TRIALS):.1f} N.",
            "Table 5.3 lists other curves for three of the four modes (dotted); Table 5.2 agrees with "
            "eqs 5.15 to 5.18 and with figures 5.10 and 5.11's values, and is what the unit profiles "
            "hold. Eq. 5.17 starts from 472.2 N at rest, Table 5.1 has 467.7 N.",
            "Coefficients of one curve trade off against each other: a Stribeck part with an exponent below "
            "one has a long tail that looks like Coulomb friction. Compare the curves, not the coefficients.",
        ],
        pictures=[
            Picture(
                "sliding_friction", "Friction over speed, as figures 5.9 to 5.11.", draw, height=5.8
            )
        ],
    )  # fmt: skip
