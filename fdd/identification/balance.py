"""Pump gain, leakage and bulk modulus: the fit of the volume balances, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fdd.identification import Array, Estimate, jackknife_std
from fdd.identification.volume_steps import LogBalances, Term, VolumeSteps, scales
from fdd.residuals.oil import air_compliance, modulus_at
from fdd.tolerances import TOLERANCES, tolerance
from fdd.unit import Unit

LEAST_AIR = 2e-4
MOST_AIR = 0.15
HUBER = 4.0
"""Robust standard deviations from which a residual counts less: wide, for reversals are what tells."""
GROUPS = 12
"""Of the jackknife; 2 s blocks are dealt out to them in turn."""
OVERLAP = 6.0
"""Rows per independent one: three lengths of step, each overlapping its neighbour by half."""
LEAST_ROWS = 60
LEAST_RESIDUAL = 1e-10
"""m³, a tenth of a cubic millimetre: no encoder is better."""
AREA_TOLERANCE = 0.015
AREA_SURE = 3.0
"""Relative change of the area ratio that is believed, and in standard deviations."""
ZERO, USUAL_RANGE = 1e-3, 1.5
"""Standard deviation of a pressure transducer's zero over its range: catalogues allow 0.25 %. Range over the
relief setting where the profile has none."""
WARMING = 1.0 / 60.0
"""K/s by which oil warms at work where nobody measures it: a kelvin a minute."""
INLETS = (-0.5, 2.5)
"""κ from 0 to 1 with oil that is twice as stiff or half as stiff as the base's, about."""
SLIP = 1e-3
"""Of the pump's flow, that goes with the pressures unmodelled: in a log without load, whose pressures follow
the motion, it passes for leakage. A transducer's gain over 10 K moves by as much."""
ROUNDS = 8
"""Of iteratively reweighted least squares."""


@dataclass(frozen=True)
class BalanceFit:
    """What the volume balances say, SI: with the base's area_1, leakage at the reference temperature, bulk
    modulus at the reference pressure."""

    displacement: Estimate
    area_2: Estimate | None
    """None where the base's fits."""
    cross_port: Estimate
    case: Estimate
    total_leakage: Estimate
    bulk_modulus: Estimate
    air_fraction: Estimate
    theta: Array
    """(9,) the solution, in units of `fdd.identification.volume_steps.scales`."""
    compliances: Array
    """(GROUPS, 2) 1/β and α of the jackknife, each without a group of blocks."""
    split_known: bool
    """Whether cross-port and case leakage are told apart, rather than split as the base does."""
    air_known: bool
    """Whether α rests on the log rather than on the base."""
    rows: int
    signal_over_noise: float
    """Of the compression term against pressure noise."""


