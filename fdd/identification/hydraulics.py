"""Displacement, leakage, volumes and compressibility put into a profile, as the volume balances tell them.

The balances of `fdd.identification.volume_steps` know only volume over bulk modulus. But the piston moves
that volume by a known amount, so how compliance changes with position, and how the two chambers
differ at one position, tells two more numbers::

    V1 = V0 ((1 + δ) / g + A1 x / V0),   V2 = V0 ((1 - δ) / g - A2 x / V0)

g, the position gain, and δ, the split. They enter the balance nearly linearly: Gauss-Newton, with the
columns by differences, a Cauchy loss (steps with an unmodelled event would otherwise decide) and a wide
prior.

A dead volume within three of the base's own standard deviations explains g; then the volumes are divided by
it, and bulk modulus becomes absolute up to the area. A g farther off is no volume: hoses or walls then give
with position, or the base is another kind of unit. The volumes stay and g is kept
as the profile's `position_compliance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.errors import InputError
from fdd.identification import Estimate, Identification
from fdd.identification.balance import LEAST_ROWS, OVERLAP, BalanceFit, fit_balance, fit_theta
from fdd.identification.record import Record
from fdd.identification.signs import MOST_GAIN_CHANGE
from fdd.identification.volume_steps import SMOOTHING, LogBalances, Term, VolumeSteps, keeps_trapped_oil
from fdd.sections import Provenance
from fdd.tolerances import tolerance
from fdd.unit import Unit

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
HIDDEN_LEAKAGE, HIDDEN_CASE = 0.03, 0.25
"""Relative standard deviations to add where the chambers' pressures are reconstructed."""
HIDDEN_BULK = (0.10, 0.22, 0.35)
"""The same of bulk modulus: beside a measured accumulator; without one, when what lifts the chambers is
guessed; for a rod on one side, whose piloted valves nobody knows either. On simulated units."""

ROUNDS = 4
PRIOR_GAIN, PRIOR_SPLIT = 0.5, 0.15
"""Spread of g about 1 and of δ about 0 before the logs are seen."""
VOLUME_SPREAD = 0.15
"""Relative standard deviation of the dead volume among units of one kind: lines and blocks differ."""
VOLUME_SURE = 3.0
STEP = 0.05
GAIN_LIMITS, SPLIT_LIMIT = (0.3, 3.0), 0.4
MOST_POSITION_COMPLIANCE = 5.0
"""That a profile takes."""
FLOOR_GAIN, FLOOR_SPLIT = 0.03, 0.005
"""What the model leaves out; on simulated units with known volumes g is off by 0.03, δ by 0.003 (median)."""
TELLING = 0.15
"""Standard deviation of g up to which the logs tell it: half of what units differ by."""


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
    if not _better(fit.displacement, out.base.pump.displacement, sharp):
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
    if not (enough and _better(total, known, LEAKAGE_SHARP)):
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
    if not (seen and _better(beta, known, BULK_SHARP)):
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


def _better(estimate: Estimate, base: float, sharp: float) -> bool:
    """Whether to take an estimate: it is sharp, or the base is surely farther off."""
    return estimate.relative < sharp or abs(estimate.value - base) > 3.0 * estimate.std


@dataclass(frozen=True)
class VolumeFit:
    """Position gain and split of the chambers' volumes, and whether the gain is one of volume."""

    gain: Estimate
    split: Estimate

    @property
    def of_volume(self) -> bool:
        """True where the dead volume explains the gain."""
        spread = float(np.hypot(VOLUME_SPREAD, self.gain.std))
        return abs(float(np.log(self.gain.value))) < VOLUME_SURE * spread

    def applied(self, base: Unit) -> Unit:
        """The profile with these volumes (or this position compliance)."""
        unit = _of_volumes(base, self.gain.value if self.of_volume else 1.0, self.split.value)
        if not self.of_volume:
            swept = base.cylinder.position_compliance * self.gain.value
            unit.cylinder.position_compliance = min(swept, MOST_POSITION_COMPLIANCE)
        return unit


def fit_volumes(logs: LogBalances, base: Unit) -> VolumeFit | None:
    """Position gain and split; None where the logs do not tell the gain, or have it beyond a volume's."""
    gain, split = 1.0, 0.0
    std = np.array([PRIOR_GAIN, PRIOR_SPLIT])
    for _ in range(ROUNDS):
        steps = logs.steps(_of_volumes(base, gain, split))
        theta, sigma = fit_theta(logs, steps, base)
        wider = logs.steps(_of_volumes(base, gain * (1.0 + STEP), split)).m
        # At equal compliance in mid-stroke: only what changes with position is the gain's.
        wider[:, Term.STIFF :] *= 1.0 + STEP
        other = logs.steps(_of_volumes(base, gain, split + STEP)).m
        slopes = ((wider - steps.m) @ theta) / (STEP * gain), ((other - steps.m) @ theta) / STEP
        columns = np.column_stack([steps.m, *slopes])
        residual = steps.y - steps.m @ theta
        weights = 1.0 / (1.0 + (residual / (2.0 * sigma)) ** 2)
        unit = OVERLAP * sigma**2
        pull = np.concatenate([np.full(len(Term), 1e-6), [1.0 / PRIOR_GAIN**2, 1.0 / PRIOR_SPLIT**2]]) * unit
        away = np.concatenate([np.zeros(len(Term)), [1.0 - gain, -split]])
        normal = (columns.T * weights) @ columns + np.diag(pull)
        right = columns.T @ (weights * residual) + pull * away
        scale = np.sqrt(np.diag(normal))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10)
        change = (inverse @ (right / scale)) / scale
        std = (np.sqrt(np.maximum(np.diag(inverse), 0.0) * unit) / scale)[-2:]
        gain = float(np.clip(gain + change[-2], *GAIN_LIMITS))
        split = float(np.clip(split + change[-1], -SPLIT_LIMIT, SPLIT_LIMIT))
    inside = GAIN_LIMITS[0] < gain < GAIN_LIMITS[1] and abs(split) < SPLIT_LIMIT
    if std[0] > TELLING or not inside:  # at a limit: something else than volume bends the balance
        return None
    return VolumeFit(
        Estimate(gain, float(np.hypot(std[0], FLOOR_GAIN * gain))),
        Estimate(split, float(np.hypot(std[1], FLOOR_SPLIT))),
    )


def _of_volumes(base: Unit, gain: float, split: float) -> Unit:
    unit = base.model_copy(deep=True)
    unit.cylinder.volume_1 *= (1.0 + split) / gain
    unit.cylinder.volume_2 *= (1.0 - split) / gain
    return unit
