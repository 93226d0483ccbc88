"""A unit's own profile from its healthy logs: the thesis's chapters 5 and 6.

Here is what all of its modules share: estimates and the fits that give them, the profile that they make with
the table of what changed, and what they are over the base.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.oil import modulus_at, viscosity
from fdd.samples import CHANNELS
from fdd.sections import Provenance, Section, si_of
from fdd.tolerances import tolerance
from fdd.unit import Unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation, both SI."""

    value: float
    std: float

    @property
    def relative(self) -> float:
        """Standard deviation over value."""
        return self.std / abs(self.value) if self.value else float("inf")

    def wider(self, share: float) -> Estimate:
        """With `share` of the value, another standard deviation, beside its own."""
        return Estimate(self.value, float(np.hypot(self.std, share * self.value)))


def huber(
    m: Array, y: Array, limit: float, *, rounds: int = 10, least: float = 0.0, rcond: float | None = None
) -> tuple[Array, Array]:
    """Least squares of `m` (n, k) to `y` (n,) with a Huber loss: (k,) solution, (n,) roots of the weights.

    A residual counts less from `limit` robust standard deviations on; `least`, as `y`, is there in any case.
    """
    largest = np.abs(m).max(axis=0)
    scale = np.where(largest > 0.0, largest, 1.0)
    scaled, weights = m / scale, np.ones(y.size)
    for _ in range(rounds):
        theta = np.linalg.lstsq(scaled * weights[:, None], y * weights, rcond=rcond)[0]
        residual = np.abs(y - scaled @ theta)
        sigma = 1.4826 * np.median(residual) + least
        weights = np.sqrt(np.minimum(1.0, limit * sigma / np.maximum(residual, 1e-30)))
    return theta / scale, weights


def jackknife_std(parts: Array) -> Array:
    """Standard deviation of an estimate from (n, ...) ones that each lack one of n groups.

    Examples
    --------
    >>> values = np.array([1.0, 2.0, 6.0])
    >>> means = np.array([np.delete(values, k).mean() for k in range(3)])
    >>> bool(np.isclose(jackknife_std(means), values.std(ddof=1) / np.sqrt(3)))
    True
    """
    n = len(parts)
    return np.asarray(np.sqrt((n - 1) / n * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0)))


@dataclass(frozen=True)
class TableRow:
    """One line of the table that ``fdd identify`` prints; `note` says why a base's value is kept."""

    quantity: str
    unit: str
    base: float
    identified: float | None
    std: float | None
    note: str = ""


@dataclass
class Identification:
    """Result of `identify_unit`: puts numbers into the profile, with provenance, and keeps the table."""

    unit: Unit
    """The base's copy with the identified numbers, each with `source` and standard deviation."""
    base: Unit
    source: str
    table: list[TableRow] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """One sentence each: what was kept and why, what the numbers rest on."""
    leakage: Estimate | None = None
    """Total of cross-port and half the case leakage; None where it stays the base's."""

    def put(self, path: str, estimate: Estimate, note: str = "") -> None:
        """Set the number at a dotted path, SI."""
        section, name, row = self._find(path)
        value, std = float(estimate.value), float(estimate.std)
        setattr(section, name, value)
        section.provenance[name] = Provenance(source=self.source, std=std)
        self.table.append(replace(row, identified=value, std=std, note=note))

    def decide(self, path: str, value: bool, why: str) -> None:
        """Set what is or is not so at a dotted path, 1 or 0 in the table, and say why."""
        section, name, row = self._find(path)
        setattr(section, name, value)
        section.provenance[name] = Provenance(source=self.source)
        self.table.append(replace(row, identified=float(value), note=why))

    def keep(self, path: str, why: str) -> None:
        """Leave the base's number and say why."""
        self.table.append(replace(self._find(path)[2], note=why))
        self.notes.append(f"{path} kept: {why}")

    def _find(self, path: str) -> tuple[Section, str, TableRow]:
        """The section and the name of the number at a path, and its row as long as it is kept."""
        *way, name = path.split(".")
        section: Section | Unit = self.unit
        for step in way:
            section = getattr(section, step)
        assert isinstance(section, Section)
        si, before = si_of(type(section).model_fields[name]), float(getattr(section, name))
        return section, name, TableRow(path, "1" if si is None else si.unit, before, None, None)

    def put_sensor(self, channel: str, fit: dict[str, float]) -> None:
        """Put what was found into a channel's sensor; a row for each number."""
        before, unit = self.base.sensor(channel), CHANNELS[channel].unit
        # What was found stands for itself: the base's counts or current loop, or tones, are another unit's.
        replaced = {"lines": None, "loop": None} if "resolution" in fit else {}
        spectrum: dict[str, object] = {"bandwidth_hz": None, "tones": []} if "noise" in fit else {}
        update = {**replaced, **spectrum, **fit, "source": self.source}
        self.unit.sensors[channel] = before.model_copy(update=update)
        notes = {
            "noise": "white noise with the same density below 100 Hz",
            "zero": "against pressure_1 - pressure_2",
        }
        for what, value in fit.items():
            known, note = float(getattr(before, what)), notes.get(what, "smallest step")
            self.table.append(TableRow(f"sensors.{channel}.{what}", unit, known, value, None, note))


