"""A number of the thesis beside the plant's, and how both are shown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Figures = dict[str, Any]
"""What an experiment measured, by the names that its block of the template has; ``picture`` is its panels."""

READING = 0.05
"""Relative deviation allowed where the thesis gives no spread: its plots cannot be read closer."""


@dataclass(frozen=True)
class Row:
    """One number of the thesis beside the plant's.

    Attributes
    ----------
    what, where : quantity, and section, equation or table of the thesis.
    thesis, plant : values in `unit`.
    unit : as it is to be shown.
    tolerance : allowed distance in `unit`; None for `READING` of the thesis's value.
    why : the reason, shown where the row does not meet.
    note : what a reader must know in any case; may be empty.
    digits : significant ones to show.

    Examples
    --------
    >>> Row("gain", "5.1", 2.0, 2.05, "m").verdict, Row("gain", "5.1", 2.0, 2.2, "m").deviation
    ('meets', '+10.0 %')
    """

    what: str
    where: str
    thesis: float
    plant: float
    unit: str
    tolerance: float | None = None
    why: str = ""
    note: str = ""
    digits: int = 3

    @property
    def allowed(self) -> float:
        """Largest distance that meets, in `unit`."""
        return READING * abs(self.thesis) if self.tolerance is None else self.tolerance

    @property
    def verdict(self) -> Literal["meets", "does not meet"]:
        """Whether the plant's value lies within the tolerance; NaN does not."""
        return "meets" if abs(self.plant - self.thesis) <= self.allowed else "does not meet"

    @property
    def deviation(self) -> str:
        """Relative to the thesis, in percent, or as a factor where it is off by more than three."""
        if self.plant != self.plant:
            return "none found"
        ratio = self.plant / self.thesis
        if ratio > 3.0 or 0.0 < ratio < 1.0 / 3.0:
            return f"× {ratio:.2g}"
        percent = round(100.0 * (ratio - 1.0), 1)
        return f"{percent:+.1f} %" if percent else "0.0 %"

    def cells(self) -> list[str]:
        """As the tables show it."""
        return [
            self.what,
            self.where,
            number_text(self.thesis, self.digits),
            number_text(self.plant, self.digits),
            "" if self.unit == "1" else self.unit,
            self.deviation,
            self.verdict if self.verdict == "meets" else f"**{self.verdict}**",
        ]


def number_text(number: float, digits: int = 3) -> str:
    """A number with its significant digits, without an exponent where it reads well, never ``-0``.

    Examples
    --------
    >>> number_text(33750.0), number_text(0.00110, 2), number_text(3.6e-12), number_text(105.64)
    ('33800', '0.0011', '3.6e-12', '106')
    """
    if number != number:
        return "none"
    if number == 0.0:
        return "0"
    if 1e-4 <= abs(number) < 10.0**digits:
        places = max(digits - 1 - int(f"{number:.{digits - 1}e}".split("e")[1]), 0)
        return f"{number:.{places}f}"
    if 10.0**digits <= abs(number) < 1e6:
        return f"{float(f'{number:.{digits}g}'):.0f}"
    return f"{number:.{digits}g}"
