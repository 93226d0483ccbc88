"""Friction over velocity from one's own strokes, each direction apart (thesis 5.3).

The curves are those that identification fits; beside them stands what each speed says alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.identification.experiments.outcome import Outcome, axes, cloud, curve_line, figure, points
from fdd.identification.friction import (
    BranchFit,
    Motion,
    curve,
    fit_branch,
    gusty,
    near_curve,
    steady_motion,
    unloaded_motion,
)
from fdd.identification.least_squares import jackknife_std
from fdd.identification.record import Record
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.unit import FrictionBranch, Unit

Array = NDArray[np.float64]

BINS = np.geomspace(1e-3, 2.0, 34)
"""m/s, edges: ten a decade."""
LEAST_WINDOWS = 5
"""Of 40 ms that a bin needs."""
LEAST_BINS = 3
GROUPS = 12
"""Of the jackknife over blocks of 2 s."""
SHARP = 0.25
"""Relative standard deviation up to which a coefficient counts as told."""
SLOW, FAST = 1.0, 3.0
"""Times the profile's Stribeck velocity that the slowest and the fastest strokes must reach at least."""
ZERO_PRESSURE = 3.0e3
"""Pa, standard deviation of a pressure sensor's zero."""


def friction(records: list[Record], unit: Unit) -> Outcome:
    """Friction curves by the force balance in steady motion, less the load where it is measured.

    The profile's curves tell unloaded motion from loaded.
    """
    out = Outcome("friction", "Friction over velocity")
    area = unit.cylinder.area_1
    free = [r if r.load is None else replace(r, pressure_1=r.pressure_1 - r.load / area) for r in records]
    steady = steady_motion(free, unit.cylinder)
    found = None if gusty(steady, unit.friction) else unloaded_motion(steady, unit.friction)
    if found is None:
        out.not_told.append(
            "Friction in either direction: no unloaded steady motion of half a second each way could be told "
            "from loads. Record strokes at constant speeds without load, or map load_force."
        )
        return out
    motion, centres, notes = found
    out.notes += notes
    if any(r.load is not None for r in records):
        out.notes.append("The measured load force was taken off.")
    out.notes.append(
        "Force is pressures times areas less mass times acceleration over 40 ms of steady motion. The "
        "Stribeck velocity and exponent stay the profile's: a log does not tell them apart. Coefficients "
        "trade off against each other; compare curves."
    )
    out.heads = ("direction", "speed", "friction", "95 %", "fitted", "profile", "time")
    ways = ((1.0, "forward", tr.BLUE), (-1.0, "reverse", tr.VERMILLION))
    for (sign, name, colour), centre in zip(ways, centres, strict=True):
        base: FrictionBranch = getattr(unit.friction, name)
        fit = fit_branch(motion, sign, base, centre, ZERO_PRESSURE * area)
        _direction(out, motion, near_curve(motion, sign, base, centre), fit, base, name, colour, area)
    return out


def _direction(
    out: Outcome, motion: Motion, kept: NDArray[np.bool_], fit: BranchFit | None, base: FrictionBranch,
    name: str, colour: str, area: float,
) -> None:  # fmt: skip
    speed, force, block = motion.speed[kept], motion.force[kept], motion.block[kept]
    which = np.digitize(speed, BINS)
    bins = np.flatnonzero(np.bincount(which) >= LEAST_WINDOWS)
    if bins.size < LEAST_BINS or fit is None:
        out.not_told.append(f"Friction {name}: steady motion at fewer than {LEAST_BINS} speeds.")
        return
    v, f = (np.array([np.median(x[which == b]) for b in bins]) for x in (speed, force))
    zero, half = ZERO_PRESSURE * area, np.empty(f.size)
    for k, b in enumerate(bins):
        inside, group = force[which == b], np.unique(block[which == b], return_inverse=True)[1] % GROUPS
        groups = np.unique(group)
        # A speed that came in one block alone scatters by what it is.
        parts = [np.median(inside[group != g]) for g in groups] if groups.size > 1 else [f[k], 0.0]
        scatter = float(jackknife_std(np.array(parts)))
        half[k] = float(student.ppf(0.975, max(groups.size - 1, 1))) * np.hypot(scatter, zero)
    slowest, fastest, limit = 1e3 * v[0], 1e3 * v[-1], 1e3 * base.stribeck_velocity
    slow, fast = slowest <= SLOW * limit, fastest >= FAST * limit
    for coefficient, words, si, there in (
        ("coulomb", "Coulomb friction", "N", True), ("static", "static friction", "N", slow),
        ("viscous", "viscous friction", "N*s/m", fast),
    ):  # fmt: skip
        value, std = float(getattr(fit.branch, coefficient)), fit.stds[coefficient]
        if there and std < SHARP * value:
            ours = f"profile {figure(getattr(base, coefficient))} {si.replace('*', '·')}"
            out.tell(f"{words}, {name}", value, std, si, ours)
        elif there:
            vague = f"{words[0].upper()}{words[1:]}, {name}"
            out.not_told.append(f"{vague}: the log does not tell it to within half of the value.")
    if not slow:
        out.not_told.append(
            f"No steady strokes {name} below {slowest:.3g} mm/s: the Stribeck part is not told "
            f"(the profile's Stribeck velocity is {limit:.3g} mm/s)."
        )
    if not fast:
        out.not_told.append(f"No strokes {name} above {fastest:.3g} mm/s: the viscous part is not told.")
    columns = (v, f, half, curve(fit.branch, v), curve(base, v), np.bincount(which)[bins])
    for vi, fi, hi, fitted, ours, count in zip(*columns, strict=True):
        out.rows.append((
            name, f"{1e3 * vi:.3g} mm/s", f"{fi:.0f} N", f"{fi - hi:.0f} … {fi + hi:.0f} N",
            f"{fitted:.0f} N", f"{ours:.0f} N", f"{0.04 * count:.1f} s",
        ))  # fmt: skip
    out.curves[name] = {"speed": v, "friction": f, "low": f - half, "high": f + half, "fitted": columns[3]}
    fine = np.geomspace(0.7 * v[0], 1.2 * v[-1], 200)
    data = [cloud(1e3 * speed, force, "40 ms of motion", tr.GREY),
            points(1e3 * v, f, f - half, f + half, "medians, 95 %", colour),
            curve_line(1e3 * fine, curve(fit.branch, fine), "fitted", colour),
            curve_line(1e3 * fine, curve(base, fine), "profile", tr.GREY, "dash")]  # fmt: skip
    layout = axes("speed (mm/s)", rangemode="tozero") | {"yaxis": {"rangemode": "tozero"}}
    out.figures.append(Figure(name, f"Friction, {name}", data, layout, "N", "", 340))
