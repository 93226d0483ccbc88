"""Effective bulk modulus over pressure (thesis 5.4, eqs 5.19 to 5.21), by identification's volume balances.

While its valves are shut, what a chamber takes in and the piston does not sweep has compressed its oil: that
volume over the pressure it raised, times the chamber's volume, is 1/β (eq. 5.19). What changes of it with
pressure is the free air's: ``1/β(p) = 1/β_oil + α·c(p)`` (eqs 5.20 and 5.21, see `fdd.residuals.oil`).
"""

from __future__ import annotations

import numpy as np

from fdd.identification import Array, Identification, jackknife_std
from fdd.identification.balance import LEAST_AIR
from fdd.identification.experiments import NORMAL_95, Outcome, axes, cloud, curve_line, figure
from fdd.identification.hydraulics import BULK_SHARP, LEAST_SIGNAL, VOLUME_SPREAD, Hydraulics, hydraulics
from fdd.identification.record import Record
from fdd.identification.volume_steps import REFEED_MARGIN, SMOOTHING, STEPS, Term, scales
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.report.words import listed
from fdd.residuals.oil import air_compliance, modulus_at, pressure_of_compliance
from fdd.unit import Unit

AIR_SHARP = 0.5
"""Relative standard deviation of the free air up to which it is a figure."""
CLEAR = 5.0
"""Standard deviations of the pressures' noise by which a step in the figures must raise the pressure."""
MOST_REFERENCE = 5e6
"""Pa, highest pressure that compressibility is referred to: there the air gives less than the oil."""
ROWS = 8
"""Of the table, from the lowest to the highest pressure."""
BAR = 1e-5


def bulk_modulus(records: list[Record], unit: Unit) -> Outcome:
    """Bulk modulus at the logs' usual pressure and over pressure, and the free air behind that.

    Raises InputError: a gain or pressures that cannot be this unit's.
    """
    out = Outcome("bulk-modulus", "Effective bulk modulus")
    found, notes = _fitted(records, unit, None)
    if found is None:
        above = [r.smooth(np.maximum(r.pressure_1, r.pressure_2), SMOOTHING) - r.accumulator for r in records]
        share = float(np.mean(np.concatenate(above) > REFEED_MARGIN))
        out.not_told.append(
            f"Bulk modulus: the higher chamber is {REFEED_MARGIN / 1e5:.1f} bar above the accumulator, so "
            f"that its refeeding valve is surely shut, in {100 * share:.0f} % of the time, and too seldom "
            "while it moves. Load the actuator, or map the chambers' pressures."
        )
        return out
    reference = found.logs.pressure
    while _at_bound(found) and found.logs.pressure < MOST_REFERENCE:
        higher = _fitted(records, unit, 2.0 * found.logs.pressure + 1e5)[0]
        if higher is None:
            break
        found = higher
    if _at_bound(found):
        out.not_told.append("Bulk modulus: no compression shows; steps of pressure and position do not fit.")
        return out
    raised, compressed, pressures = _steps(found)
    fit = found.fit
    usual, std = (float(x[0]) for x in _over_pressure(found, np.array([reference])))
    if fit.signal_over_noise < LEAST_SIGNAL or std > BULK_SHARP * usual or not pressures.size:
        out.not_told.append(
            f"Bulk modulus: the log gives {figure(BAR * usual)} ± {NORMAL_95 * BAR * std:.2g} bar; "
            f"the pressure steps in shut chambers are {fit.signal_over_noise:.1f} times the sensors' noise. "
            "Record reversals at speed, or strokes against a throttle or a spring."
        )
        return out
    low, middle, high = (float(q) for q in np.quantile(pressures, [0.02, 0.5, 0.98]))
    levels = [reference, middle] if low <= reference <= high or _air_told(found) else [middle]
    if levels[0] != reference:
        out.not_told.append(
            f"Bulk modulus at the logs' usual pressure, {BAR * reference:.3g} bar: the steps run from "
            f"{BAR * low:.3g} to {BAR * high:.3g} bar, and only the free air would tell what lies beyond."
        )
    for level, value, spread in zip(levels, *_over_pressure(found, np.array(levels)), strict=True):
        note = f"profile {figure(BAR * modulus_at(unit.oil, level))} bar"
        out.tell(f"effective bulk modulus at {BAR * level:.3g} bar", float(value), float(spread), "Pa", note)
    _tell_air(out, found, unit, low, high)
    _draw(out, found, unit, low, high, raised, compressed)
    out.notes.append(
        f"{fit.rows} steps of {listed([f'{s:.3g}' for s in STEPS], 'and')} s in which a chamber is neither "
        "refed nor relieved; leakage, pump displacement and free air were fitted with it. Pressures are "
        "gauge; free air is over the oil's volume, at atmospheric pressure. What hoses and walls give is in "
        "the modulus."
    )
    out.notes += [n for n in notes if "volume" in n or "chamber pressures" in n]
    return out