def fit_balance(
    logs: LogBalances, steps: VolumeSteps, unit: Unit, *, split: bool, hidden: bool
) -> BalanceFit | None:
    """Fit the balances; None where there are too few steps.

    Bounded least squares with a Huber loss, the base with its tolerances as prior, and the known
    noise of the pressures taken out of the normal equations, without which it would bias 1/β to zero.
    Standard deviations are jackknifed over time, without the bounds, at which a solution would not move; what
    the prior leaves open is added.

    `steps` are the rows of all logs, `unit` is the base. Where no log can `split` cross-port from case
    leakage they keep the base's proportion. Pressures that are `hidden` are reconstructed: they tell nothing
    of how compliance changes with pressure, and air stays the base's.
    """
    if steps.y.size < LEAST_ROWS:
        return None
    problem = _Problem(logs, steps, unit, split=split, warmed=logs.temperature is not None, hidden=hidden)
    solution = problem.solve(free_area=True)
    spread = problem.jackknife(solution, free_area=True)
    both = all(np.count_nonzero(steps.chamber == c) > LEAST_ROWS // 2 for c in (1, 2))
    shift, sure = abs(solution.theta[Term.AREA_2]), float(jackknife_std(spread[:, Term.AREA_2]))
    free_area = both and shift > AREA_TOLERANCE and shift > AREA_SURE * sure
    return problem.report(solution if free_area else problem.solve(free_area=False), free_area)


def fit_theta(logs: LogBalances, steps: VolumeSteps, unit: Unit) -> tuple[Array, float]:
    """The bare solution with free areas, (9,) in units of `scales`, and its robust residual (m³)."""
    found = _Problem(logs, steps, unit).solve(free_area=True)
    return found.theta, found.sigma


@dataclass(frozen=True)
class _Solution:
    theta: Array
    weights: Array
    sigma: float


class _Problem:
    """The regression with its noise, prior and bounds; `warmed`: whether the oil's swelling is known."""

    def __init__(
        self, logs: LogBalances, steps: VolumeSteps, unit: Unit, *, split: bool = True, warmed: bool = True,
        hidden: bool = False,
    ) -> None:  # fmt: skip
        # Tied, case leakage is this many times the cross-port one and no unknown of its own.
        cross_port = unit.pump.cross_port_leakage
        self.tied = None if split or cross_port == 0.0 else unit.pump.case_leakage / cross_port
        if self.tied is not None:
            m = steps.m.copy()
            m[:, Term.CROSS] += self.tied * m[:, Term.CASE]
            steps = replace(steps, m=m)
        self.steps, self.unit, self.reference_pressure = steps, unit, logs.pressure
        per_row = np.where(steps.chamber == 1, *logs.noise)
        self.noise = steps.noise * per_row[:, None, None]
        scale, oil, pump = scales(unit), unit.oil, unit.pump
        air, known = max(oil.air_fraction, LEAST_AIR), tolerance(unit, "pump.leakage")
        compliance = oil.bulk_modulus / modulus_at(oil, logs.pressure)
        free = oil.bulk_modulus * air * float(air_compliance(logs.pressure, oil.polytropic_index))
        # What the base's bulk modulus is off by moves the ports' density as κ does.
        inlet = float(np.hypot(TOLERANCES["pump.inlet"][0], 1.5 * tolerance(unit, "oil.bulk_modulus")))
        # A chamber's steady loss (m³/s): leakage at a pressure's zero, and oil that swells unmeasured.
        swelling = 0.0 if warmed else WARMING * oil.thermal_expansion * unit.cylinder.volume_1
        steady = float(np.hypot(zero_std(unit) * pump.total_leakage, swelling))
        drift = steady / scale[Term.DRIFT_1]
        self.prior = np.array([
            1.0, 0.0, pump.cross_port_leakage / scale[Term.CROSS], pump.case_leakage / scale[Term.CASE], 0.5,
            0.0, 0.0, max(compliance - 1.5 * free, 0.0), air / scale[Term.AIR],
        ])  # fmt: skip
        self.prior_spread = np.array([
            tolerance(unit, "pump.displacement"), 0.3, max(known * self.prior[Term.CROSS], 0.05),
            max(known * self.prior[Term.CASE], 0.05), inlet, drift, drift,
            tolerance(unit, "oil.bulk_modulus") * compliance,
            0.01 * air / scale[Term.AIR] if hidden else max(air / scale[Term.AIR], 0.5),
        ])  # fmt: skip
        self.low = np.array(
            [-np.inf, -np.inf, 0.0, 0.0, INLETS[0], *[-np.inf] * 2, 0.0, LEAST_AIR / scale[Term.AIR]]
        )
        self.high = np.array([*[np.inf] * 4, INLETS[1], *[np.inf] * 3, MOST_AIR / scale[Term.AIR]])

    def about(self, theta: Array) -> tuple[Array, Array, Array]:
        """Regressors, their noise and target, linear about `theta`, all in the base's volume of travel.

        Chamber 2 is ``A2 Δx = m·θ / (1 + a)``, a the relative change of area 2. As ``A2 Δx (1 + a) = m·θ`` it
        would be linear, and have a solution without any residual: no area and no displacement.
        """
        m, a = self.steps.m.copy(), float(theta[Term.AREA_2])
        second = self.steps.chamber == 2
        m[:, Term.AREA_2] = 0.0
        m[second] /= 1.0 + a
        m[second, Term.AREA_2] = -(m[second] @ theta) / (1.0 + a)
        noise = np.where(second, 1.0 / (1.0 + a), 1.0)[:, None, None] * self.noise
        noise[:, :, Term.AREA_2] = 0.0
        return m, noise, self.steps.y + m[:, Term.AREA_2] * a

    def normal(
        self, theta: Array, weights: Array, rows: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array, Array]:
        """Information of the rows, that of the pressure noise in them, and the right-hand side."""
        take = slice(None) if rows is None else rows
        m, noise, y = (part[take] for part in self.about(theta))
        w, n = weights[take], noise.reshape(-1, len(Term))
        return (m.T * w) @ m, (n.T * np.repeat(w, 2)) @ n, m.T @ (w * y)

    def minimise(
        self, information: Array, noise: Array, right: Array, sigma: float, free_area: bool,
        prior: Array | None = None,
    ) -> Array:  # fmt: skip
        """(9,) solution within bounds; one without them about another `prior`."""
        free = np.ones(len(Term), dtype=bool)
        free[Term.AREA_2] = free_area
        free[Term.CASE] = self.tied is None
        pull = OVERLAP * sigma**2 / self.prior_spread**2
        full = information + np.diag(pull)
        scale = np.sqrt(np.diag(full))
        scaled = (full / np.outer(scale, scale))[np.ix_(free, free)]
        taken = (noise / np.outer(scale, scale))[np.ix_(free, free)]
        share, floor = 1.0, 1e-3 * float(np.linalg.eigvalsh(scaled)[0])
        while share > 1e-3 and float(np.linalg.eigvalsh(scaled - share * taken)[0]) < floor:
            share *= 0.7  # more noise assumed than there is in these rows: take less of it out
        root = np.linalg.cholesky(scaled - (share if share > 1e-3 else 0.0) * taken).T
        about = self.prior if prior is None else prior
        side = np.linalg.solve(root.T, ((right + pull * about) / scale)[free])
        if prior is None:
            bounds = self.low[free] * scale[free], self.high[free] * scale[free]
            found = lsq_linear(root, side, bounds=bounds, method="bvls", tol=1e-12).x
        else:
            found = np.linalg.solve(root, side)
        theta = np.zeros(len(Term))
        theta[free] = found / scale[free]
        return theta

    def solve(self, *, free_area: bool) -> _Solution:
        weights = np.ones(self.steps.y.size)
        sigma = float(np.std(self.steps.y)) * 0.05 + LEAST_RESIDUAL
        theta = np.zeros(len(Term))
        for k in range(ROUNDS):
            theta = self.minimise(*self.normal(theta, weights), sigma, free_area and k > 0)
            m, _, y = self.about(theta)
            residual = y - m @ theta
            sigma = 1.4826 * float(np.median(np.abs(residual))) + LEAST_RESIDUAL
            weights = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(residual), 1e-18))
        return _Solution(theta, weights, sigma)

    def jackknife(self, solution: _Solution, free_area: bool, prior: Array | None = None) -> Array:
        """(groups, 9) solutions, each without one group of blocks; `prior` as for `minimise`."""
        group = self.steps.block % GROUPS
        parts = [self.normal(solution.theta, solution.weights, group == g) for g in range(GROUPS)]
        total = [np.sum([p[i] for p in parts], axis=0) for i in range(3)]
        left = [[t - p for t, p in zip(total, part, strict=True)] for part in parts]
        return np.array(
            [self.minimise(m, n, right, solution.sigma, free_area, prior) for m, n, right in left]
        )

    def report(self, solution: _Solution, free_area: bool) -> BalanceFit:
        value = self.derive(solution.theta)
        others = np.array([self.derive(t) for t in self.jackknife(solution, free_area, self.prior)])
        # Without bounds: about the prior, and with each of its numbers a deviation off.
        total = self.normal(solution.theta, solution.weights)
        priors = self.prior + np.vstack([np.zeros(len(Term)), np.diag(self.prior_spread)])
        solved = [self.minimise(*total, solution.sigma, free_area, p) for p in priors]
        about, *shifted = np.array([self.derive(t) for t in solved])
        std = np.sqrt(jackknife_std(others) ** 2 + np.sum((np.array(shifted) - about) ** 2, axis=0))
        if self.tied is not None:
            # One chamber at the case's pressure sees cross-port + case leakage, whatever they share.
            moved = 0.5 * value[2] * value[3] / max(value[2] + value[3], 1e-30)
            std[4] = np.hypot(std[4], TOLERANCES["pump.case_share"][0] * moved)
        told = np.diag(total[0])
        flows = float(np.sqrt(told[Term.DISPLACEMENT] / max(told[Term.CROSS], 1e-300)))
        std[[2, 4]] = np.hypot(std[[2, 4]], SLIP * flows * scales(self.unit)[Term.CROSS])
        displacement, area_2, cross_port, case, total_leakage, compliance, air = (
            Estimate(float(v), float(s)).wider(f) for v, s, f in zip(value, std, _FLOORS, strict=True)
        )
        beta = 1.0 / max(compliance.value, 1e-14)
        bounded = np.array([self.derive(t) for t in self.jackknife(solution, free_area)])
        # Of the rows alone, the area's change kept at zero.
        free = [k for k in Term if k != Term.AREA_2]
        inside = total[0][np.ix_(free, free)] / (OVERLAP * max(solution.sigma, 1e-15) ** 2)
        scale = np.sqrt(np.maximum(np.diag(inside), 1e-300))
        inverse = np.linalg.pinv(inside / np.outer(scale, scale), rcond=1e-12)
        spread_of = np.full(len(Term), np.inf)
        spread_of[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / scale
        compression = self.steps.m[:, Term.STIFF]
        level = float(np.sqrt(np.mean(np.sum(self.noise[:, :, Term.STIFF] ** 2, axis=1)))) + 1e-300
        theta = solution.theta.copy()
        if self.tied is not None:
            theta[Term.CASE] = self.tied * theta[Term.CROSS]
        known = spread_of < 0.5 * self.prior_spread
        return BalanceFit(
            displacement, area_2 if free_area else None, cross_port, case, total_leakage,
            bulk_modulus=Estimate(beta, compliance.std * beta**2), air_fraction=air, theta=theta,
            compliances=bounded[:, 5:7], split_known=self.tied is None and bool(known[Term.CASE]),
            air_known=bool(known[Term.AIR]), rows=int(self.steps.y.size),
            signal_over_noise=float(np.std(compression)) / level,
        )  # fmt: skip

    def derive(self, theta: Array) -> tuple[float, ...]:
        """Physical numbers of a solution, compressibility as compliance (1/Pa)."""
        d, area, cross, case, _, _, _, excess, air = theta * scales(self.unit)
        case = case if self.tied is None else self.tied * cross
        c = float(air_compliance(self.reference_pressure, self.unit.oil.polytropic_index))
        compliance = excess + 1.5 * air * c
        area_2 = self.unit.cylinder.area_2 + area
        return d, area_2, cross, case, cross + 0.5 * case, compliance, air


def zero_std(unit: Unit) -> float:
    """Standard deviation of a pressure's zero (Pa)."""
    reach = unit.sensor("pressure_1").high
    return ZERO * (USUAL_RANGE * unit.accumulator.relief_pressure if reach is None else reach)


_FLOORS = (0.002, 3e-4, 0.05, 0.05, 0.05, 0.06, 0.05)
"""Relative standard deviations that no amount of data beats: 0.01 to 0.03 % of a transducer's gain a kelvin;
1 to 2 K between gap and sensor at 4 % a kelvin; air that dissolves stiffens by 2 to 8 %."""
