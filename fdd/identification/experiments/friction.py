"""Friction over velocity from one's own strokes, each direction apart (thesis 5.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from fdd.identification import Array
from fdd.identification.experiments import NORMAL_95, Outcome, Told, axes, cloud, curve_line, points
from fdd.identification.friction import Motion, curve, gusty, near_curve, steady_motion, unloaded_motion
from fdd.identification.record import Record
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.report.words import listed
from fdd.unit import FrictionBranch, Unit

BINS = np.geomspace(1e-3, 2.0, 34)
"""m/s, edges: ten a decade."""
LEAST_WINDOWS = 5
"""Of 40 ms that a bin needs."""
LEAST_BINS = 3
REPEATS = 100
"""Of the bootstrap over blocks of 2 s."""
SHARP = 0.5
"""Half width of an interval over its value up to which a coefficient counts as told."""
SLOW, FAST = 1.0, 3.0
"""Times the profile's Stribeck velocity that the slowest and the fastest strokes must reach at least."""
ZERO_PRESSURE = 3.0e3
"""Pa, standard deviation of a pressure sensor's zero."""
RANGES = {"stribeck_velocity": (1e-4, 0.2, 0.01), "stribeck_exponent": (0.1, 3.0, 1.0)}
"""Least, most, and usual size."""
COEFFICIENTS = {
    "coulomb": ("Coulomb friction", "N"), "static": ("static friction", "N"),
    "stribeck_velocity": ("Stribeck velocity", "m/s"), "viscous": ("viscous friction", "N*s/m"),
}  # fmt: skip


def fit_curve(speed: Array, friction: Array, start: FrictionBranch, free: tuple[str, ...]) -> FrictionBranch:
    """Least squares of eq. 5.12 to `friction` (N) at `speed` (m/s), (n,) each.

    `free` are the coefficients to fit, from `start`, which has the others.

    Examples
    --------
    >>> v = np.linspace(0.01, 0.2, 50)
    >>> start = FrictionBranch(
    ...     coulomb=50.0, static=400.0, stribeck_velocity=0.01, stribeck_exponent=1.0, viscous=0.0)
    >>> free = ("coulomb", "stribeck_velocity", "stribeck_exponent")
    >>> found = fit_curve(v, 100.0 + 300.0 * np.exp(-((v / 0.02) ** 0.7)), start, free)
    >>> round(found.coulomb, 3), round(found.stribeck_velocity, 5), round(found.stribeck_exponent, 3)
    (100.0, 0.02, 0.7)
    """
    low, high, scale = zip(*(RANGES.get(n, (0.0, np.inf, 100.0)) for n in free), strict=True)

    def branch(theta: Array) -> FrictionBranch:
        return start.model_copy(update=dict(zip(free, theta.tolist(), strict=True)))

    solved = least_squares(
        lambda theta: curve(branch(theta), speed) - friction,
        np.clip([getattr(start, n) for n in free], low, high), bounds=(low, high), x_scale=scale,
        max_nfev=2000, xtol=1e-12, ftol=1e-12,
    )  # fmt: skip
    return branch(solved.x)


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
        "Stribeck exponent stays the profile's: a log does not tell it apart from the Stribeck velocity. "
        "Coefficients trade off against each other; compare curves."
    )
    out.heads = ("direction", "speed", "friction", "95 %", "profile", "time")
    ways = ((1.0, "forward", tr.BLUE), (-1.0, "reverse", tr.VERMILLION))
    for (sign, name, colour), centre in zip(ways, centres, strict=True):
        branch: FrictionBranch = getattr(unit.friction, name)
        _direction(out, motion, near_curve(motion, sign, branch, centre), branch, name, colour, area)
    return out


def _binned(speed: Array, force: Array) -> tuple[Array, Array]:
    """(k,) median speeds and forces of the bins with windows enough."""
    which = np.digitize(speed, BINS)
    bins = [which == b for b in np.flatnonzero(np.bincount(which) >= LEAST_WINDOWS)]
    return np.array([np.median(speed[b]) for b in bins]), np.array([np.median(force[b]) for b in bins])


