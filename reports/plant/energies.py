"""Energy of the plant, independent of its code: what is stored, what comes in, what each element takes away.

Oil with air in it is an elastic fluid: with the density's law ρ(p, T, free air) and its free enthalpy
g = ∫dp/ρ, counted from gauge zero, a kilogram holds f = g - p/ρ and carries g through a port. For any chamber
dF = Σ g dm - p dV + m(∂g/∂T dT + ∂g/∂a da), at constant pressure each: what warming does, and air that
comes out of solution, is work that heat supplies. A flow from one pressure to another loses g1 - g2.
Densities are relative to that of pure oil at gauge zero and the reference temperature, so a "mass" is a
volume in m³ and energies are in joule. The integrals are done by Gauss's quadrature, from the laws as
`fdd.plant.oil` says them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import legendre
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from fdd.plant import PERIOD
from fdd.plant import conditions as c
from fdd.plant import oil as o
from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import raw_blocks
from fdd.plant.steps import STAGES, advance
from fdd.unit import Oil, Unit

Array = NDArray[np.float64]
NODES = 24
"""Of the quadrature over pressure."""


def lobatto(n: int) -> tuple[Array, Array]:
    """Nodes on 0 to 1, both ends included, and their weights: exact up to degree 2n - 3."""
    inner = legendre.Legendre.basis(n - 1)
    nodes = np.concatenate([[-1.0], np.sort(inner.deriv().roots().real), [1.0]])
    weights = 2.0 / (n * (n - 1) * inner(nodes) ** 2)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@dataclass(frozen=True)
class FineRun:
    """What the plant went through in m milliseconds of k nodes, (m, k, …) as the right-hand side takes and
    gives it. `rows`: (m, axes, COLUMNS) conditions, at the present temperature. `weights`: (k,) s."""

    ready: Prepared
    states: Array
    slopes: Array
    found: Array
    rows: Array
    weights: Array

    def integral(self, power: Array) -> Array:
        """Running integral of (m, k) over time at the end of each millisecond, (m,)."""
        return np.cumsum(power @ self.weights)

    def at(self, state: int, axis: int = 0) -> Array:
        """One state of an axis, (m, k)."""
        return self.states[:, :, s.SHARED + axis * s.AXIS_STATES + state]

    def slope(self, state: int, axis: int = 0) -> Array:
        """Rate of one state of an axis, (m, k)."""
        return self.slopes[:, :, s.SHARED + axis * s.AXIS_STATES + state]

    def finding(self, which: int, axis: int = 0) -> Array:
        """One finding of an axis, (m, k)."""
        return self.found[:, :, axis * s.FINDINGS + which]


def fine_run(
    unit: Unit, scenario: Scenario, *, partner: Unit | None = None, nodes: int = 12, refine: float = 4.0
) -> FineRun:
    """Run the plant's own integrator from node to node, with the commands that `raw_blocks` gave to the whole
    run, a whole millisecond late as both drives are."""
    assert all(each.drive.delay == PERIOD for each in (unit, partner or unit))
    commands = next(iter(raw_blocks(prepare(unit, scenario, partner=partner, refine=refine)))).commands
    ready = prepare(unit, scenario, partner=partner, refine=refine)
    conditions = ready.conditions(0, scenario.rows)
    rows = np.empty_like(conditions[0])
    first, second = ready.parameters[0], ready.parameters[-1]
    points, weights = lobatto(nodes)
    y, found = ready.state.copy(), np.empty(len(ready.units) * s.FINDINGS)
    k, stage = np.empty((STAGES, y.size)), np.empty(y.size)
    states, slopes = np.empty((2, scenario.rows, nodes, y.size))
    findings = np.empty((scenario.rows, nodes, found.size))
    length = 1e-4
    for t in range(scenario.rows):
        before = commands[t - 1] if t else np.zeros(2)
        rows[t] = ready.row(y, t, conditions)
        for i in range(nodes):
            right_hand_side(y, before[0], before[1], rows[t], first, second, k[0], found)
            states[t, i], slopes[t, i], findings[t, i] = y, k[0], found
            if i + 1 < nodes:
                span = (points[i + 1] - points[i]) * PERIOD
                length, _ = advance(
                    y, span, length, ready.longest, before[0], before[1], rows[t], first, second,
                    1.0 / ready.allowed, k, stage, found,
                )  # fmt: skip
    return FineRun(ready, states, slopes, findings, rows, weights * PERIOD)


@dataclass(frozen=True)
class Fluid:
    """Oil (…), K `warm` above its reference temperature, with free air over oil, vapour over sound oil's."""

    oil: Oil
    warm: Array
    free: Array
    vapour: Array
    ambient: float

    def density(self, pressure: Array) -> Array:
        return np.asarray(np.exp(self._terms(pressure)[0]))

    def _terms(self, pressure: Array) -> tuple[Array, Array, Array]:
        """ln ρ, -∂lnρ/∂a and -∂lnρ/∂T at a gauge pressure."""
        absolute = pressure + self.ambient
        expansion = self.oil.thermal_expansion
        gas = (o.ATMOSPHERE / absolute) ** (1.0 / self.oil.polytropic_index)
        stiff = 1.0 / o.stiff_bulk_modulus(self.oil) + o.SOFTENING * self.warm
        q = np.maximum(1.0 + o.VAPOUR_SLOPE * self.warm, 0.1)
        ratio = o.VAPOUR_PRESSURE * self.vapour * q**3 / absolute
        beyond = np.maximum(ratio - o.VAPOUR_FELT, 0.0)
        warmer = 1.0 + o.AIR_WARMING * self.warm
        log = stiff * pressure - expansion * self.warm - self.free * gas * warmer - o.VAPOUR_SHARE * beyond**2
        swell = expansion - o.SOFTENING * pressure + self.free * gas * o.AIR_WARMING
        swell = swell + 2.0 * o.VAPOUR_SHARE * beyond * ratio * 3.0 * o.VAPOUR_SLOPE / q
        return log, gas * warmer, swell

    def integrals(self, pressure: Array) -> tuple[Array, Array, Array]:
        """g (J/m³), and what a unit of free air and a kelvin add to it at that pressure."""
        low = np.log(self.ambient)
        half = 0.5 * (np.log(pressure + self.ambient) - low)
        found = np.zeros((3, *np.shape(pressure)))
        for node, weight in zip(*leggauss(NODES), strict=True):
            absolute = np.exp(low + half * (1.0 + node))
            log, air, swell = self._terms(absolute - self.ambient)
            volume = weight * half * absolute * np.exp(-log)
            found += volume, volume * air, volume * swell
        return found[0], found[1], found[2]


