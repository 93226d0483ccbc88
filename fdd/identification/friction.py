"""Friction curves of the cylinder, per direction, from the force balance in motion.

``A1·p1 - A2·p2 - M·a = F(v) + load``, with ``F(v) = C + (S - C)·exp(-(v/v_s)^δ) + B·v`` (thesis eq.
5.12, 5.3). The load of a healthy log is unknown and may be throttled strokes, a spring or a weight, so
the unloaded motion is found first: over the base's curve, its force makes the lowest dense cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fdd.identification import Array, Estimate, huber, jackknife_std
from fdd.identification.record import Record
from fdd.unit import Cylinder, Friction, FrictionBranch

WINDOW = 0.04
"""s, over which force and velocity are averaged."""
SLOWEST = 1e-3
"""m/s: slower motion is presliding."""
HASTIEST = 1.0
"""m/s²: beyond it an unknown mass on the rod would tell."""
CLUSTER_WIDTH = 0.12
"""Of the logarithm of force over the base's friction."""
CLUSTER_REACH = 0.40
LEAST_SHARE = 0.15
"""Of the motion in a direction that the unloaded cluster must hold."""
LEAST_SECONDS = 0.5
MOST_PUSHED = 0.1
"""Of the motion that the load pushes, its constant and spring taken off or not: beyond it gusts hide the
friction, and the lowest cluster of what resists is no friction curve."""
THROUGH_GUSTS = 0.25
"""Relative standard deviation up to which friction seen through gusts replaces the base's."""
ASYMMETRY = 2.5
"""Change of the forward to reverse ratio beyond which a weight, not friction, is at work."""
FOUND = ("coulomb", "static", "viscous")
"""Of a curve: N, N and N·s/m."""
_BINS = np.geomspace(SLOWEST, 1.0, 22)
_GROUPS = 8


@dataclass(frozen=True)
class BranchFit:
    """Friction of one direction: each of `FOUND`, and how it was found; the rest stays the base's."""

    estimates: dict[str, Estimate]
    note: str


@dataclass(frozen=True)
class Motion:
    """Windows of steady motion: force along it, speed, direction, where, in which 2 s block and log.

    Break-aways are left out: the pump starts too fast for the peak to be the static friction.
    """

    force: Array
    speed: Array
    direction: Array
    position: Array
    block: NDArray[np.int64]
    log: NDArray[np.int64]

    def ratio(self, base: Friction) -> Array:
        """(n,) force over the friction (N) of either direction's curve."""
        return self.force / np.maximum(self.expected(base), 1.0)

    def expected(self, base: Friction) -> Array:
        """(n,) friction (N) of either direction's curve."""
        forward, reverse = (curve(branch, self.speed) for branch in (base.forward, base.reverse))
        return np.where(self.direction > 0, forward, reverse)


def curve(branch: FrictionBranch, speed: Array) -> Array:
    """Steady friction (N) at `speed` ≥ 0 (m/s), same shape."""
    stribeck = np.exp(-((speed / branch.stribeck_velocity) ** branch.stribeck_exponent))
    return np.asarray(branch.coulomb + (branch.static - branch.coulomb) * stribeck + branch.viscous * speed)


def fit_friction(
    records: list[Record], cylinder: Cylinder, base: Friction, zero_force: float = 0.0
) -> tuple[dict[str, BranchFit], list[str]]:
    """Curves with standard deviations by direction, forward and reverse, but for those where the base's is
    kept; and notes: why, or how it was seen.

    The curves of `base` give the shape where the data do not. The pressure sensors' zeros feign a force of
    standard deviation `zero_force` (N), which shifts both directions' friction in opposite senses.
    """
    motion = steady_motion(records, cylinder)
    if gusty(motion, base):
        return _through_gusts(motion, base, zero_force)
    free = unloaded_motion(motion, base)
    if free is None:
        return {}, []
    motion, (forward, reverse), notes = free
    fits = {
        "forward": _branch(motion, 1.0, base.forward, forward, zero_force),
        "reverse": _branch(motion, -1.0, base.reverse, reverse, zero_force),
    }
    return {direction: fit for direction, fit in fits.items() if fit}, notes