def _direction(
    out: Outcome, motion: Motion, kept: NDArray[np.bool_], base: FrictionBranch, name: str, colour: str,
    area: float,
) -> None:  # fmt: skip
    speed, force, block = motion.speed[kept], motion.force[kept], motion.block[kept]
    v, f = _binned(speed, force)
    if v.size < LEAST_BINS:
        out.not_told.append(f"Friction {name}: steady motion at fewer than {LEAST_BINS} speeds.")
        return
    # The coefficients that these speeds can tell; the profile's stand in for the rest.
    slow, fast = v[0] <= SLOW * base.stribeck_velocity, v[-1] >= FAST * base.stribeck_velocity
    free = ("coulomb", *(("static", "stribeck_velocity") if slow else ()), *(("viscous",) if fast else ()))
    fit = fit_curve(v, f, base, free)
    rng = np.random.default_rng(0)
    names, where = np.unique(block, return_inverse=True)
    rows = [np.flatnonzero(where == k) for k in range(names.size)]
    curves, coefficients = [], []
    for _ in range(REPEATS):
        drawn = np.concatenate([rows[k] for k in rng.integers(0, names.size, names.size)])
        vb, fb = _binned(speed[drawn], force[drawn])
        if vb.size >= LEAST_BINS:
            again = fit_curve(vb, fb, fit, free)
            coefficients.append([getattr(again, n) for n in free])
            curves.append(curve(again, v))
    zero = ZERO_PRESSURE * area
    wide = float(student.ppf(0.975, max(names.size - 1, 1))) * np.sqrt(names.size / max(names.size - 1, 1))
    half = wide * np.hypot(np.std(curves, axis=0), zero)
    on_curve = curve(fit, v)
    vague = []
    for n, std in zip(free, np.std(coefficients, axis=0), strict=True):
        words, unit = COEFFICIENTS[n]
        spread = wide / 1.96 * float(np.hypot(std, zero if unit == "N" else 0.0))
        ours = Told.within("", getattr(base, n), 0.0, unit).shown()
        told = Told.within(f"{words}, {name}", getattr(fit, n), NORMAL_95 * spread, unit,
                           f"profile {ours[0]} {ours[2]}")  # fmt: skip
        if told.high - told.value < SHARP * told.value:
            out.told.append(told)
        else:
            vague.append(words)
    if not slow:
        out.not_told.append(
            f"No steady strokes {name} below {1e3 * v[0]:.3g} mm/s: the Stribeck part is not told "
            f"(the profile's Stribeck velocity is {1e3 * base.stribeck_velocity:.3g} mm/s)."
        )
    if not fast:
        out.not_told.append(f"No strokes {name} above {1e3 * v[-1]:.3g} mm/s: the viscous part is not told.")
    if vague:
        said, they = listed(vague, "and"), "it" if len(vague) == 1 else "them"
        out.not_told.append(
            f"{said[0].upper()}{said[1:]}, {name}: the log does not tell {they} to within half of the value."
        )
    for vi, fi, hi, ours in zip(v, on_curve, half, curve(base, v), strict=True):
        seconds = 0.04 * np.count_nonzero(np.digitize(speed, BINS) == np.digitize(vi, BINS))
        out.rows.append((name, f"{1e3 * vi:.3g} mm/s", f"{fi:.0f} N", f"{fi - hi:.0f} … {fi + hi:.0f} N",
                         f"{ours:.0f} N", f"{seconds:.1f} s"))  # fmt: skip
    interval = {"low": on_curve - half, "high": on_curve + half}
    out.curves[name] = {"speed": v, "friction": on_curve, **interval, "median": f}
    fine = np.geomspace(0.7 * v[0], 1.2 * v[-1], 200)
    data = [cloud(1e3 * speed, force, "40 ms of motion", tr.GREY),
            points(1e3 * v, f, f - half, f + half, "medians, 95 %", colour),
            curve_line(1e3 * fine, curve(fit, fine), "fitted", colour),
            curve_line(1e3 * fine, curve(base, fine), "profile", tr.GREY, "dash")]  # fmt: skip
    layout = axes("speed (mm/s)", rangemode="tozero") | {"yaxis": {"rangemode": "tozero"}}
    out.figures.append(Figure(name, f"Friction, {name}", data, layout, "N", "", 340))
