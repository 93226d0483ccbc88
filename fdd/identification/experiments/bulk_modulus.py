"""Effective bulk modulus over pressure (thesis 5.4, eqs 5.19 to 5.21), by identification's volume balances.

While its valves are shut, what a chamber takes in and the piston does not sweep has compressed its oil: that
volume over the pressure it raised, times the chamber's volume, is 1/β (eq. 5.19). What changes of it with
pressure is the free air's: ``1/β(p) = 1/β_oil + α·c(p)`` (eqs 5.20 and 5.21, see `fdd.residuals.oil`).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.identification.balance import GROUPS, LEAST_AIR, Estimate
from fdd.identification.experiments.leakage import LIMIT
from fdd.identification.experiments.outcome import (
    NORMAL_95,
    Outcome,
    Told,
    axes,
    cloud,
    curve_line,
    figure,
    points,
)
from fdd.identification.identify import BULK_SHARP, LEAST_SIGNAL, Hydraulics, hydraulics
from fdd.identification.least_squares import huber, jackknife_std
from fdd.identification.profile import ProfileWriter
from fdd.identification.record import Record
from fdd.identification.volume_steps import (
    AIR,
    AIR_SCALE,
    REFEED_MARGIN,
    SMOOTHING,
    STEPS,
    STIFF,
    scales,
)
from fdd.identification.volumes import VOLUME_SPREAD
from fdd.report import traces as tr
from fdd.report.plots import Figure
from fdd.report.words import listed
from fdd.residuals.oil import air_compliance, modulus_at, pressure_of_compliance
from fdd.unit import Unit

Array = NDArray[np.float64]

AIR_SHARP = 0.5
"""Relative standard deviation of the free air up to which it is a figure."""
CLEAR = 5.0
"""Standard deviations of the pressures' noise by which a step in the figures must raise the pressure."""
MOST_REFERENCE = 5e6
"""Pa, highest pressure that compressibility is referred to: there the air gives less than the oil."""
BINS = 8
LEAST_STEPS = 20
BAR = 1e-5


def bulk_modulus(records: list[Record], unit: Unit) -> Outcome:
    """Bulk modulus at the logs' usual pressure and over pressure, and the free air behind that.

    Raises
    ------
    InputError : a gain or pressures that cannot be this unit's.
    """
    out = Outcome("bulk-modulus", "Effective bulk modulus")
    found, notes = _fitted(records, unit, None)
    if found is None:
        higher = [
            r.smooth(np.maximum(r.pressure_1, r.pressure_2), SMOOTHING) - r.accumulator for r in records
        ]
        share = float(np.mean(np.concatenate(higher) > REFEED_MARGIN))
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
    rows, fit = _Rows(found), found.fit
    beta = Estimate(*_at(found, reference))
    if _at_bound(found):
        out.not_told.append("Bulk modulus: no compression shows; steps of pressure and position do not fit.")
        return out
    if fit.signal_over_noise < LEAST_SIGNAL or beta.relative > BULK_SHARP or not np.any(rows.clear):
        out.not_told.append(
            f"Bulk modulus: the log gives {figure(BAR * beta.value)} ± {NORMAL_95 * BAR * beta.std:.2g} bar; "
            f"the pressure steps in shut chambers are {fit.signal_over_noise:.1f} times the sensors' noise. "
            "Record reversals at speed, or strokes against a throttle or a spring."
        )
        return out
    low, middle, high = (float(q) for q in np.quantile(rows.pressure[rows.clear], [0.02, 0.5, 0.98]))
    air_told = _air(out, found, unit, (low, high))
    levels = [reference] if low <= reference <= high or air_told else []
    if not levels:
        out.not_told.append(
            f"Bulk modulus at the logs' usual pressure, {BAR * reference:.3g} bar: the steps run from "
            f"{BAR * low:.3g} to {BAR * high:.3g} bar, and only the free air would tell what lies beyond."
        )
    for place, level in enumerate([*levels, middle]):
        value, std = _at(found, level)
        note = f"profile {figure(BAR * modulus_at(unit.oil, level))} bar"
        quantity = f"effective bulk modulus at {BAR * level:.3g} bar"
        out.told.insert(place, Told.within(quantity, value, NORMAL_95 * std, "Pa", note))
    _draw(out, found, rows, unit, low, high)
    out.notes.append(
        f"{fit.rows} steps of {listed([f'{s:.3g}' for s in STEPS], 'and')} s in which a chamber is neither "
        "refed nor relieved; leakage, pump displacement and free air were fitted with it. Pressures are "
        "gauge; free air is over the oil's volume, at atmospheric pressure. What hoses and walls give is in "
        "the modulus. Intervals of steps alone leave out what the volumes are uncertain by."
    )
    out.notes += [n for n in notes if "volume" in n or "chamber pressures" in n]
    return out


