"""Friction curves of the cylinder, per direction, from the force balance in motion.

``A1·p1 - A2·p2 - M·a = F(v) + load``, with ``F(v) = C + (S - C)·exp(-(v/v_s)^δ) + B·v`` (thesis eq.
5.12, 5.3). The load of a healthy log is unknown and may be throttled strokes, a spring or a weight, so
the unloaded motion is found first: over the base's curve, its force makes the lowest dense cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fdd.identification.least_squares import huber, jackknife_std
from fdd.identification.record import Record
from fdd.unit import Cylinder, Friction, FrictionBranch

Array = NDArray[np.float64]

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
_BINS = np.geomspace(SLOWEST, 1.0, 22)
_GROUPS = 8


@dataclass(frozen=True)
class BranchFit:
    """Friction of one direction.

    `stds` holds the standard deviation of each number found; what it lacks is the base's.
    """

    branch: FrictionBranch
    stds: dict[str, float]
    note: str


@dataclass(frozen=True)
class FrictionFit:
    """Friction per direction, None where the base's is kept."""

    forward: BranchFit | None
    reverse: BranchFit | None
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Motion:
    """Windows of steady motion: force along the motion, speed, direction, where, and in which 2 s block.

    Break-aways are left out: the pump starts too fast for the peak to be the static friction.
    """

    force: Array
    speed: Array
    direction: Array
    position: Array
    block: NDArray[np.int64]


def curve(branch: FrictionBranch, speed: Array) -> Array:
    """Steady friction (N) at `speed` ≥ 0 (m/s), same shape."""
    stribeck = np.exp(-((speed / branch.stribeck_velocity) ** branch.stribeck_exponent))
    return np.asarray(branch.coulomb + (branch.static - branch.coulomb) * stribeck + branch.viscous * speed)


def fit_friction(
    records: list[Record], cylinder: Cylinder, base: Friction, zero_force: float = 0.0
) -> FrictionFit:
    """Identify both directions' curves.

    Parameters
    ----------
    records : the logs. cylinder : areas (as identified) and moving mass.
    base : its curves give the shape where the data do not.
    zero_force : N, standard deviation of the force that the pressure sensors' zeros feign; it shifts
        both directions' friction, in opposite senses.

    Returns
    -------
    Curves with standard deviations, and why something was kept.
    """
    motions = [steady_motion(r, cylinder, 1000 * i) for i, r in enumerate(records)]
    if gusty(motions, base):
        return _through_gusts(motions, base, zero_force)
    free = unloaded_motion(motions, base)
    if free is None:
        return FrictionFit(None, None)
    motion, found, notes = free
    forward = _branch(motion, 1.0, base.forward, found[0], zero_force)
    return FrictionFit(forward, _branch(motion, -1.0, base.reverse, found[1], zero_force), notes)


def gusty(motions: list[Motion], base: Friction) -> bool:
    """Whether loads push the piston so often that no unloaded motion can be told."""
    forces = [_join(motions).force, _join([_without_load(m, base) for m in motions]).force]
    return min(float(np.mean(f < 0.0)) if f.size else 0.0 for f in forces) > MOST_PUSHED


def unloaded_motion(
    motions: list[Motion], base: Friction
) -> tuple[Motion, tuple[float, float], list[str]] | None:
    """All logs' motion, its unloaded force over the base's friction forward and reverse, and notes.

    None where the unloaded strokes cannot be told from loaded ones.
    """
    notes: list[str] = []
    found = _unloaded(motions, base)
    if found is None:
        motions = [_without_load(m, base) for m in motions]
        found = _unloaded(motions, base)
        notes.append("friction: no unloaded strokes; a constant and a spring load were fitted and removed")
    return None if found is None else (_join(motions), found, notes)


def near_curve(motion: Motion, sign: float, branch: FrictionBranch, centre: float) -> NDArray[np.bool_]:
    """Windows of one direction whose force is near `centre` times the base's curve: those without load."""
    near, expected = np.exp(CLUSTER_REACH), centre * curve(branch, motion.speed)
    inside = (motion.force < near * expected) & (motion.force > expected / near)
    return np.asarray((motion.direction == sign) & inside)