@dataclass
class Energies:
    """Of a run, by name: energies `stored` (J), powers `supplied` and dissipated (W) at each node, (m, k)."""

    stored: dict[str, Array] = field(default_factory=dict)
    supplied: dict[str, Array] = field(default_factory=dict)
    lost: dict[str, Array] = field(default_factory=dict)

    def gap(self, run: FineRun) -> tuple[float, float]:
        """Largest departure of what is stored from what came and went, and all that came through (J).

        Each millisecond's balance begins after the loop has put air in place of oil and taken its density.
        """
        gained = sum(np.cumsum(energy[:, -1] - energy[:, 0]) for energy in self.stored.values())
        supplied = sum(run.integral(power) for power in self.supplied.values())
        lost = sum(run.integral(power) for power in self.lost.values())
        through = sum(run.integral(np.abs(power))[-1] for power in self.supplied.values())
        return float(np.abs(gained - supplied + lost).max()), float(through)


def energies(run: FineRun) -> Energies:
    """Everything that holds, brings and takes energy in a run."""
    par = run.ready.parameters[0]
    out = Energies()
    x, v, drop = (run.states[:, :, i] for i in (s.X, s.V, s.DROP))
    row = run.rows[:, 0][:, None, :]
    beyond = np.maximum(np.abs(x) - par.half_stroke, 0.0)
    out.stored["rod"] = 0.5 * par.mass * v**2
    reach = x - par.spring_centre
    reach = np.sign(reach) * np.maximum(np.abs(reach) - par.spring_play, 0.0)
    if par.one_sided:
        reach = np.maximum(reach, 0.0)
    out.stored["load's spring"] = 0.5 * par.spring * reach**2
    out.stored["stops"] = 0.5 * par.stop_stiffness * beyond**2
    stiff = np.sign(x) * par.stop_stiffness * beyond
    out.lost["stops and cushions"] = (run.finding(s.STOP_FORCE) - stiff) * v
    out.supplied["external force"] = -row[:, :, c.FORCE] * v
    if par.partner_area > 0.0:
        # Its throttle: Δp = R·Q|Q|, laminar below the transition.
        width = par.orifice_transition
        through = drop / np.sqrt(par.throttle * np.sqrt(drop**2 + width**2))
        out.stored["lumped partner"] = 0.5 * par.partner_compliance * drop**2
        out.lost["lumped partner's throttle"] = drop * through
    first, *second = (_axis(run, axis, out) for axis in range(len(run.ready.units)))
    for lines in second:
        for line, flow in enumerate((s.CONNECT_FLOW_1, s.CONNECT_FLOW_2)):
            out.lost[f"connect valve {line + 1}"] = run.finding(flow) * (lines[line] - first[line])
    return out


