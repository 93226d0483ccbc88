"""Energy of the plant, independent of its code: what is stored, what comes in, what each element takes away.

Oil is an elastic fluid: with the density's law ρ(p) and the enthalpy h = ∫dp/ρ, both counted from gauge zero,
a kilogram holds u = h - p/ρ = -∫p d(1/ρ), and carries h through a port. Then for any chamber
dU = Σ h dm - p dV, and a flow from one pressure to another loses h1 - h2. Densities are relative to that at
atmospheric pressure, so a "mass" is a volume in m³ and energies are in joule. The integrals are done by
Gauss's quadrature of the thesis's 1/β (eqs 5.20 and 5.21), not by the plant's closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from fine_runs import FineRun
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.oil import ATMOSPHERE, bulk_modulus, stiff_bulk_modulus
from fdd.unit import Oil

Array = NDArray[np.float64]


class Fluid:
    """Density, enthalpy and internal energy of oil with free air, over gauge pressure."""

    def __init__(self, oil: Oil, air: float, ambient: float) -> None:
        # Where the air is counted the density is 1; a grid that is dense where the pressure is low.
        low = -0.995 * ambient
        grid = low + np.geomspace(1.0, 3e7, 6001) - 1.0
        x, w = leggauss(6)

        def cumulative(f) -> Array:  # type: ignore[no-untyped-def]
            half = 0.5 * np.diff(grid)[:, None]
            points = 0.5 * (grid[1:] + grid[:-1])[:, None] + half * x
            return np.concatenate([[0.0], np.cumsum((f(points) * w * half).sum(axis=1))])

        log_density = CubicSpline(grid, cumulative(lambda p: 1.0 / bulk_modulus(oil, p, air, ambient)))
        # Where density is 1: the air's at atmospheric pressure, the oil's own at gauge zero.
        at_air = ATMOSPHERE - ambient
        shift = float(log_density(at_air)) - at_air / stiff_bulk_modulus(oil)
        enthalpy = CubicSpline(grid, cumulative(lambda p: np.exp(shift - log_density(p))))
        zero = float(enthalpy(0.0))
        self._log_density, self._shift = log_density, shift
        self._enthalpy, self._zero = enthalpy, zero

    def density(self, pressure: Array) -> Array:
        return np.asarray(np.exp(self._log_density(pressure) - self._shift))

    def enthalpy(self, pressure: Array) -> Array:
        return np.asarray(self._enthalpy(pressure) - self._zero)

    def inner(self, pressure: Array) -> Array:
        return np.asarray(self.enthalpy(pressure) - pressure / self.density(pressure))


@dataclass
class Energies:
    """Of a run: energies (J) at the start of each millisecond, powers (W) at each node.

    Attributes
    ----------
    stored, lost, supplied : name to (m, k); `lost` are powers that only dissipate.
    """

    stored: dict[str, Array] = field(default_factory=dict)
    supplied: dict[str, Array] = field(default_factory=dict)
    lost: dict[str, Array] = field(default_factory=dict)


def energies(run: FineRun) -> Energies:
    """Everything that holds, brings and takes energy in a run whose air fraction is constant."""
    par = run.ready.parameters[0]
    out = Energies()
    x, v, drop = (run.states[:, :, i] for i in (s.X, s.V, s.DROP))
    row = run.rows[:, 0][:, None, :]
    beyond = np.abs(x) - par.half_stroke
    beyond = np.maximum(beyond, 0.0)
    out.stored["rod"] = 0.5 * par.mass * v**2
    out.stored["load's spring"] = 0.5 * par.spring * (x - par.spring_centre) ** 2
    out.stored["stops"] = 0.5 * par.stop_stiffness * beyond**2
    out.lost["stops and cushions"] = (
        run.finding(s.STOP_FORCE) - np.sign(x) * par.stop_stiffness * beyond
    ) * v
    out.supplied["external force"] = -row[:, :, c.FORCE] * v
    if par.partner_area > 0.0:
        # Its throttle: Δp = R·Q|Q|, laminar below the transition.
        width = par.orifice_transition
        through = drop / np.sqrt(par.throttle * np.sqrt(drop**2 + width**2))
        out.stored["lumped partner"] = 0.5 * par.partner_compliance * drop**2
        out.lost["lumped partner's throttle"] = drop * through
    for axis in range(run.ready.axes):
        _axis(run, axis, out)
    if run.ready.axes > 1 and (row[:, :, c.CONNECT_1].any() or row[:, :, c.CONNECT_2].any()):
        fluids = [_fluid(run, axis) for axis in range(2)]
        for name, flow, line in (
            ("connect valve 1", s.CONNECT_FLOW_1, s.LINE_1),
            ("connect valve 2", s.CONNECT_FLOW_2, s.LINE_2),
        ):
            difference = fluids[1].enthalpy(run.at(line, 1)) - fluids[0].enthalpy(run.at(line, 0))
            out.lost[name] = run.finding(flow) * difference
    return out


def _fluid(run: FineRun, axis: int) -> Fluid:
    air = run.rows[:, axis, c.AIR]
    assert np.ptp(air) == 0.0
    return Fluid(run.ready.units[axis].oil, float(air[0]), run.ready.parameters[axis].ambient)


def _axis(run: FineRun, axis: int, out: Energies) -> None:
    par, oil = run.ready.parameters[axis], _fluid(run, axis)
    row = run.rows[:, axis][:, None, :]
    x, v = run.states[:, :, s.X], run.states[:, :, s.V]
    name = f"axis {axis + 1} "
    at = lambda state: run.at(state, axis)  # noqa: E731
    find = lambda which: run.finding(which, axis)  # noqa: E731
    h, rho, u = oil.enthalpy, oil.density, oil.inner
    p1, p2, a, b = at(s.P1), at(s.P2), at(s.LINE_1), at(s.LINE_2)
    speed, pa = at(s.SPEED), find(s.ACCUMULATOR)

    # Stored.
    chambers = [(p1, par.volume_1 + par.area_1 * x), (p2, par.volume_2 - par.area_2 * x)]
    if par.blocked:
        chambers = [
            (p1, par.cylinder_volume_1 + par.area_1 * x),
            (p2, par.cylinder_volume_2 - par.area_2 * x),
            (a, par.line_volume_1 + 0.0 * x),
            (b, par.line_volume_2 + 0.0 * x),
        ]
    out.stored[name + "oil"] = sum(rho(p) * volume * u(p) for p, volume in chambers)
    out.stored[name + "shaft"] = 0.5 * par.inertia * speed**2
    out.stored[name + "bristles"] = 0.5 * par.bristle_stiffness * at(s.Z) ** 2
    out.stored[name + "seal's film"] = 0.5 * par.seal_damping / par.friction_rate * at(s.MEMORY) ** 2
    # Oil in the accumulator is taken as incompressible, at the density it has at charge pressure.
    charge = par.gas_pressure - par.ambient
    held = at(s.STORE) / par.store_density
    gas = -par.gas_pressure * par.gas_volume * np.log1p(-held / par.gas_volume) - par.ambient * held
    rest = float(u(charge))
    out.stored[name + "accumulator"] = gas + at(s.STORE) * rest
    h_store = pa / par.store_density + rest
    if par.external_flow > 0.0:
        total = 0.0 * x
        for i, p in ((s.EXTERNAL_1, p1), (s.EXTERNAL_2, p2)):
            oil_held = at(i)
            left = 1.0 - oil_held / par.external_volume
            total = (
                total - par.external_pressure * par.external_volume * np.log(left) - par.ambient * oil_held
            )
            gas_pressure = par.external_pressure / left - par.ambient
            flow = _orifice(p - gas_pressure, par.external_flow, par.orifice_transition)
            flow = np.where(flow < 0.0, flow * np.clip(oil_held / 1e-8, 0.0, 1.0), flow)
            out.lost[name + f"external accumulator {i}"] = flow * (h(p) - gas_pressure)
        out.stored[name + "external accumulators"] = total

    # Supplied.
    torque = find(s.MOTOR_TORQUE)
    out.supplied[name + "motor"] = torque * speed
    charging = row[:, :, c.CHARGE] * np.clip((par.charging_pressure - pa) / 20e3, 0.0, 1.0)
    out.supplied[name + "charging"] = par.store_density * charging * h_store

    # Lost: friction.
    turning = par.rotary_viscous * speed + par.rotary_coulomb * speed / np.sqrt(1.0 + speed**2)
    out.lost[name + "rotary friction"] = turning * speed
    out.lost[name + "seal friction"] = (
        find(s.FRICTION_FORCE) * v
        - par.bristle_stiffness * at(s.Z) * run.slope(s.Z, axis)
        - par.seal_damping / par.friction_rate * at(s.MEMORY) * run.slope(s.MEMORY, axis)
    )

    # Lost: pump and coupling. Torque over the shaft less what the oil gains, line losses included.
    flow = find(s.PUMP_FLOW)
    line_loss = par.line_loss * flow * np.abs(flow)
    a_port, b_port = a + line_loss, b - line_loss
    rho_a, rho_b = rho(a), rho(b)
    mean = 0.5 * (rho_a + rho_b)
    inlet = np.where(flow > 0.0, rho_b, rho_a)
    mass = flow * (mean + par.pump_compression * (inlet - mean))
    suction = np.where(flow > 0.0, b_port, a_port) + par.ambient
    mass = mass * np.clip(suction / 20e3, 0.0, 1.0)
    taken = (torque - turning - par.inertia * run.slope(s.SPEED, axis)) * speed
    gap = at(s.GAP)
    half = 0.5 * row[:, :, c.PLAY]
    excess = np.maximum(gap - half, 0.0) + np.minimum(gap + half, 0.0)
    out.stored[name + "coupling"] = 0.5 * par.coupling_stiffness * excess**2
    slip = run.slope(s.GAP, axis)
    in_coupling = par.coupling_stiffness * excess * slip
    out.lost[name + "pump, its lines and coupling"] = taken - in_coupling - mass * (h(a) - h(b))

    # Lost: leakages and valves.
    across = mean * (find(s.CROSS_FLOW) + find(s.RELIEF_FLOW) + find(s.STUCK_RELIEF_FLOW))
    out.lost[name + "ports"] = across * (h(a) - h(b))
    out.lost[name + "cylinder's seal and by-pass"] = (
        0.5 * (rho(p1) + rho(p2)) * find(s.BYPASS_FLOW) * (h(p1) - h(p2))
    )
    case, leak = find(s.CASE_PRESSURE), row[:, :, c.CASE_LEAKAGE]
    leak_a, leak_b = mean * leak * (a_port - case), mean * leak * (b_port - case)
    dripping = mean * row[:, :, c.SHAFT_LEAKAGE] * np.maximum(case, 0.0)
    out.lost[name + "case drain"] = leak_a * h(a) + leak_b * h(b) - (leak_a + leak_b - dripping) * h_store
    refeed_a, refeed_b = find(s.REFEED_FLOW_1), find(s.REFEED_FLOW_2)
    out.lost[name + "refeeding"] = refeed_a * (h_store - h(a)) + refeed_b * (h_store - h(b))
    outside_1 = rho(p1) * row[:, :, c.OUTSIDE_1] * np.maximum(p1, 0.0)
    outside_2 = rho(p2) * row[:, :, c.OUTSIDE_2] * np.maximum(p2, 0.0)
    out.lost[name + "outside"] = outside_1 * h(p1) + outside_2 * h(p2)


def _orifice(drop: Array, flow_at_1_mpa: float, transition: float) -> Array:
    return np.asarray(flow_at_1_mpa * 1e-3 * drop / (drop**2 + transition**2) ** 0.25)
