"""May a profile be used? What speaks against the logs or the base, and what remains open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, log, sqrt

import numpy as np
from scipy.special import chdtri

from fdd.identification.logs_agree import Comparison, disagreement
from fdd.identification.logs_healthy import unhealthy
from fdd.identification.profile import Identification, TableRow
from fdd.identification.signs import gain_slips
from fdd.identification.slips import slips
from fdd.measures import MEASURES
from fdd.residuals.oil import modulus_at, viscosity
from fdd.samples import Samples
from fdd.tolerances import TOLERANCES, tolerance
from fdd.unit import Unit

FALSE_REFUSAL = 0.003
"""Share of sound units of the base's kind that are refused by chance, over all quantities."""
OTHER_SIZE = 2.0
"""Standard deviations of the base from which travel per rad is told: it may be the next size's profile."""
WORTH_SAYING = 1.5
"""Factor of leakage that is said although it is left open: a worn pump may be like that."""
SCALES = {"accumulator.charge_pressure": 1, "oil.bulk_modulus": 1, "pump.leakage": -1, "friction": 1,
          "drive.torque_constant": 1, "accumulator.relief_pressure": 1, "noise": 1, "counts": 1}  # fmt: skip
"""How what is identified goes with pressures read too large."""
ODDS = 29.0
"""2 ln(odds): one slip in particular is a priori one in 20 000 (one in 1000 of any kind, twenty pairs of
units), and it is told from odds of a hundred to one on."""
ALIKE = 6.0
"""2 ln(odds) of twenty to one, within which another slip is named beside the likeliest."""
COLDEST, HOTTEST = -40.0, 120.0
"""°C of hydraulic oil: pour point and where seals give up."""


@dataclass
class Judgement:
    """Whether a profile may be used.

    Attributes
    ----------
    refusals : why not, one clause each. limits : what a user must know of it. remarks : what would help.
    """

    refusals: list[str] = field(default_factory=list)
    limits: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """``usable``, ``usable with limits`` or ``not usable``."""
        return "not usable" if self.refusals else "usable with limits" if self.limits else "usable"

    @property
    def sentence(self) -> str:
        """The verdict with its reasons, one line."""
        if self.refusals:
            return f"not usable, because {'; '.join(self.refusals)}"
        return f"usable with limits: {'; '.join(self.limits)}" if self.limits else "usable"


def judge(
    found: Identification,
    unit: Unit,
    base: Unit,
    logs: Sequence[Samples],
    labels: Sequence[str],
    *,
    more: bool = False,
) -> Judgement:
    """Judge a new profile.

    Parameters
    ----------
    found : of all logs, from `identify_unit`. unit : its profile with baseline. base : what it was made from.
    logs, labels : the healthy logs and what to call them.
    more : the base is this unit's own profile, and the logs are added to it: they are held against it.

    Returns
    -------
    Refused is what has another unit of measure, lies farther from the base than data sheets and
    manufacturing leave open, or was not healthy all along; at most 2 % of healthy sets are by chance.
    """
    out = Judgement()
    ratios = against_base(found, base)
    for samples, label in zip(logs, labels, strict=True):
        out.refusals += [f"{label}: {text}" for text in _temperature(samples)]
    slip = pressure_slip(ratios, push_of(logs, base))
    if slip is not None:
        out.refusals.append(slip)
    else:
        _far(out, ratios, base)
    compared: list[Comparison] = []
    if not out.refusals:  # of a wrong unit or base the rest only follows
        compared = disagreement(base if more else found.unit, logs, labels, more=more)
        out.refusals += [c.sentence for c in compared if c.refused]
        for doubt in unhealthy(base if more else unit, logs, labels):
            (out.refusals if doubt.sure else out.limits).append(doubt.text)
    _open_questions(out, found, ratios, compared, len(logs) + more, base)
    return out


@dataclass(frozen=True)
class Ratio:
    """An identified quantity over the base's, at the same oil temperature and pressure, and its ln's std."""

    value: float
    std: float
    open: float
    """Standard deviation of ln(unit / base) that the base leaves open."""

    def misfit(self, factor: float = 1.0) -> float:
        """-2 ln of the likelihood of a mistaken `factor` on the quantity, but for what is common to all."""
        return (log(self.value) - log(factor)) ** 2 / (self.open**2 + self.std**2)