def _fitted(records: list[Record], unit: Unit, pressure: float | None) -> tuple[Hydraulics | None, list[str]]:
    """The balances' fit with compressibility referred to `pressure`, and its notes."""
    writer = ProfileWriter(unit.model_copy(deep=True), unit, "")
    return hydraulics(writer, records, pressure), writer.result.notes


def _at_bound(found: Hydraulics) -> bool:
    """Whether the oil without air came out at its bound, three times β: with so much air it is stiffer."""
    index = found.base.oil.polytropic_index
    air = found.fit.air_fraction.value * float(air_compliance(found.logs.pressure, index))
    return 1.5 * air * found.fit.bulk_modulus.value > 0.999


class _Rows:
    """Steps as eq. 5.19 has them: volume compressed, volume times pressure raised, and at what pressure."""

    def __init__(self, found: Hydraulics) -> None:
        steps, fit, unit = found.steps, found.fit, found.base
        known = fit.theta.copy()
        known[[STIFF, AIR]] = 0.0
        scale, index = scales(unit), unit.oil.polytropic_index
        self.compressed = steps.m @ known - steps.y
        self.raised = -steps.m[:, STIFF] / scale[STIFF]
        bound = 0.5 * float(air_compliance(found.logs.pressure, index))
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = -steps.m[:, AIR] / AIR_SCALE / self.raised - bound
        self.pressure = pressure_of_compliance(mean, index)
        noise = np.sqrt(np.sum((steps.noise[:, :, STIFF] / scale[STIFF]) ** 2, axis=1))
        noise *= np.where(steps.chamber == 1, *found.logs.noise)
        self.clear = np.isfinite(self.pressure) & (np.abs(self.raised) > CLEAR * noise)
        self.block = steps.block

    def modulus(self, rows: NDArray[np.bool_]) -> tuple[float, float, float]:
        """Slope of these rows alone as a bulk modulus (Pa), with its 95 % interval; jackknifed over time."""
        raised, compressed, block = self.raised[rows, None], self.compressed[rows], self.block[rows]
        weights = huber(raised, compressed, LIMIT)[1]
        group = np.unique(block, return_inverse=True)[1] % GROUPS
        products = np.stack([(weights * raised[:, 0]) ** 2, weights**2 * raised[:, 0] * compressed])
        sides = np.array([products @ (group == g) for g in np.unique(group)])
        whole = sides.sum(axis=0)
        parts = (whole - sides)[:, 1] / (whole - sides)[:, 0]
        value = float(whole[1] / whole[0])
        half = float(student.ppf(0.975, max(len(parts) - 1, 1)) * jackknife_std(parts))
        return 1.0 / value, 1.0 / (value + half), 1.0 / max(value - half, 0.1 * value)


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


def _at(found: Hydraulics, pressure: float) -> tuple[float, float]:
    """As `_over_pressure`, at one."""
    value, std = _over_pressure(found, np.array([pressure]))
    return float(value[0]), float(std[0])


def _volume_share(found: Hydraulics) -> float:
    """Relative standard deviation of volumes that stay the profile's: its own, or what units differ by."""
    if found.volumes_found:
        return 0.0
    cylinder = found.base.cylinder
    known = cylinder.provenance.get("volume_1")
    return VOLUME_SPREAD if known is None or known.std is None else known.std / cylinder.volume_1