def _fitted(records: list[Record], unit: Unit, pressure: float | None) -> tuple[Hydraulics | None, list[str]]:
    """The balances' fit with compressibility referred to `pressure`, and its notes."""
    profile = Identification(unit.model_copy(deep=True), unit, "")
    return hydraulics(profile, records, pressure), profile.notes


def _at_bound(found: Hydraulics) -> bool:
    """Whether the oil without air came out at its bound, three times β: with so much air it is stiffer."""
    index = found.base.oil.polytropic_index
    air = found.fit.air_fraction.value * float(air_compliance(found.logs.pressure, index))
    return 1.5 * air * found.fit.bulk_modulus.value > 0.999


def _steps(found: Hydraulics) -> tuple[Array, Array, Array]:
    """Steps as eq. 5.19 has them, those clear of noise: volume times pressure raised (m³·Pa), volume
    compressed (m³), and at what pressure (Pa), (n,) each."""
    steps, unit = found.steps, found.base
    known = found.fit.theta.copy()
    known[[Term.STIFF, Term.AIR]] = 0.0
    scale, index = scales(unit), unit.oil.polytropic_index
    raised = -steps.m[:, Term.STIFF] / scale[Term.STIFF]
    bound = 0.5 * float(air_compliance(found.logs.pressure, index))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = -steps.m[:, Term.AIR] / scale[Term.AIR] / raised - bound
    pressure = pressure_of_compliance(mean, index)
    noise = np.sqrt(np.sum((steps.noise[:, :, Term.STIFF] / scale[Term.STIFF]) ** 2, axis=1))
    noise *= np.where(steps.chamber == 1, *found.logs.noise)
    clear = np.isfinite(pressure) & (np.abs(raised) > CLEAR * noise)
    return raised[clear], (steps.m @ known - steps.y)[clear], pressure[clear]


def _over_pressure(found: Hydraulics, pressure: Array) -> tuple[Array, Array]:
    """Bulk modulus and its standard deviation (Pa), both (n,), at gauge `pressure` (n,) Pa."""
    index, fit = found.base.oil.polytropic_index, found.fit
    more = air_compliance(pressure, index) - float(air_compliance(found.logs.pressure, index))
    others = np.maximum(fit.compliances[:, :1] + fit.compliances[:, 1:] * more, 1e-14)
    value = np.maximum(1.0 / found.bulk_modulus.value + found.air_fraction.value * more, 1e-14)
    # What the jackknife does not see, reconstructed pressures and volumes, is one share at all pressures.
    seen = float(jackknife_std(fit.compliances[:, 0])) * found.bulk_modulus.value
    unseen = np.sqrt(max(found.bulk_modulus.relative**2 - seen**2, 0.0) + _volume_share(found) ** 2)
    return 1.0 / value, np.hypot(jackknife_std(others) / value, unseen) / value


