"""From healthy logs to this unit's own profile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.errors import InputError
from fdd.identification import Array, Estimate, Identification, jackknife_std
from fdd.identification.balance import zero_std
from fdd.identification.friction import fit_friction
from fdd.identification.hydraulics import hydraulics
from fdd.identification.record import Record, even_record, fit_sensors, redundancy_offset
from fdd.identification.signs import check_gain, check_pressure_signs, check_pump
from fdd.samples import Samples
from fdd.tolerances import tolerance
from fdd.unit import Unit

LEAST_REST = 0.5
"""s of standstill that a charge pressure needs."""
WINDOW = 0.1
"""s over which currents and pressures are averaged."""
LEAST_WINDOWS = 60
SLOW = 400.0
"""rad/s²: above it the rotor's inertia would hide the load torque."""
LEAST_RANGE = 0.3
"""N·m of load torque that must be covered."""
WELL_DETERMINED = 0.03
GEAR_FRICTION = (0.05, 0.03)
"""Torque by which the load rubs in gears and bearings, over D·Δp, with its standard deviation: catalogues
give gear pumps 85 to 95 % of their torque, about half of the loss being this (McCandlish and Dorey)."""
GAINS = 0.005
"""Of the sensors of current and pressures, relative: catalogues allow 0.5 % each."""
BLOCK = 20
"""Windows, 2 s: residuals nearer than that are one."""
_GROUPS = 10


def identify_unit(
    logs: Sequence[Samples], base: Unit, name: str | None = None, labels: Sequence[str] | None = None
) -> Identification:
    """Identify a unit's own numbers from healthy logs.

    Volume balances of the chambers give pump gain, leakage and bulk modulus (thesis 5.1, 5.2, 5.4; see
    `fdd.identification.volume_steps`), the force balance gives friction (thesis 5.3), standstill and
    redundancy give sensors and charge pressure. What the logs do not tell stays as in `base`, the profile of
    a similar unit, and a note says why; its area_1 is taken as true, and its volumes where strokes are too
    short to tell them (see `fdd.identification.hydraulics`).

    Each of the healthy `logs` of one unit has at least 5 s, position, pump_angle or pump_speed, and
    pressure_difference or both chamber pressures; errors call them by their `labels`.

    Raises InputError: no log, a channel missing, too short, nothing moves, or a gain so far from the base's
        that units of measure or the base must be wrong.
    """
    if not logs:
        raise InputError("no healthy log given", mend="give at least one")
    if labels is None:
        labels = ["healthy log" if len(logs) == 1 else f"healthy log {i + 1}" for i in range(len(logs))]
    records = [even_record(log, base, label) for log, label in zip(logs, labels, strict=True)]
    for log, record, label in zip(logs, records, labels, strict=True):
        check_gain(record, base, label)
        check_pump(log, label)
    check_pressure_signs(records, base, labels)
    unit = base.model_copy(deep=True)
    unit.baseline = unit.origin = None
    unit.name = name if name is not None else f"{base.name[:53]}_identified"
    source = f"identified from {len(logs)} healthy log(s)"
    seconds = sum(len(r) * r.period for r in records)
    unit.description = f"{source}, {seconds:.0f} s in all; based on {base.name}."
    out = Identification(unit, base, source)
    if jumps := sum(r.angle_jumps for r in records):
        out.notes.append(f"the pump angle makes {jumps} impossible jumps: these moments were left out")
    hydraulics(out, records)
    _charge(out, records)
    _friction(out, records)
    for channel, fit in fit_sensors(list(logs), records).items():
        out.put_sensor(channel, fit)
    constant, why = fit_torque_constant(records, unit.pump.displacement)
    if constant is None:
        out.keep("drive.torque_constant", why)
    else:
        out.put("drive.torque_constant", constant, why)
    return out


def _charge(out: Identification, records: list[Record]) -> None:
    path, known = "accumulator.charge_pressure", []
    for r in records:
        if r.accumulator_measured:
            known.append((r, r.accumulator))
        elif r.chambers_measured:
            known.append((r, np.minimum(r.smooth(r.pressure_1, 0.1), r.smooth(r.pressure_2, 0.1))))
    if not known:
        out.keep(path, "neither accumulator nor chamber pressures are measured")
        return
    resting, note = np.concatenate([p[r.at_rest(out.base)] for r, p in known]), "median at rest"
    if resting.size * known[0][0].period < LEAST_REST:
        resting, note = np.concatenate([p for _, p in known]), "median of the logs, which never rest"
    value = float(np.median(resting))
    if value <= 0.0:
        out.keep(path, f"{value / 1e5:.2f} bar at rest is no charge")
        return
    # Half the middle half's width: temperature and oil in the chambers move it more than noise does.
    spread = float(np.diff(np.quantile(resting, [0.25, 0.75]))[0]) / 1.35
    out.put(path, Estimate(value, max(spread, 0.005 * value)), note)


