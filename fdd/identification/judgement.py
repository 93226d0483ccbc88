"""May a profile be used, and is a log that of its own unit? By what the logs' balances identify: what speaks
against logs or base, and what remains open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, log, sqrt

import numpy as np
from scipy.special import chdtrc, chdtri

from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.faults import fault
from fdd.identification import WORDS, Identification, Ratio, against_base
from fdd.identification.hydraulics import RELIEF_EXCEEDED
from fdd.identification.identify import identify_unit
from fdd.identification.signs import gain_slips, slips
from fdd.measures import MEASURES
from fdd.samples import Samples
from fdd.tolerances import TOLERANCES
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
FALSE_ALARMS = 0.01
"""Share of healthy sets of logs that the pipeline's alarm rate is set to doubt by chance. Of 120 simulated
units 17 are doubted, as loads change in calibration runs; of 49 sets with a faulty log 22 by this alone."""
SHORTEST_PART = 10.0
"""s of a log on either side of an onset that can be identified by themselves."""
COLDEST, HOTTEST = -40.0, 120.0
"""°C of hydraulic oil: pour point and where seals give up."""
DISAGREEING = 0.01
"""Share of healthy sets of logs that are refused by chance because they disagree, over all quantities."""
BETWEEN = {
    "pump.leakage": (0.0, "1 to 2 K between the gap and the sensor stand in each log's own deviation"),
    "pump.displacement": (0.003, "0.01 to 0.03 % of a transducer's gain a kelvin"),
    "drive.torque_constant": (0.04, "magnets lose 0.1 % a kelvin and warm by 40"),
    "oil.bulk_modulus": (0.25, "air dissolves and comes out, and strokes are long or short"),
}
"""By what share a healthy unit differs from log to log, and by what. Friction is none of them: what a load
or a gust does to the force of one log alone is more."""
UNMEASURED = 0.4
"""The same of leakage where nobody measures the oil's temperature: 10 K."""
RELIEF_OPEN = 0.5
"""Standard deviation of ln, of a relief setting that is passed."""


@dataclass
class Judgement:
    """Whether a profile may be used: clauses why not, what a user must know of it, what would help."""

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
    found: Identification, unit: Unit, base: Unit, logs: Sequence[Samples], labels: Sequence[str]
) -> Judgement:
    """Judge a new profile `unit`, with its baseline, that was `found` from all `logs` and made from `base`.

    Refused is what has another unit of measure, lies farther from the base than data sheets and
    manufacturing leave open, or was not healthy all along; at most 2 % of healthy sets are by chance.
    """
    out = Judgement()
    ratios = against_base(found, base)
    for samples, label in zip(logs, labels, strict=True):
        values = samples.get("oil_temperature")
        values = values[np.isfinite(values)]
        if values.size and not COLDEST <= (middle := float(np.median(values))) <= HOTTEST:
            read = {u: MEASURES[u].factor * middle + MEASURES[u].offset for u in ("K", "degF")}
            looks = next((u for u, celsius in read.items() if COLDEST <= celsius <= 90.0), None)
            hint = f": it looks like {looks} read as degC" if looks else ""
            out.refusals.append(f"{label}: oil at {middle:.0f} °C{hint}")
    slip = pressure_slip(ratios, push_of(logs, base))
    if slip is not None:
        out.refusals.append(slip)
    else:
        _far(out, ratios, base)
    compared: list[Comparison] = []
    if not out.refusals:  # of a wrong unit or base the rest only follows
        compared = disagreement(found.unit, logs, labels)
        out.refusals += [c.sentence for c in compared if c.refused]
        for text, sure in _unhealthy(unit, logs, labels):
            (out.refusals if sure else out.limits).append(text)
    _open_questions(out, found, ratios, compared, len(logs), base)
    return out


@dataclass(frozen=True)
class Comparison:
    """One quantity over the logs that tell it: the chance of their scatter; what disagrees, in words."""

    p_value: float
    sentence: str

    @property
    def refused(self) -> bool:
        """Whether the logs disagree."""
        return self.p_value < DISAGREEING / len(BETWEEN)


