"""From healthy logs to this unit's own profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdd.errors import InputError
from fdd.identification import Estimate, Identification
from fdd.identification.balance import LEAST_ROWS, BalanceFit, fit_balance, zero_std
from fdd.identification.friction import fit_friction
from fdd.identification.record import Record, even_record
from fdd.identification.sensors import fit_sensors, fit_torque_constant, gain_mismatch, redundancy_offset
from fdd.identification.signs import MOST_GAIN_CHANGE, check_gain, check_pressure_signs, check_pump
from fdd.identification.volume_steps import SMOOTHING, LogBalances, VolumeSteps, keeps_trapped_oil
from fdd.identification.volumes import VolumeFit, fit_volumes
from fdd.samples import Samples
from fdd.sections import Provenance
from fdd.tolerances import tolerance
from fdd.unit import Unit

LEAST_REST = 0.5
"""s of standstill that a charge pressure needs."""
RELIEF_EXCEEDED, RELIEF_CLEARANCE, RELIEF_IMPOSSIBLE = 1.15, 1.2, 30.0
"""Times the base's relief setting: it cannot be this unit's; times the pressure reached: where it is put;
times the setting again: no valve of any such actuator, from 1 to 35 MPa, holds that."""
LEAKAGE_SHARP, BULK_SHARP = 0.25, 0.25
"""Relative standard deviation up to which an estimate replaces the base's number."""
GAIN_SHARP = 0.5
"""Of what the base leaves open: up to there the logs tell the travel per rad better than the base."""
LEAST_SIGNAL = 1.5
"""Of pressure changes over noise, from which compression is believed."""
LEAST_LEAKAGE = 5e-3
"""Of the base's leakage; less than that is the fit's bound, not a pump's."""
SURPRISING = 4.0
"""Factor from the base that a note is worth."""
HIDDEN_LEAKAGE, HIDDEN_CASE = 0.03, 0.25
"""Relative standard deviations to add where the chambers' pressures are reconstructed."""
HIDDEN_BULK = (0.10, 0.22, 0.35)
"""The same of bulk modulus: beside a measured accumulator; without one, when what lifts the chambers is
guessed; for a rod on one side, whose piloted valves nobody knows either. On simulated units."""