def steady_motion(record: Record, cylinder: Cylinder, first_block: int) -> Motion:
    """The windows of one log; its blocks are counted from `first_block`."""
    step, h = record.rows(WINDOW), record.period
    v, _ = record.speeds(0.02)
    v = record.smooth(v, 0.02)
    a = np.gradient(record.smooth(v, 0.02), h)
    force = cylinder.area_1 * record.pressure_1 - cylinder.area_2 * record.pressure_2
    force = record.smooth(force - cylinder.moving_mass * a, 0.02)
    n = len(record) // step * step
    shape = (-1, step)
    vw, aw, fw = (c[:n].reshape(shape) for c in (v, a, force))
    speed = np.abs(vw.mean(axis=1))
    steady = (
        (np.abs(vw).min(axis=1) > 0.5 * SLOWEST)
        & (speed > SLOWEST)
        & (np.abs(np.ptp(vw, axis=1)) < 0.5 * speed)
        & (np.abs(aw).max(axis=1) < HASTIEST)
        & ~record.gap[:n].reshape(shape).any(axis=1)
    )
    direction = np.sign(vw.mean(axis=1))
    return Motion(
        force=(direction * fw.mean(axis=1))[steady],
        speed=speed[steady],
        direction=direction[steady],
        position=record.position[:n].reshape(shape).mean(axis=1)[steady],
        block=first_block + (np.flatnonzero(steady) * step * h / 2.0).astype(np.int64),
    )


def _join(motions: list[Motion]) -> Motion:
    names = list(Motion.__dataclass_fields__)
    return Motion(**{n: np.concatenate([getattr(m, n) for m in motions]) for n in names})


def _expected(motion: Motion, base: Friction) -> Array:
    """(n,) friction (N) of either direction's curve."""
    forward, reverse = (curve(branch, motion.speed) for branch in (base.forward, base.reverse))
    return np.where(motion.direction > 0, forward, reverse)


def _ratio(motion: Motion, base: Friction) -> Array:
    return motion.force / np.maximum(_expected(motion, base), 1.0)


def _unloaded(motions: list[Motion], base: Friction) -> tuple[float, float] | None:
    """Force over the base's friction in unloaded motion, forward and reverse."""
    motion = _join(motions)
    ratio = _ratio(motion, base)
    centres = []
    for sign in (1.0, -1.0):
        centre = _lowest_cluster(ratio[motion.direction == sign])
        if centre is None:
            return None
        centres.append(centre)
    change = centres[0] / centres[1]
    return None if not 1.0 / ASYMMETRY < change < ASYMMETRY else (centres[0], centres[1])


def _lowest_cluster(ratio: Array) -> float | None:
    """Centre of the lowest dense cluster of positive ratios."""
    if ratio.size * WINDOW < LEAST_SECONDS:
        return None
    logs = np.log(ratio[(ratio > 0.05) & (ratio < 20.0)])
    if logs.size == 0:
        return None
    grid = np.arange(-3.2, 3.2, 0.03)
    counts = np.histogram(logs, bins=np.append(grid - 0.015, grid[-1] + 0.015))[0].astype(np.float64)
    kernel = np.exp(-0.5 * (np.arange(-0.48, 0.481, 0.03) / CLUSTER_WIDTH) ** 2)
    density = np.convolve(counts, kernel, mode="same")
    peaks = np.flatnonzero((density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:])) + 1
    for peak in peaks:
        share = np.count_nonzero(np.abs(logs - grid[peak]) < CLUSTER_REACH) / ratio.size
        if share >= LEAST_SHARE:
            return float(np.exp(grid[peak]))
    return None


def _without_load(motion: Motion, base: Friction) -> Motion:
    """Take a constant and a spring load off, with the base's friction in proportion beside them."""
    if motion.force.size < 20:
        return motion
    over = motion.force / np.maximum(np.abs(_ratio(motion, base)), 1e-9)
    signed = motion.direction * motion.force
    m = _with_loads(motion, np.abs(over))
    load = m[:, 1:] @ _robust(m, signed)[1:]
    return replace(motion, force=motion.direction * (signed - load))


def _with_loads(motion: Motion, friction: Array) -> Array:
    """Columns of the force balance: friction, a constant, a spring, and drag of the flow."""
    one, drag = np.ones_like(friction), motion.direction * motion.speed**2
    return np.column_stack([motion.direction * friction, one, motion.position, drag])


def _robust(m: Array, y: Array) -> Array:
    """(columns,) coefficients of a force balance (N), gusts counting less."""
    return huber(m, y, 2.0, least=1e-9, rcond=1e-8)[0]