def disagreement(unit: Unit, logs: Sequence[Samples], labels: Sequence[str]) -> list[Comparison]:
    """Compare what each log of a `unit` alone identifies, by a chi-square test of each quantity."""
    if len(logs) < 2:
        return []
    each = [alone(log, unit, label, UNMEASURED) for log, label in zip(logs, labels, strict=True)]

    def scatter(x: np.ndarray, weight: np.ndarray) -> float:
        return float(np.sum(weight * (x - np.average(x, weights=weight)) ** 2))

    out = []
    for name, (between, _) in BETWEEN.items():
        told = [(label, found[name]) for label, found in zip(labels, each, strict=True) if name in found]
        if len(told) < 2:
            continue
        # Not the logarithm: that of a leakage which a log can hardly tell from none has no normal law.
        x = np.array([r.value for _, r in told])
        std = x * [r.std for _, r in told]
        weight, quantity = 1.0 / (std**2 + between**2), WORDS[name]
        p_value = float(chdtrc(x.size - 1, scatter(x, weight)))
        odd = int(np.argmin([scatter(np.delete(x, i), np.delete(weight, i)) for i in range(x.size)]))
        others = np.average(np.delete(x, odd), weights=np.delete(weight, odd))
        times = float(x[odd] / others) if others > 0.0 else np.inf
        if x.size > 2:
            said = f"{told[odd][0]} disagrees with the others: {quantity} is {times:.3g} times theirs"
        else:
            said = f"{told[0][0]} and {told[1][0]} disagree: {quantity} differs by a factor of {times:.3g}"
        out.append(Comparison(p_value, said))
    return sorted(out, key=lambda c: c.p_value)


def alone(samples: Samples, unit: Unit, label: str, unmeasured: float = 0.6) -> dict[str, Ratio]:
    """What this log alone identifies over the profile's, and any relief setting that it passes; see
    `against_base`."""
    try:
        found = identify_unit([samples], unit, labels=[label])
    except InputError:  # too short, or the pump hardly turns: it tells nothing
        return {}
    ratios = against_base(found, unit, unmeasured)
    for row in found.table:
        if row.quantity == "accumulator.relief_pressure" and row.identified is not None:
            # A valve passes a little more than its setting; how far beyond, tells the pressures' scale.
            ratios[row.quantity] = Ratio(row.identified / row.base / RELIEF_EXCEEDED, 0.2, RELIEF_OPEN)
    return ratios


def pressure_slip(ratios: dict[str, Ratio], push: float = 1.0) -> str | None:
    """The unit of measure in which the pressures were read by mistake, in words; None where none was.

    All that goes with the pressures' size, `ratios` of `against_base`, is weighed together: a slip's factor
    against what units of one kind differ by. A piston that moves both ways needs its friction's force at
    least, whatever the load: `push` is the pressures' over it, see `push_of`.
    """

    def misfit(factor: float) -> float:
        lacking = min(log(push) - log(factor), 0.0) / TOLERANCES["friction"][0]
        return lacking**2 + sum(ratios[n].misfit(factor**sign) for n, sign in SCALES.items() if n in ratios)

    sizes = _sizes("pressure")
    factors = sorted({round(a / b, 9) for a in sizes for b in sizes if a != b}, key=misfit)
    best = factors[0]
    if misfit(1.0) - misfit(best) < ODDS:
        return None
    looks = dict.fromkeys(slips(f, "pressure") for f in factors if misfit(f) < misfit(best) + ALIKE)
    told = [f"{WORDS[n]} {ratios[n].value:.3g} times the base's" for n in SCALES if n in ratios]
    told += [f"their force {push:.3g} times the friction"] if push < 1.0 else []
    return (
        f"the pressures look {best:.3g} times what they should be, as {' or '.join(looks)} are "
        f"({', '.join(told)}); check their unit in the channel map"
    )


def push_of(logs: Sequence[Samples], base: Unit) -> float:
    """Force of the pressures, root mean square over the logs, over the base's friction."""
    squares = []
    for each in logs:
        drops = (each.get("pressure_difference"), each.get("pressure_1") - each.get("pressure_2"))
        # A column may be empty: the largest of what is told.
        told = [float(np.mean(d[np.isfinite(d)] ** 2)) for d in drops if np.isfinite(d).any()]
        squares.append(max(told, default=0.0))
    friction = 0.5 * (base.friction.forward.coulomb + base.friction.reverse.coulomb)
    force = base.cylinder.area_1 * np.sqrt(np.mean(squares))
    return max(float(force), 1e-9) / friction if friction > 0.0 else 1.0


