"""What a fault looks like in the balances: its change of their coefficients, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

Columns = dict[str, dict[str, float]]
"""Balance to column to change of that column's coefficient at severity 1."""


class Healthy(Protocol):
    """What a signature may ask about the healthy unit."""

    @property
    def leakage_ratio(self) -> float:
        """Internal leakage of severity 1 over the healthy one."""

    @property
    def speed_ratio(self) -> float:
        """Largest speed of the drive over 100 rad/s."""

    def mean(self, balance: str, column: str) -> float:
        """Coefficient of that column while the unit is healthy."""


@dataclass(frozen=True)
class Signature:
    """One way in which a fault shows.

    Attributes
    ----------
    label : for people; unique within the fault.
    columns : from the healthy unit to what changes.
    side, variant : of the fault, where the signature tells them.
    signed : the amplitude is a severity and cannot be negative.
    channel : the sensor at fault.
    courses : in time, of step, ramp and drift; a step may also come and go.
    commonness : weight among faults that look alike in a log: how often the part fails, with how many there
        are.
    """

    label: str
    columns: Callable[[Healthy], Columns]
    side: int | None = None
    variant: str | None = None
    signed: bool = True
    channel: str | None = None
    courses: tuple[str, ...] = ("step", "ramp")
    commonness: float = 1.0