def _friction(out: Identification, records: list[Record]) -> None:
    cylinder = out.unit.cylinder
    shift = max(zero_std(out.base), abs(redundancy_offset(records))) * cylinder.area_1
    if not all(r.chambers_measured for r in records):  # their mean hangs on the charge
        rod = abs(cylinder.area_1 - cylinder.area_2)
        charge = tolerance(out.base, "accumulator.charge_pressure") * out.base.accumulator.charge_pressure
        shift = float(np.hypot(shift, rod * charge))
    trials = out.unit.friction.trial_spread / np.sqrt(len(records))
    fits, notes = fit_friction(records, cylinder, out.base.friction, shift)
    out.notes += notes
    for direction in ("forward", "reverse"):
        if direction not in fits:
            out.keep(f"friction.{direction}.coulomb", "no unloaded motion could be told from loads")
            continue
        for name, found in fits[direction].estimates.items():
            out.put(f"friction.{direction}.{name}", found.wider(trials), fits[direction].note)


def fit_torque_constant(records: list[Record], displacement: float) -> tuple[Estimate | None, str]:
    """The torque constant (N·m/A) and a note, or None with the reason; `displacement` in m³/rad.

    Current is regressed on D·Δp, |D·Δp| and 1 with the sign of the speed, speed and its rate. K_t is one over
    the first slope; the second over the first is friction that grows with load, and where load and motion
    always go together it is known by `GEAR_FRICTION` alone.
    """
    parts = [_windows(r, displacement) for r in records if r.current is not None]
    if not parts:
        return None, "motor current is not measured"
    m, y = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if y.size < LEAST_WINDOWS:
        return None, "too little slow motion"
    if np.ptp(m[:, 0]) < LEAST_RANGE:
        return None, f"load torque covers {np.ptp(m[:, 0]):.2f} N·m only"
    usual, doubt = GEAR_FRICTION
    slope = _slope(m, y, usual)
    group = np.arange(y.size) // BLOCK % _GROUPS
    left_out = np.array([_slope(m[group != g], y[group != g], usual) for g in range(_GROUPS)])
    std = float(jackknife_std(left_out))
    if slope <= 0.0 or std > WELL_DETERMINED * slope:
        return None, f"slope of current over load torque {slope:.3g} ± {std:.2g} A/(N·m) is not sharp enough"
    gears = _slope(m, y, usual + doubt) - slope
    relative = float(np.sqrt(std**2 + gears**2 + (GAINS * slope) ** 2)) / slope
    return Estimate(1.0 / slope, relative / slope), "friction that grows with load taken off"


def _windows(record: Record, displacement: float) -> tuple[Array, Array]:
    assert record.current is not None
    step = record.rows(WINDOW)
    n = len(record) // step * step
    _, w = record.speeds(0.02)
    rate = np.gradient(record.smooth(w, 0.02), record.period)
    drop = record.pressure_1 - record.pressure_2 if record.chambers_measured else record.difference

    def mean(values: Array) -> Array:
        return np.asarray(values[:n].reshape(-1, step).mean(axis=1), dtype=np.float64)

    speed, acceleration = mean(w), mean(rate)
    slow = (np.abs(rate[:n]).reshape(-1, step).max(axis=1) < SLOW) & (np.abs(speed) > 2.0)
    slow &= ~record.gap[:n].reshape(-1, step).any(axis=1)
    load, turning = mean(displacement * drop), np.sign(speed)
    m = np.column_stack(
        [load, np.abs(load) * turning, turning, speed * 1e-2, acceleration * 1e-2, np.ones_like(speed)]
    )
    return m[slow], mean(record.current)[slow]


def _slope(m: Array, y: Array, friction: float) -> float:
    """First coefficient; the second over it is `friction`, as sure as `GEAR_FRICTION` says."""
    weights: Array = np.ones(y.size)
    theta: Array = np.zeros(m.shape[1])
    prior = np.zeros(m.shape[1])
    for _ in range(6):
        rows, wanted = np.vstack([m * weights[:, None], prior]), np.append(y * weights, 0.0)
        theta = np.asarray(np.linalg.lstsq(rows, wanted, rcond=1e-10)[0])
        residual = y - m @ theta
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        weights = np.sqrt(np.minimum(1.0, 2.0 * sigma / np.maximum(np.abs(residual), 1e-12)))
        sure = np.sqrt(BLOCK) * sigma / max(GEAR_FRICTION[1] * abs(float(theta[0])), 1e-12)
        prior[:2] = -friction * sure, sure
    return float(theta[0])