def steady_motion(records: list[Record], cylinder: Cylinder) -> Motion:
    """The windows of all logs; no block lies in two."""
    parts = []
    for k, record in enumerate(records):
        step, h = record.rows(WINDOW), record.period
        v, _ = record.speeds(0.02)
        v = record.smooth(v, 0.02)
        a = np.gradient(record.smooth(v, 0.02), h)
        force = cylinder.area_1 * record.pressure_1 - cylinder.area_2 * record.pressure_2
        force = record.smooth(force - cylinder.moving_mass * a, 0.02)
        n = len(record) // step * step
        vw, aw, fw, xw, gap = (c[:n].reshape(-1, step) for c in (v, a, force, record.position, record.gap))
        speed = np.abs(vw.mean(axis=1))
        steady = (
            (np.abs(vw).min(axis=1) > 0.5 * SLOWEST)
            & (speed > SLOWEST)
            & (np.abs(np.ptp(vw, axis=1)) < 0.5 * speed)
            & (np.abs(aw).max(axis=1) < HASTIEST)
            & ~gap.any(axis=1)
        )
        direction = np.sign(vw.mean(axis=1))
        columns = (direction * fw.mean(axis=1), speed, direction, xw.mean(axis=1))
        at = np.flatnonzero(steady)
        block = 1000 * k + (at * step * h / 2.0).astype(np.int64)
        parts.append((*(c[steady] for c in columns), block, np.full(at.size, k)))
    return Motion(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def gusty(motion: Motion, base: Friction) -> bool:
    """Whether loads push the piston so often that no unloaded motion can be told."""
    forces = (motion.force, _without_load(motion, base).force)
    return min(float(np.mean(f < 0.0)) if f.size else 0.0 for f in forces) > MOST_PUSHED


def unloaded_motion(motion: Motion, base: Friction) -> tuple[Motion, tuple[float, float], list[str]] | None:
    """The motion, its unloaded force over the base's friction forward and reverse, and notes.

    None where the unloaded strokes cannot be told from loaded ones.
    """
    notes: list[str] = []
    for free in (motion, _without_load(motion, base)):
        ratio = free.ratio(base)
        forward, reverse = (_lowest_cluster(ratio[free.direction == sign]) for sign in (1.0, -1.0))
        if forward and reverse and 1.0 / ASYMMETRY < forward / reverse < ASYMMETRY:
            return free, (forward, reverse), notes
        notes = ["friction: no unloaded strokes; a constant and a spring load were fitted and removed"]
    return None


def near_curve(motion: Motion, sign: float, branch: FrictionBranch, centre: float) -> NDArray[np.bool_]:
    """Windows of one direction whose force is near `centre` times the base's curve: those without load."""
    near, expected = np.exp(CLUSTER_REACH), centre * curve(branch, motion.speed)
    inside = (motion.force < near * expected) & (motion.force > expected / near)
    return np.asarray((motion.direction == sign) & inside)


def _lowest_cluster(ratio: Array) -> float | None:
    """Centre of the lowest dense cluster of positive ratios."""
    if ratio.size * WINDOW < LEAST_SECONDS:
        return None
    logs = np.log(ratio[(ratio > 0.05) & (ratio < 20.0)])
    grid = np.arange(-3.2, 3.2, 0.03)
    counts = np.histogram(logs, bins=np.append(grid - 0.015, grid[-1] + 0.015))[0].astype(np.float64)
    kernel = np.exp(-0.5 * (np.arange(-0.48, 0.481, 0.03) / CLUSTER_WIDTH) ** 2)
    density = np.convolve(counts, kernel, mode="same")
    for peak in np.flatnonzero((density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])) + 1:
        share = np.count_nonzero(np.abs(logs - grid[peak]) < CLUSTER_REACH) / ratio.size
        if share >= LEAST_SHARE:
            return float(np.exp(grid[peak]))
    return None


def _with_loads(motion: Motion, friction: Array) -> Array:
    """Columns of the force balance: friction, a constant, a spring, and drag of the flow."""
    one, drag = np.ones_like(friction), motion.direction * motion.speed**2
    return np.column_stack([motion.direction * friction, one, motion.position, drag])


def _robust(m: Array, y: Array) -> Array:
    """(columns,) coefficients of a force balance (N), gusts counting less."""
    return huber(m, y, 2.0, least=1e-9, rcond=1e-8)[0]


def _without_load(motion: Motion, base: Friction) -> Motion:
    """Take each log's constant and spring load off, with the base's friction in proportion beside them."""
    over = motion.force / np.maximum(np.abs(motion.ratio(base)), 1e-9)
    m, signed = _with_loads(motion, np.abs(over)), motion.direction * motion.force
    force = motion.force.copy()
    for k in np.unique(motion.log):
        rows = motion.log == k
        if np.count_nonzero(rows) >= 20:
            load = m[rows][:, 1:] @ _robust(m[rows], signed[rows])[1:]
            force[rows] = motion.direction[rows] * (signed[rows] - load)
    return replace(motion, force=force)