def _far(out: Judgement, ratios: dict[str, Ratio], base: Unit) -> None:
    sure = float(chdtri(1, FALSE_REFUSAL / len(WORDS)))
    for name, ratio in ratios.items():
        told = f"{WORDS[name]} is {ratio.value:.3g} times that of base {base.name}"
        travel, slip = name == "pump.displacement", ""
        if travel:  # a slip that explains it better than the base's tolerance does
            sizes = [_sizes(dimension) for dimension in ("length", "angle", "angular_speed")]
            best = min((a / b for each in sizes for a in each for b in each if a != b), key=ratio.misfit)
            slip = gain_slips(best) if ratio.misfit() - ratio.misfit(best) > ODDS else ""
        if slip or ratio.misfit() > sure:
            factor, why = exp(sqrt(sure) * ratio.open), TOLERANCES[name][1]
            out.refusals.append(
                f"{told}, which leaves a factor of {factor:.2g} open ({why}){slip}; check the base and the "
                "units in the channel map"
            )
        elif travel and ratio.misfit() > OTHER_SIZE**2:
            out.limits.append(f"{told}: the next size, or another base would fit better")


def _sizes(dimension: str) -> list[float]:
    """What the units of one dimension are in SI."""
    return sorted({m.factor for m in MEASURES.values() if m.dimension == dimension})


def _open_questions(
    out: Judgement, found: Identification, ratios: dict[str, Ratio], compared: list[Comparison], logs: int,
    base: Unit,
) -> None:  # fmt: skip
    leakage = ratios.get("pump.leakage")
    if leakage is not None and not 1.0 / WORTH_SAYING < leakage.value < WORTH_SAYING:
        which = "worn" if leakage.value > 1.0 else "differently built"
        out.limits.append(
            f"leakage is {leakage.value:.3g} times that of base {base.name}: a healthy unit of this kind, or "
            f"a {which} one; compare with the maker's sheet"
        )
    if logs == 1:
        out.remarks.append("one log: whether this unit's logs agree cannot be told; give several")
    elif not compared:
        out.limits.append("no quantity is sharp in two logs: whether they agree cannot be told")
    kept = {r.quantity for r in found.table if r.identified is None}
    for path, words in (
        ("pump.displacement", "travel per rad of the pump"), ("pump.cross_port_leakage", "leakage"),
        ("oil.bulk_modulus", "bulk modulus"), ("friction.forward.coulomb", "friction extending"),
        ("friction.reverse.coulomb", "friction retracting"),
    ):  # fmt: skip
        if path in kept:
            out.limits.append(f"{words} stays the base's, the logs do not excite it")


def _unhealthy(unit: Unit, logs: Sequence[Samples], labels: Sequence[str]) -> list[tuple[str, bool]]:
    """What the pipeline finds wrong in the logs, and whether that is sure.

    A fault that comes within a log, or a sensor's, shows even though the log is part of the profile. It is
    sure where a sensor failed, or where the log's parts before and after disagree when each is identified by
    itself: what the balances alone say of another maker's unit is no more than a doubt.
    """
    strict = unit.model_copy(deep=True)
    hours = sum(each.duration for each in logs) / 3600.0
    # Where the alarm rate of the exponential tail gives 0.01 alarms in all of these hours.
    strict.monitoring.false_alarms_per_hour = FALSE_ALARMS / max(hours, 1e-3) / 3600.0
    out = []
    for each, label in zip(logs, labels, strict=True):
        pipeline = Pipeline(strict, keep_trajectories=False)
        pipeline.push(each)
        answer = pipeline.finish()
        if answer.verdict != "faulty":
            continue
        first = answer.faults[0]
        channel = f" of {first.channel}" if first.channel else ""
        name = f"{fault(first.fault).title.lower()}{channel}"
        sure = first.fault in ("sensor_dropout", "position_sensor_slip")
        cut = int(np.searchsorted(each.time, first.onset_s))
        parts = [each.rows(0, cut), each.rows(cut, len(each))]
        if not sure and min(part.duration for part in parts) >= SHORTEST_PART:
            sure = any(c.refused for c in disagreement(unit, parts, [f"{label} before", f"{label} after"]))
        out.append((f"{label} does not look healthy: {name} since {first.onset_s:.1f} s", sure))
    return out