def _axis(run: FineRun, axis: int, out: Energies) -> tuple[Array, Array]:
    """An axis's energies; returns g of its two lines (J/m³)."""
    par, oil = run.ready.parameters[axis], run.ready.units[axis].oil
    row = run.rows[:, axis][:, None, :]
    x, v = run.states[:, :, s.X], run.states[:, :, s.V]
    name = f"axis {axis + 1} "
    at = lambda state: run.at(state, axis)  # noqa: E731
    find = lambda which: run.finding(which, axis)  # noqa: E731
    warm = at(s.TEMPERATURE) - oil.reference_temperature
    p1, p2, a, b = at(s.P1), at(s.P2), at(s.LINE_1), at(s.LINE_2)
    speed, pa = at(s.SPEED), find(s.ACCUMULATOR)

    # Stored in chambers and lines, and what warming and air out of solution bring.
    volume_1, volume_2 = par.volume_1, par.volume_2
    if par.blocked:
        volume_1, volume_2 = par.cylinder_volume_1, par.cylinder_volume_2
    chambers = [(p1, volume_1 + par.area_1 * x, s.FREE_1), (p2, volume_2 - par.area_2 * x, s.FREE_2)]
    if par.blocked:
        chambers += [(a, par.line_volume_1 + 0.0 * x, s.FREE_1), (b, par.line_volume_2 + 0.0 * x, s.FREE_2)]
    oil_energy, swelling, g_of = np.zeros_like(x), np.zeros_like(x), []
    for p, volume, free in chambers:
        fluid = Fluid(oil, warm, at(free), row[:, :, c.VAPOUR] + 0.0 * warm, par.ambient)
        g, by_air, by_heat = fluid.integrals(p)
        rho = fluid.density(p)
        g_of.append((g, rho))
        oil_energy += volume * (rho * g - p)
        warming = by_heat * run.slope(s.TEMPERATURE, axis)
        swelling += volume * rho * (by_air * run.slope(free, axis) + warming)
    out.stored[name + "oil"] = oil_energy
    out.supplied[name + "swelling"] = swelling
    (g_1, rho_1), (g_2, rho_2), (g_a, rho_a), (g_b, rho_b) = *g_of[:2], *g_of[-2:]
    out.stored[name + "shaft"] = 0.5 * par.inertia * speed**2
    out.stored[name + "bristles"] = 0.5 * par.bristle_stiffness * at(s.Z) ** 2
    out.stored[name + "seal's film"] = 0.5 * par.seal_damping / par.friction_rate * at(s.MEMORY) ** 2
    rho_store = run.rows[:, 0 if par.shares else axis, c.STORE_DENSITY][:, None]
    h_store = pa / rho_store
    if not par.shares:
        _accumulator(run, axis, out, name)
    if par.external_flow > 0.0:
        total = 0.0 * x
        grown = np.exp(par.expansion * warm)
        for i, g in ((s.EXTERNAL_1, g_1), (s.EXTERNAL_2, g_2)):
            held = at(i) * grown
            left = 1.0 - held / par.external_volume
            total = total - par.external_pressure * par.external_volume * np.log(left) - par.ambient * held
            gas = par.external_pressure / left - par.ambient
            out.lost[name + f"external accumulator {i}"] = run.slope(i, axis) * (g - gas * grown)
            warming = par.expansion * run.slope(s.TEMPERATURE, axis)
            out.supplied[name + f"external swelling {i}"] = gas * held * warming
        out.stored[name + "external accumulators"] = total

    # Supplied.
    torque = find(s.MOTOR_TORQUE)
    out.supplied[name + "motor"] = torque * speed
    charging = row[:, :, c.CHARGE] * np.clip((par.charging_pressure - pa) / 20e3, 0.0, 1.0)
    out.supplied[name + "charging"] = charging * row[:, :, c.STORE_DENSITY] * h_store

    # Lost: friction.
    wave = (par.ripple + row[:, :, c.RIPPLE]) * np.cos(par.teeth * (at(s.ANGLE) - at(s.GAP)))
    swing = 1.0 + row[:, :, c.ECCENTRICITY] * np.cos(at(s.ANGLE))
    displacement = par.displacement * row[:, :, c.DISPLACEMENT] * (1.0 + wave) * swing
    dry = par.rotary_coulomb + par.pump_friction * np.abs(displacement * find(s.PORT_DIFFERENCE))
    turning = (par.rotary_viscous + par.pump_drag * row[:, :, c.DRAG]) * speed
    turning = turning + dry * speed / np.sqrt(1.0 + speed**2)
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
    mean = 0.5 * (rho_a + rho_b)
    mass = flow * mean - par.pump_compression * np.abs(flow) * 0.5 * (rho_a - rho_b)
    suction = np.where(flow > 0.0, b_port, a_port) + par.ambient
    mass = mass * np.clip(suction / 20e3, 0.0, 1.0)
    taken = (torque - turning - par.inertia * run.slope(s.SPEED, axis)) * speed
    half = 0.5 * row[:, :, c.PLAY]
    gap = at(s.GAP)
    excess = np.maximum(gap - half, 0.0) + np.minimum(gap + half, 0.0)
    out.stored[name + "coupling"] = 0.5 * par.coupling_stiffness * excess**2
    in_coupling = par.coupling_stiffness * excess * run.slope(s.GAP, axis)
    out.lost[name + "pump, its lines and coupling"] = taken - in_coupling - mass * (g_a - g_b)

    # Lost: leakages and valves.
    across = mean * (find(s.CROSS_FLOW) + find(s.RELIEF_FLOW) + find(s.STUCK_RELIEF_FLOW))
    out.lost[name + "ports"] = across * (g_a - g_b)
    out.lost[name + "cylinder's seal and by-pass"] = 0.5 * (rho_1 + rho_2) * find(s.BYPASS_FLOW) * (g_1 - g_2)
    case = find(s.CASE_PRESSURE)
    leak_a = mean * row[:, :, c.CASE_LEAKAGE_1] * (a_port - case)
    leak_b = mean * row[:, :, c.CASE_LEAKAGE_2] * (b_port - case)
    outside_1, outside_2 = (
        rho * _outside(np.maximum(p, 0.0), row, k, par.orifice_transition)
        for k, rho, p in ((0, rho_1, p1), (1, rho_2, p2))
    )
    # What drips past the shaft is what the chambers' own leaks leave of all that is lost.
    dripping = leak_a + leak_b - (find(s.DRAIN_FLOW) - (find(s.OUTSIDE_FLOW) - outside_1 - outside_2))
    out.lost[name + "case drain"] = leak_a * g_a + leak_b * g_b - (leak_a + leak_b - dripping) * h_store
    refeed_a, refeed_b = find(s.REFEED_FLOW_1), find(s.REFEED_FLOW_2)
    out.lost[name + "refeeding"] = refeed_a * (h_store - g_a) + refeed_b * (h_store - g_b)
    out.lost[name + "outside"] = outside_1 * g_1 + outside_2 * g_2
    return g_a, g_b