def against_base(found: Identification, base: Unit) -> dict[str, Ratio]:
    """What was identified over what the base leads to expect.

    Leakage is compared at the logs' temperature, bulk modulus at their pressure; friction as the mean of both
    directions.
    """
    rows = {r.quantity: r for r in found.table if r.identified is not None and r.std is not None}
    unit, out = found.unit, {}
    for name in (
        "pump.displacement",
        "cylinder.area_2",
        "drive.torque_constant",
        "accumulator.charge_pressure",
    ):
        row = rows.get(name)
        if row is not None and row.base > 0.0 and row.identified is not None:
            out[name] = _ratio(row, name, row.base, base)
    leakage = found.leakage
    if leakage is not None and base.pump.total_leakage > 0.0:
        warm = unit.oil.reference_temperature, base.oil.reference_temperature
        thinner = float(viscosity(base.oil, warm[1]) / viscosity(base.oil, warm[0]))
        # Where nobody measures the oil's temperature it may be 15 K off, at some 4 % a kelvin.
        known = any(r.quantity == "oil.reference_temperature" for r in rows.values())
        out["pump.leakage"] = Ratio(
            leakage.value / (base.pump.total_leakage * thinner),
            float(np.hypot(leakage.relative, 0.0 if known else 0.6)), tolerance(base, "pump.leakage"),
        )  # fmt: skip
    row = rows.get("oil.bulk_modulus")
    if row is not None:
        out["oil.bulk_modulus"] = _ratio(
            row, row.quantity, modulus_at(base.oil, unit.oil.reference_pressure), base
        )
    branches = [
        rows[f"friction.{d}.coulomb"] for d in ("forward", "reverse") if f"friction.{d}.coulomb" in rows
    ]
    each = [_ratio(b, "friction", b.base, base) for b in branches if b.base > 0.0 and b.identified]
    if each:
        mean = exp(float(np.mean([log(r.value) for r in each])))
        out["friction"] = Ratio(mean, max(r.std for r in each), each[0].open)
    return out


def _ratio(row: TableRow, name: str, expected: float, base: Unit) -> Ratio:
    assert row.identified is not None and row.std is not None
    std = row.std / max(row.identified, 1e-300)
    return Ratio(max(row.identified / expected, 1e-12), std, tolerance(base, name))


def pressure_slip(ratios: dict[str, Ratio], push: float = 1.0) -> str | None:
    """The unit of measure in which the pressures were read by mistake, in words; None where none was.

    All that goes with the pressures' size is weighed together: a slip's factor against what units of one kind
    differ by. A piston that moves both ways needs its friction's force at least, whatever the load.

    Parameters
    ----------
    ratios : of `against_base`. push : force of the pressures, root mean square, over the base's friction.
    """

    def misfit(factor: float) -> float:
        lacking = min(log(push) - log(factor), 0.0) / TOLERANCES["friction"][0]
        return lacking**2 + sum(ratios[n].misfit(factor**sign) for n, sign in SCALES.items() if n in ratios)

    sizes = sorted({m.factor for m in MEASURES.values() if m.dimension == "pressure"})
    factors = sorted({round(a / b, 9) for a in sizes for b in sizes if a != b}, key=misfit)
    best = factors[0]
    if misfit(1.0) - misfit(best) < ODDS:
        return None
    looks = dict.fromkeys(slips(f, "pressure") for f in factors if misfit(f) < misfit(best) + ALIKE)
    told = [f"{WORDS[n]} {_times(ratios[n].value)} the base's" for n in SCALES if n in ratios]
    told += [f"their force {_times(push)} the friction"] if push < 1.0 else []
    return (
        f"the pressures look {_times(best)} what they should be, as {' or '.join(looks)} are "
        f"({', '.join(told)}); check their unit in the channel map"
    )


def push_of(logs: Sequence[Samples], base: Unit) -> float:
    """Force of the pressures, root mean square over the logs, over the base's friction."""
    squares = []
    for each in logs:
        drops = [each["pressure_difference"]] if "pressure_difference" in each else []
        if "pressure_1" in each and "pressure_2" in each:
            drops.append(each["pressure_1"] - each["pressure_2"])
        # A column may be there and empty: the largest of what is told.
        told = [float(np.mean(d[np.isfinite(d)] ** 2)) for d in drops if np.isfinite(d).any()]
        squares.append(max(told, default=0.0))
    friction = 0.5 * (base.friction.forward.coulomb + base.friction.reverse.coulomb)
    force = base.cylinder.area_1 * np.sqrt(np.mean(squares))
    return max(float(force), 1e-9) / friction if friction > 0.0 else 1.0