WORDS = {
    "pump.displacement": "travel per rad of the pump", "cylinder.area_2": "area_2",
    "pump.leakage": "leakage", "oil.bulk_modulus": "bulk modulus", "friction": "friction",
    "drive.torque_constant": "torque constant", "accumulator.charge_pressure": "charge pressure",
    "accumulator.relief_pressure": "pressure beyond the relief setting", "noise": "their noise",
    "counts": "their counts",
}  # fmt: skip
"""What identifies a pressure's scale or a unit, in words."""


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


def against_base(found: Identification, base: Unit, unmeasured: float = 0.6) -> dict[str, Ratio]:
    """What was identified over what the base leads to expect, by the names of `WORDS`.

    Leakage is compared at the logs' temperature, bulk modulus at their pressure; friction as the mean of both
    directions. Where nobody measures the oil's temperature leakage has a relative standard deviation of
    `unmeasured` more: it may be 15 K off, at some 4 % a kelvin.
    """
    rows = {r.quantity: r for r in found.table if r.identified is not None and r.std is not None}
    unit = found.unit
    direct = ("pump.displacement", "cylinder.area_2", "drive.torque_constant", "accumulator.charge_pressure")
    out = {n: _ratio(rows[n], n, rows[n].base, base) for n in direct if n in rows and rows[n].base > 0.0}
    leakage = found.leakage
    if leakage is not None and base.pump.total_leakage > 0.0:
        warm = unit.oil.reference_temperature, base.oil.reference_temperature
        thinner = float(viscosity(base.oil, warm[1]) / viscosity(base.oil, warm[0]))
        out["pump.leakage"] = Ratio(
            leakage.value / (base.pump.total_leakage * thinner),
            float(np.hypot(leakage.relative, 0.0 if "oil.reference_temperature" in rows else unmeasured)),
            tolerance(base, "pump.leakage"),
        )  # fmt: skip
    if "oil.bulk_modulus" in rows:
        expected = modulus_at(base.oil, unit.oil.reference_pressure)
        out["oil.bulk_modulus"] = _ratio(rows["oil.bulk_modulus"], "oil.bulk_modulus", expected, base)
    branches = [rows[n] for d in ("forward", "reverse") if (n := f"friction.{d}.coulomb") in rows]
    each = [_ratio(b, "friction", b.base, base) for b in branches if b.base > 0.0 and b.identified]
    if each:
        mean = exp(float(np.mean([log(r.value) for r in each])))
        out["friction"] = Ratio(mean, max(r.std for r in each), each[0].open)
    return out


def _ratio(row: TableRow, name: str, expected: float, base: Unit) -> Ratio:
    assert row.identified is not None and row.std is not None
    std = row.std / max(row.identified, 1e-300)
    return Ratio(max(row.identified / expected, 1e-12), std, tolerance(base, name))