def _through_gusts(
    motion: Motion, base: Friction, zero_force: float
) -> tuple[dict[str, BranchFit], list[str]]:
    """Both directions' base curves times one factor: what turns with the motion, each log's load apart."""
    force = motion.direction * motion.force
    m = _with_loads(motion, motion.expected(base))
    apart = [m[:, :1]] + [m[:, 1:] * (motion.log == k)[:, None] for k in np.unique(motion.log)]
    m = np.concatenate(apart, axis=1)
    factor = float(_robust(m, force)[0])
    groups = motion.block % (2 * _GROUPS)
    parts = np.array([_robust(m[groups != g], force[groups != g])[0] for g in np.unique(groups)])
    std = float(jackknife_std(parts))
    told = f"friction seen through gusts is {factor:.2g} ± {std:.1g} times the base's"
    if factor <= 0.0 or std > THROUGH_GUSTS * factor:
        return {}, [f"{told}: not sharp enough"]
    fits, relative = {}, max(std / factor, 0.15)
    for direction, branch in (("forward", base.forward), ("reverse", base.reverse)):
        estimates = {}
        for name in FOUND:
            value, shift = factor * float(getattr(branch, name)), 0.0 if name == "viscous" else zero_force
            estimates[name] = Estimate(value, float(np.hypot(relative * value, shift)))
        fits[direction] = BranchFit(estimates, f"the base's curve times {factor:.2g}, through gusts")
    return fits, [f"{told}: its curves were scaled"]


def _branch(
    motion: Motion, sign: float, base: FrictionBranch, centre: float, zero_force: float
) -> BranchFit | None:
    """One direction's curve: non-negative least squares over speed bins, drawn to the scaled base."""
    kept = near_curve(motion, sign, base, centre)
    speed, force, block = motion.speed[kept], motion.force[kept], motion.block[kept]
    if force.size * WINDOW < LEAST_SECONDS:
        return None
    bins = np.digitize(speed, _BINS)
    few = np.count_nonzero(np.bincount(bins) >= 5) < 3
    solve = _scaled if few else _shaped
    whole, own = solve(speed, force, base, centre)
    kept_each = [block % _GROUPS != g for g in np.unique(block % _GROUPS)]
    parts = [solve(speed[k], force[k], base, centre)[0] for k in kept_each if np.count_nonzero(k) > 5]
    jack = jackknife_std(np.array(parts)) if parts else np.zeros(3)
    shift = np.array([zero_force, zero_force, 0.0])
    total = np.sqrt(jack**2 + own**2 + shift**2 + (0.02 * whole) ** 2)
    estimates = {n: Estimate(float(x), float(s)) for n, x, s in zip(FOUND, whole, total, strict=True)}
    scaled = ", too few speeds: the base's curve scaled" if few else ""
    return BranchFit(estimates, f"{force.size * WINDOW:.1f} s of unloaded motion{scaled}")


def _scaled(speed: Array, force: Array, base: FrictionBranch, centre: float) -> tuple[Array, Array]:
    """(coulomb, static, viscous) as the base has them times one factor, and their standard deviations."""
    factor = float(np.median(force / curve(base, speed)))
    found = factor * np.array([base.coulomb, base.static, base.viscous])
    return found, 0.15 * found


def _shaped(speed: Array, force: Array, base: FrictionBranch, centre: float) -> tuple[Array, Array]:
    """(coulomb, static, viscous) with the base's Stribeck velocity and exponent, and their deviations."""
    which = np.digitize(speed, _BINS)
    counts = np.bincount(which)
    bins = np.flatnonzero(counts >= 3)
    v, target = (np.array([np.median(x[which == b]) for b in bins]) for x in (speed, force))
    shape = np.exp(-((v / base.stribeck_velocity) ** base.stribeck_exponent))
    rows = np.column_stack([np.ones(v.size), shape, v])
    sigma = 0.04 * centre * curve(base, v) * (1.0 + 10.0 / counts[bins])
    # The scaled base, weakly, so that what a few speeds cannot separate stays near it.
    drop = max(base.static - base.coulomb, 0.0)
    usual = centre * np.array([base.coulomb, drop, base.viscous])
    spread = np.array([0.4 * usual[0] + 1.0, 0.3 * usual[1] + 1.0, 0.5 * usual[2] + 2.0 * usual[0]])
    m = np.vstack([rows / sigma[:, None], np.diag(1.0 / spread)])
    found, _ = nnls(m * spread, np.concatenate([target / sigma, usual / spread]))
    coulomb, above, viscous = found * spread
    covariance = np.linalg.inv(m.T @ m)
    to_branch = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    own = np.sqrt(np.diag(to_branch @ covariance @ to_branch.T))
    return np.array([coulomb, coulomb + above, viscous]), own