WORDS = {
    "pump.displacement": "travel per rad of the pump", "cylinder.area_2": "area_2",
    "pump.leakage": "leakage", "oil.bulk_modulus": "bulk modulus", "friction": "friction",
    "drive.torque_constant": "torque constant", "accumulator.charge_pressure": "charge pressure",
    "accumulator.relief_pressure": "pressure beyond the relief setting", "noise": "their noise",
    "counts": "their counts",
}  # fmt: skip


def _times(factor: float) -> str:
    return f"{factor:.3g} times"


def _far(out: Judgement, ratios: dict[str, Ratio], base: Unit) -> None:
    sure = float(chdtri(1, FALSE_REFUSAL / len(WORDS)))
    for name, ratio in ratios.items():
        told = f"{WORDS[name]} is {_times(ratio.value)} that of base {base.name}"
        travel = name == "pump.displacement"
        slip = _gain_slip(ratio) if travel else ""
        if slip or ratio.misfit() > sure:
            factor, why = exp(sqrt(sure) * ratio.open), TOLERANCES[name][1]
            out.refusals.append(
                f"{told}, which leaves a factor of {factor:.2g} open ({why}){slip}; check the base and the "
                "units in the channel map"
            )
        elif travel and ratio.misfit() > OTHER_SIZE**2:
            out.limits.append(f"{told}: the next size, or another base would fit better")


def _gain_slip(ratio: Ratio) -> str:
    """The slip that explains travel per rad better than the base's tolerance does, at `ODDS`; else empty."""
    length, angle, speed = (
        sorted({m.factor for m in MEASURES.values() if m.dimension == d})
        for d in ("length", "angle", "angular_speed")
    )
    pairs = [(a, b) for sizes in (length, angle, speed) for a in sizes for b in sizes if a != b]
    best = min((a / b for a, b in pairs), key=ratio.misfit)
    return gain_slips(best) if ratio.misfit() - ratio.misfit(best) > ODDS else ""


def _temperature(samples: Samples) -> list[str]:
    if "oil_temperature" not in samples:
        return []
    values = samples["oil_temperature"][np.isfinite(samples["oil_temperature"])]
    if not values.size or COLDEST <= (middle := float(np.median(values))) <= HOTTEST:
        return []
    read = {u: MEASURES[u].factor * middle + MEASURES[u].offset for u in ("K", "degF")}
    looks = next((u for u, celsius in read.items() if COLDEST <= celsius <= 90.0), None)
    return [f"oil at {middle:.0f} °C" + (f": it looks like {looks} read as degC" if looks else "")]


def _open_questions(
    out: Judgement, found: Identification, ratios: dict[str, Ratio], compared: list[Comparison], logs: int,
    base: Unit,
) -> None:  # fmt: skip
    leakage = ratios.get("pump.leakage")
    if leakage is not None and not 1.0 / WORTH_SAYING < leakage.value < WORTH_SAYING:
        which = "worn" if leakage.value > 1.0 else "differently built"
        out.limits.append(
            f"leakage is {_times(leakage.value)} that of base {base.name}: a healthy unit of this kind, or a "
            f"{which} one; compare with the maker's sheet"
        )
    if logs == 1:
        out.remarks.append("one log: whether this unit's logs agree cannot be told; more go in by --add")
    elif not any(c.logs > 1 for c in compared):
        out.limits.append("no quantity is sharp in two logs: whether they agree cannot be told")
    kept = {r.quantity for r in found.table if r.identified is None}
    for path, words in (
        ("pump.displacement", "travel per rad of the pump"), ("pump.cross_port_leakage", "leakage"),
        ("oil.bulk_modulus", "bulk modulus"), ("friction.forward.coulomb", "friction extending"),
        ("friction.reverse.coulomb", "friction retracting"),
    ):  # fmt: skip
        if path in kept:
            out.limits.append(f"{words} stays the base's, the logs do not excite it")