def _through_gusts(motions: list[Motion], base: Friction, zero_force: float) -> FrictionFit:
    """Both directions' base curves times one factor: what turns with the motion, each log's load apart."""
    joined = _join(motions)
    force = joined.direction * joined.force
    m = _with_loads(joined, _expected(joined, base))
    log = np.repeat(np.arange(len(motions)), [part.force.size for part in motions])
    apart = [m[:, :1]] + [m[:, 1:] * (log == k)[:, None] for k in np.unique(log)]
    m = np.concatenate(apart, axis=1)
    factor = float(_robust(m, force)[0])
    groups = joined.block % (2 * _GROUPS)
    parts = np.array([_robust(m[groups != g], force[groups != g])[0] for g in np.unique(groups)])
    std = float(jackknife_std(parts))
    told = f"friction seen through gusts is {factor:.2g} ± {std:.1g} times the base's"
    if factor <= 0.0 or std > THROUGH_GUSTS * factor:
        return FrictionFit(None, None, [f"{told}: not sharp enough"])
    fits = []
    for branch in (base.forward, base.reverse):
        scaled = branch.model_copy(deep=True)
        stds = {}
        for name in ("coulomb", "static", "viscous"):
            value = factor * float(getattr(branch, name))
            setattr(scaled, name, value)
            shift = 0.0 if name == "viscous" else zero_force
            stds[name] = float(np.hypot(max(std / factor, 0.15) * value, shift))
        fits.append(BranchFit(scaled, stds, f"the base's curve times {factor:.2g}, through gusts"))
    return FrictionFit(fits[0], fits[1], [f"{told}: its curves were scaled"])


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
    parts = []
    for g in np.unique(block % _GROUPS):
        keep = block % _GROUPS != g
        if np.count_nonzero(keep) > 5:
            parts.append(solve(speed[keep], force[keep], base, centre)[0])
    jack = jackknife_std(np.array(parts)) if parts else np.zeros(3)
    shift = np.array([zero_force, zero_force, 0.0])
    total = np.sqrt(jack**2 + own**2 + shift**2 + (0.02 * whole) ** 2)
    stds = {n: float(s) for n, s in zip(("coulomb", "static", "viscous"), total, strict=True)}
    branch = base.model_copy(deep=True)
    branch.coulomb, branch.static, branch.viscous = (float(x) for x in whole)
    note = f"{force.size * WINDOW:.1f} s of unloaded motion"
    if few:
        note += ", too few speeds: the base's curve scaled"
    return BranchFit(branch, stds, note)


def _scaled(speed: Array, force: Array, base: FrictionBranch, centre: float) -> tuple[Array, Array]:
    """(coulomb, static, viscous) as the base has them times one factor, and their standard deviations."""
    factor = float(np.median(force / curve(base, speed)))
    found = factor * np.array([base.coulomb, base.static, base.viscous])
    return found, 0.15 * found


def _shaped(speed: Array, force: Array, base: FrictionBranch, centre: float) -> tuple[Array, Array]:
    """(coulomb, static, viscous) with the base's Stribeck velocity and exponent, and their deviations."""
    bins = np.digitize(speed, _BINS)
    rows, target, sigma = [], [], []

    def shape(v: float) -> list[float]:
        return [1.0, float(np.exp(-((v / base.stribeck_velocity) ** base.stribeck_exponent))), v]

    for b in np.unique(bins):
        inside = bins == b
        count = int(np.count_nonzero(inside))
        if count < 3:
            continue
        v = float(np.median(speed[inside]))
        rows.append(shape(v))
        target.append(float(np.median(force[inside])))
        sigma.append(0.04 * centre * float(curve(base, np.array([v]))[0]) * (1.0 + 10.0 / count))
    # The scaled base, weakly, so that what a few speeds cannot separate stays near it.
    drop = max(base.static - base.coulomb, 0.0)
    usual = centre * np.array([base.coulomb, drop, base.viscous])
    spread = np.array([0.4 * usual[0] + 1.0, 0.3 * usual[1] + 1.0, 0.5 * usual[2] + 2.0 * usual[0]])
    m = np.vstack([np.array(rows) / np.array(sigma)[:, None], np.diag(1.0 / spread)])
    y = np.concatenate([np.array(target) / np.array(sigma), usual / spread])
    found, _ = nnls(m * spread, y)
    coulomb, above, viscous = found * spread
    covariance = np.linalg.inv(m.T @ m)
    to_branch = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    own = np.sqrt(np.diag(to_branch @ covariance @ to_branch.T))
    return np.array([coulomb, coulomb + above, viscous]), own