def _outside(pressure: Array, row: Array, side: int, transition: float) -> Array:
    """A side's leak to the outside: laminar, by an opening that grows with pressure, by an orifice."""
    width = transition * row[:, :, c.TRANSITION]
    laminar = (row[:, :, c.OUTSIDE_1 + side] + row[:, :, c.OUTSIDE_OPENING_1 + side] * pressure) * pressure
    orifice = row[:, :, c.OUTSIDE_ORIFICE_1 + side] * 1e-3 * pressure / (pressure**2 + width**2) ** 0.25
    return np.asarray(laminar + orifice)


def _accumulator(run: FineRun, axis: int, out: Energies, name: str) -> None:
    """Gas as an ideal diatomic one, oil taken as incompressible, the stops' own springs."""
    par = run.ready.parameters[axis]
    row = run.rows[:, axis][:, None, :]
    held, heat = run.at(s.STORE, axis) / row[:, :, c.STORE_DENSITY], run.at(s.GAS, axis)
    rest = par.gas_pressure * par.gas_volume
    lacks, beyond = np.minimum(held, 0.0), np.maximum(held - par.full, 0.0)
    # At its stops the gas keeps its volume, and what goes in or out works against its present pressure.
    empty = rest / par.shell_volume * par.gallery_gas * -np.log1p(-lacks / par.gallery_gas)
    full = rest / (par.shell_volume - par.full) * beyond
    out.stored[name + "accumulator"] = (
        rest / 0.4 * heat - par.ambient * held + heat * (empty + full) + 0.5 * par.full_stiffness * beyond**2
    )
    out.supplied[name + "gas at its stops"] = (empty + full) * run.slope(s.GAS, axis)
    warmer = run.at(s.TEMPERATURE, axis) - par.surroundings
    shell = 1.0 + par.gas_warming * warmer
    out.supplied[name + "shell's heat"] = rest / 0.4 * par.gas_rate * (shell - heat)
