"""The result of an identification: the new profile, and the table of what changed and what did not."""

from __future__ import annotations

from dataclasses import dataclass, field

from fdd.identification.balance import Estimate
from fdd.identification.sensors import SensorFit
from fdd.samples import CHANNELS
from fdd.sections import Provenance, Section, si_of
from fdd.unit import Unit


@dataclass(frozen=True)
class TableRow:
    """One line of the table that ``fdd identify`` prints.

    `identified` and `std` are None where the base's value is kept; `note` then says why.
    """

    quantity: str
    unit: str
    base: float
    identified: float | None
    std: float | None
    note: str = ""


@dataclass
class Identification:
    """Result of `identify_unit`.

    Attributes
    ----------
    unit : the base's copy with the identified numbers, each with source and standard deviation.
    table : what changed and what did not.
    notes : one sentence each: what was kept and why, what the numbers rest on.
    leakage : total of cross-port and half the case leakage; None where it stays the base's.
    balances : of logs that were added to a profile: its healthy balances before and after.
    """

    unit: Unit
    table: list[TableRow] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    balances: list[TableRow] = field(default_factory=list)
    leakage: Estimate | None = None


class ProfileWriter:
    """Puts numbers into the profile, with provenance, and keeps the table."""

    def __init__(self, unit: Unit, base: Unit, source: str) -> None:
        self.result = Identification(unit)
        self.base = base
        self.source = source

    def note(self, text: str) -> None:
        """Add a sentence to the result's notes."""
        self.result.notes.append(text)

    def put(self, path: str, estimate: Estimate, note: str = "") -> None:
        """Set the number at a dotted path, with its source and standard deviation (SI)."""
        section, name, before = self._find(path)
        setattr(section, name, float(estimate.value))
        section.provenance[name] = Provenance(source=self.source, std=float(estimate.std))
        self._row(path, section, name, before, estimate, note)

    def decide(self, path: str, value: bool, why: str) -> None:
        """Set what is or is not so at a dotted path, 1 or 0 in the table, and say why."""
        section, name, before = self._find(path)
        setattr(section, name, value)
        section.provenance[name] = Provenance(source=self.source)
        self.result.table.append(TableRow(path, "1", before, float(value), None, why))

    def keep(self, path: str, why: str) -> None:
        """Leave the base's number and say why."""
        section, name, before = self._find(path)
        self._row(path, section, name, before, None, why)
        self.note(f"{path} kept: {why}")

    def _find(self, path: str) -> tuple[Section, str, float]:
        *way, name = path.split(".")
        section: Section | Unit = self.result.unit
        for step in way:
            section = getattr(section, step)
        assert isinstance(section, Section)
        return section, name, float(getattr(section, name))

    def _row(
        self, path: str, section: Section, name: str, before: float, found: Estimate | None, note: str
    ) -> None:
        si = si_of(type(section).model_fields[name])
        self.result.table.append(
            TableRow(
                path,
                si.unit if si is not None else "1",
                before,
                None if found is None else float(found.value),
                None if found is None else float(found.std),
                note,
            )
        )

    def put_sensor(self, channel: str, fit: SensorFit) -> None:
        """Replace a channel's sensor; a row for each of its numbers that was found."""
        before = self.base.sensor(channel)
        sensor = fit.sensor.model_copy(update={"source": self.source})
        self.result.unit.sensors[channel] = sensor
        notes = {
            "noise": "white noise with the same density below 100 Hz",
            "zero": "against pressure_1 - pressure_2",
        }
        for what in fit.found:
            value = float(getattr(sensor, what))
            unit = CHANNELS[channel].unit
            self.result.table.append(
                TableRow(
                    f"sensors.{channel}.{what}",
                    unit,
                    float(getattr(before, what)),
                    value,
                    None,
                    notes.get(what, "smallest step"),
                )
            )