def _volume_share(found: Hydraulics) -> float:
    """Relative standard deviation of volumes that stay the profile's: its own, or what units differ by."""
    if found.volumes_found:
        return 0.0
    cylinder = found.base.cylinder
    known = cylinder.provenance.get("volume_1")
    return VOLUME_SPREAD if known is None or known.std is None else known.std / cylinder.volume_1


def _air_told(found: Hydraulics) -> bool:
    """Whether the logs tell the free air, and with it how bulk modulus changes with pressure."""
    air = found.air_fraction.wider(_volume_share(found))
    return found.fit.air_known and air.relative <= AIR_SHARP and air.value >= 1.01 * LEAST_AIR


def _tell_air(out: Outcome, found: Hydraulics, unit: Unit, low: float, high: float) -> None:
    """Free air, and the oil without it."""
    air = found.air_fraction.wider(_volume_share(found))
    if not _air_told(found):
        out.not_told.append(
            "Free air, and with it how bulk modulus changes with pressure: pressures of "
            f"{low / 1e5:.2g} to {high / 1e5:.2g} bar give {100 * air.value:.2g} ± "
            f"{100 * NORMAL_95 * air.std:.1g} % (profile {100 * unit.oil.air_fraction:.2g} %). "
            "Record steps from near the accumulator's pressure to several times it."
        )
        return
    profile = f"profile {unit.oil.air_fraction:.4g}"
    out.tell("free air at atmospheric pressure", air.value, air.std, "1", profile)
    value, std = (float(x[0]) for x in _over_pressure(found, np.array([1e12])))
    if std < BULK_SHARP * value and not _at_bound(found):
        out.tell("bulk modulus of the oil without free air", value, std, "Pa")


def _draw(
    out: Outcome, found: Hydraulics, unit: Unit, low: float, high: float, raised: Array, compressed: Array
) -> None:
    pressure = np.linspace(low, high, 80)
    beta, std = _over_pressure(found, pressure)
    lower, upper = beta - NORMAL_95 * std, beta + NORMAL_95 * std
    profile = np.array([modulus_at(unit.oil, float(p)) for p in pressure])
    out.curves["fitted"] = {"pressure": pressure, "bulk_modulus": beta, "low": lower, "high": upper}
    out.heads = ("pressure", "bulk modulus", "95 %", "profile")
    for k in np.linspace(0, pressure.size - 1, ROWS).astype(int):
        out.rows.append((
            f"{BAR * pressure[k]:.3g} bar", f"{figure(BAR * beta[k])} bar",
            f"{figure(BAR * lower[k])} … {figure(BAR * upper[k])}", f"{figure(BAR * profile[k])} bar",
        ))  # fmt: skip
    curves = [
        tr.band(BAR * pressure, BAR * lower, BAR * upper, "", tr.BLUE),
        curve_line(BAR * pressure, BAR * beta, "fitted", tr.BLUE),
        curve_line(BAR * pressure, BAR * profile, "profile", tr.VERMILLION, "dash"),
    ]
    line = np.array([raised.min(), raised.max()])
    usual = f"{found.logs.pressure / 1e5:.3g} bar"
    scatter = [
        cloud(10.0 * raised, 1e9 * compressed, "steps", tr.GREY),
        curve_line(10.0 * line, 1e9 * line / found.bulk_modulus.value, f"fitted, {usual}", tr.BLUE),
        curve_line(10.0 * line, 1e9 * line / modulus_at(unit.oil, found.logs.pressure),
                   f"profile, {usual}", tr.VERMILLION, "dash"),
    ]  # fmt: skip
    out.figures = [
        Figure("modulus", "Bulk modulus over pressure", curves, axes("gauge pressure (bar)"), "bar",
               "shaded: 95 % of the fit", 340, True),
        Figure("compression", "Compressed volume", scatter, axes("volume times pressure raised (cm³·bar)"),
               "mm³", "over what raised it; the slope is 1/β (eq. 5.19)", 340, True),
    ]  # fmt: skip