def _air(out: Outcome, found: Hydraulics, unit: Unit, span: tuple[float, float]) -> bool:
    """Free air, and the oil without it; whether the logs tell them apart."""
    fit, volume = found.fit, _volume_share(found)
    air = found.air_fraction.wider(volume)
    if not fit.air_known or air.relative > AIR_SHARP or air.value < 1.01 * LEAST_AIR:
        out.not_told.append(
            "Free air, and with it how bulk modulus changes with pressure: pressures of "
            f"{span[0] / 1e5:.2g} to {span[1] / 1e5:.2g} bar give {100 * air.value:.2g} ± "
            f"{100 * NORMAL_95 * air.std:.1g} % (profile {100 * unit.oil.air_fraction:.2g} %). "
            "Record steps from near the accumulator's pressure to several times it."
        )
        return False
    profile = f"profile {unit.oil.air_fraction:.4g}"
    out.tell("free air at atmospheric pressure", air.value, air.std, "1", profile)
    value, std = _at(found, 1e12)
    if std < BULK_SHARP * value and not _at_bound(found):
        out.tell("bulk modulus of the oil without free air", value, std, "Pa")
    return True


def _draw(out: Outcome, found: Hydraulics, rows: _Rows, unit: Unit, low: float, high: float) -> None:
    clear = rows.clear
    line = np.array([rows.raised[clear].min(), rows.raised[clear].max()])
    usual = f"{found.logs.pressure / 1e5:.3g} bar"
    scatter = [
        cloud(10.0 * rows.raised[clear], 1e9 * rows.compressed[clear], "steps", tr.GREY),
        curve_line(10.0 * line, 1e9 * line / found.bulk_modulus.value, f"fitted, {usual}", tr.BLUE),
        curve_line(10.0 * line, 1e9 * line / modulus_at(unit.oil, found.logs.pressure),
                   f"profile, {usual}", tr.VERMILLION, "dash"),
    ]  # fmt: skip
    pressure = np.linspace(low, high, 80)
    beta, std = _over_pressure(found, pressure)
    band = NORMAL_95 * std
    profile = np.array([modulus_at(unit.oil, float(p)) for p in pressure])
    lower, upper = beta - band, beta + band
    out.curves["fitted"] = {"pressure": pressure, "bulk_modulus": beta, "low": lower, "high": upper}
    out.heads = ("pressure", "bulk modulus by these steps alone", "95 %", "fitted", "profile", "steps")
    edges = np.quantile(rows.pressure[clear], np.linspace(0.0, 1.0, BINS + 1))
    table = []
    for a, b in pairwise(edges):
        inside = clear & (rows.pressure >= a) & (rows.pressure < b)
        if np.count_nonzero(inside) < LEAST_STEPS or np.unique(rows.block[inside]).size < 3:
            continue
        at, (value, least, most) = float(np.median(rows.pressure[inside])), rows.modulus(inside)
        table.append((at, value, least, most))
        out.rows.append((
            f"{BAR * at:.3g} bar", f"{figure(BAR * value)} bar",
            f"{figure(BAR * least)} … {figure(BAR * most)}", f"{figure(BAR * _at(found, at)[0])} bar",
            f"{figure(BAR * modulus_at(unit.oil, at))} bar", str(np.count_nonzero(inside)),
        ))  # fmt: skip
    curves = [
        tr.band(BAR * pressure, BAR * lower, BAR * upper, "", tr.BLUE),
        curve_line(BAR * pressure, BAR * beta, "fitted", tr.BLUE),
        curve_line(BAR * pressure, BAR * profile, "profile", tr.VERMILLION, "dash"),
    ]
    if table:
        p, value, least, most = np.array(table).T
        out.curves["steps"] = {"pressure": p, "bulk_modulus": value, "low": least, "high": most}
        curves.append(points(BAR * p, BAR * value, BAR * least, BAR * most, "by steps alone, 95 %", tr.GREEN))
    out.figures = [
        Figure("modulus", "Bulk modulus over pressure", curves, axes("gauge pressure (bar)"), "bar",
               "shaded: 95 % of the fit", 340, True),
        Figure("compression", "Compressed volume", scatter, axes("volume times pressure raised (cm³·bar)"),
               "mm³", "over what raised it; the slope is 1/β (eq. 5.19)", 340, True),
    ]  # fmt: skip