def identify_unit(
    logs: Sequence[Samples], base: Unit, name: str | None = None, labels: Sequence[str] | None = None
) -> Identification:
    """Identify a unit's own numbers from healthy logs.

    Volume balances of the chambers give pump gain, leakage and bulk modulus (thesis 5.1, 5.2, 5.4; see
    `fdd.identification.volume_steps`), the force balance gives friction (thesis 5.3), standstill and
    redundancy give sensors and charge pressure. What the logs do not tell stays as in `base`,
    and a note says why.

    Parameters
    ----------
    logs : one or more healthy logs of the same unit, at least 5 s each, with position, pump_angle or
        pump_speed, and pressure_difference or both chamber pressures.
    base : profile of a similar unit; its area_1 is taken as true, and its volumes where strokes are too
        short to tell them (see `fdd.identification.volumes`).
    name : of the new profile; by default the base's with ``_identified``.
    labels : what errors call the logs, one each.

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
    mismatch = gain_mismatch(records)
    if mismatch is not None and abs(mismatch) > 5e-3:
        out.notes.append(
            f"pressure_difference reads {100 * mismatch:+.1f} % of the chambers' difference off in gain; "
            "its zero makes them agree on average"
        )
    constant, why = fit_torque_constant(records, unit.pump.displacement)
    if constant is None:
        out.keep("drive.torque_constant", why)
    else:
        out.put("drive.torque_constant", constant, why)
    return out


@dataclass(frozen=True)
class Hydraulics:
    """The balances' fit, its rows, and the base that they are counted with, as the logs changed it.

    `bulk_modulus` and `air_fraction` are the fit's with what volumes and reconstructed pressures leave open;
    `volumes_found` is False where the volumes stay the base's, whose own uncertainty is not in them.
    """

    logs: LogBalances
    base: Unit
    steps: VolumeSteps
    fit: BalanceFit
    bulk_modulus: Estimate
    air_fraction: Estimate
    volumes_found: bool


def hydraulics(
    out: Identification, records: list[Record], pressure: float | None = None
) -> Hydraulics | None:
    """Put displacement, leakage, volumes and compressibility into a profile; None for too few steps.

    Compressibility is referred to `pressure` (Pa), by default the logs' usual one.

    Raises InputError: a gain or pressures that cannot be this unit's.
    """
    base = _with_relief(out, records)
    logs = LogBalances(records, pressure)
    if not base.cylinder.needs_pilots and any(keeps_trapped_oil(r, base, logs.noise) for r in records):
        base = base.model_copy(deep=True)
        base.accumulator.refeed_pilots = False
        why = "the lower chamber keeps its oil under a higher one"
        out.decide("accumulator.refeed_pilots", False, why)
    hidden = not all(r.chambers_measured for r in records)
    volumes = None
    if not hidden:  # a reconstructed pressure tells as much of its own model as of the volumes
        base, volumes = _with_volumes(out, logs, base)
    steps = logs.steps(base)
    # Who measures two of the four pressures sees one loss, p1 - p2 or p1 - p_case: they hardly differ.
    told = all(r.accumulator_measured for r in records)
    fit = fit_balance(logs, steps, base, split=told and not hidden, hidden=hidden)
    if fit is None:
        why = "too few steps in which a chamber stays above the accumulator while it moves"
        _keep_gain(out, why)
        for path in ("pump.cross_port_leakage", "oil.bulk_modulus"):
            out.keep(path, why)
        return None
    _put_gain(out, fit)
    _put_leakage(out, fit, logs.temperature, hidden)
    blurred = HIDDEN_BULK[0 if told else 2 if base.cylinder.needs_pilots else 1] if hidden else 0.0
    of_volume = volumes.gain.relative if volumes is not None and volumes.of_volume else 0.0
    # The balance knows volume over bulk modulus: what the volume is uncertain by, this is too.
    found = Hydraulics(
        logs, base, steps, fit,
        fit.bulk_modulus.wider(float(np.hypot(blurred, of_volume))),
        fit.air_fraction.wider(float(np.hypot(0.5 if hidden else 0.0, of_volume))),
        volumes_found=of_volume > 0.0,
    )  # fmt: skip
    _put_compressibility(out, found)
    if hidden:
        out.notes.append(
            "chamber pressures are not measured: they were reconstructed from their difference and the "
            "refeeding valves, which leaves bulk modulus and air uncertain by 10 % and more"
        )
    return found


def _with_relief(out: Identification, records: list[Record]) -> Unit:
    """The base, its relief valve set above what healthy logs reach."""
    reached = max(
        float(np.quantile(np.abs(r.smooth(r.pressure_1 - r.pressure_2, SMOOTHING)), 0.995)) for r in records
    )
    setting = out.base.accumulator.relief_pressure
    if reached < RELIEF_EXCEEDED * setting:
        return out.base
    if reached > RELIEF_IMPOSSIBLE * setting:
        valve = f"the relief valve of base {out.base.name} opens at {setting / 1e5:.3g} bar"
        problem = f"pressure differences reach {reached / 1e5:.3g} bar, {valve}"
        raise InputError(problem, mend="check the pressures' unit in the channel map")
    value = RELIEF_CLEARANCE * reached
    why = f"healthy pressure differences reach {reached / 1e5:.1f} bar: opens above that"
    out.put("accumulator.relief_pressure", Estimate(value, 0.2 * value), why)
    out.notes.append(
        f"the logs reach {reached / 1e5:.1f} bar, beyond the base's relief setting of "
        f"{setting / 1e5:.1f} bar: it was raised"
    )
    base = out.base.model_copy(deep=True)
    base.accumulator.relief_pressure = value
    return base


def _with_volumes(out: Identification, logs: LogBalances, base: Unit) -> tuple[Unit, VolumeFit | None]:
    """The base with the chambers' volumes, where strokes tell them; both pressures are measured."""
    steps = logs.steps(base)
    if steps.y.size < LEAST_ROWS or len(np.unique(steps.chamber)) < 2:
        return base, None
    fit = fit_volumes(logs, base)
    if fit is None:
        out.notes.append(
            "the chambers' volumes stay the base's: compliance against position does not tell them"
        )
        return base, None
    base = fit.applied(base)
    cylinder, gain = base.cylinder, fit.gain
    share = float(np.hypot(gain.relative if fit.of_volume else 0.0, fit.split.std))
    for name in ("volume_1", "volume_2"):
        value = float(getattr(cylinder, name))
        out.put(f"cylinder.{name}", Estimate(value, share * value), "from compliance against position")
    if not fit.of_volume:
        compliance = Estimate(cylinder.position_compliance, gain.relative * cylinder.position_compliance)
        why = "no dead volume explains this: the mean volume stays the base's"
        out.put("cylinder.position_compliance", compliance, why)
    return base, fit


def _put_gain(out: Identification, fit: BalanceFit) -> None:
    ratio = fit.displacement.value / out.base.pump.displacement
    if not 1.0 / MOST_GAIN_CHANGE < ratio < MOST_GAIN_CHANGE:
        problem = f"the volume balances give {ratio:.3g} times the displacement of base {out.base.name}"
        mend = "check units and signs in the channel map, or give a fitting base profile"
        raise InputError(problem, mend=mend)
    sharp = GAIN_SHARP * tolerance(out.base, "pump.displacement")
    if not _better(out, fit.displacement, out.base.pump.displacement, sharp):
        _keep_gain(out, f"the logs give it to {100 * fit.displacement.relative:.0f} % only, as the base")
        return
    out.put("pump.displacement", fit.displacement, "displacement over area_1, which stays the base's")
    out.notes.append("only displacement over area is identifiable from flow: area_1 stays the base's")
    if fit.area_2 is not None:
        ratio = fit.area_2.value / out.base.cylinder.area_1
        note = f"area_2/area_1 = {ratio:.3f} from both chambers' balances"
        out.put("cylinder.area_2", fit.area_2, note)
        out.notes.append(note)


def _keep_gain(out: Identification, why: str) -> None:
    """Leave the base's displacement, and state how far it may be off: balances are held against it."""
    pump = out.unit.pump
    out.keep("pump.displacement", why)
    std = tolerance(out.base, "pump.displacement") * pump.displacement
    known = pump.provenance.get("displacement", Provenance())
    pump.provenance["displacement"] = known.model_copy(update={"std": std})


def _put_leakage(out: Identification, fit: BalanceFit, temperature: float | None, hidden: bool) -> None:
    extra, extra_of_case = (HIDDEN_LEAKAGE, HIDDEN_CASE) if hidden else (0.0, 0.0)
    total = fit.total_leakage.wider(extra)
    known = out.base.pump.total_leakage
    enough = total.value > LEAST_LEAKAGE * known
    if not (enough and _better(out, total, known, LEAKAGE_SHARP, "leakage")):
        why = f"total leakage {total.value:.2g} ± {total.std:.2g} m³/(s·Pa): load the actuator to find it"
        out.keep("pump.cross_port_leakage", why)
        out.keep("pump.case_leakage", why)
        return
    out.leakage = total
    note = f"total (cross-port + case/2) {total.value:.3g} ± {total.std:.1g}"
    out.put("pump.cross_port_leakage", fit.cross_port.wider(extra), note)
    split = "" if fit.split_known else "split from cross-port as in the base"
    out.put("pump.case_leakage", fit.case.wider(extra_of_case), split)
    if not fit.split_known:
        out.notes.append("cross-port and case leakage could not be told apart: they are split as in the base")
    if temperature is not None:
        out.put("oil.reference_temperature", Estimate(temperature, 0.5), "mean of the logs")
    else:
        out.notes.append("oil temperature is not measured: leakage holds for the logs' own temperature")


def _put_compressibility(out: Identification, found: Hydraulics) -> None:
    fit, beta, pressure = found.fit, found.bulk_modulus, found.logs.pressure
    seen, known = fit.signal_over_noise >= LEAST_SIGNAL, out.base.oil.bulk_modulus
    if not (seen and _better(out, beta, known, BULK_SHARP, "bulk modulus")):
        told = f"{beta.value / 1e6:.0f} ± {beta.std / 1e6:.0f} MPa is not sharp enough"
        out.keep("oil.bulk_modulus", f"{told} (pressure changes over noise {fit.signal_over_noise:.1f})")
        return
    level = "with the volumes found" if found.volumes_found else "volumes stay the base's"
    out.put("oil.bulk_modulus", beta, f"at {pressure / 1e5:.2f} bar; {level}")
    out.put("oil.reference_pressure", Estimate(pressure, 0.01 * pressure), "median of the logs")
    drawn = "" if fit.air_known else "little data: drawn to the base's"
    out.put("oil.air_fraction", found.air_fraction, drawn)
    out.notes.append(
        "the chambers' volumes follow from how compliance changes with position, and area_1"
        if found.volumes_found
        else "only volume over bulk modulus is identifiable: the chambers' volumes stay the base's"
    )


def _better(out: Identification, estimate: Estimate, base: float, sharp: float, quantity: str = "") -> bool:
    """Whether to take an estimate: it is sharp, or the base is surely farther off; a note where it is far."""
    if not (estimate.relative < sharp or abs(estimate.value - base) > 3.0 * estimate.std):
        return False
    ratio = estimate.value / base if base > 0.0 else 1.0
    if quantity and not 1.0 / SURPRISING < ratio < SURPRISING:
        out.notes.append(
            f"{quantity} is {ratio:.2g} times that of base {out.base.name}: another kind of unit, or a "
            "pressure in the wrong unit of measure"
        )
    return True


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
