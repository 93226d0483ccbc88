"""The thesis's experiments of chapters 5 and 6 on logs of one's own: what they tell, and how surely.

Here is what each hands back: figures with intervals, what the log does not tell, and what to draw.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np

from fdd.identification import Array
from fdd.report import traces as tr
from fdd.report.page import Sheet, Table
from fdd.report.plots import Figure, Section

NORMAL_95 = 1.96
"""Standard deviations either side that hold 95 %."""
MOST_POINTS = 3000
SHOWN = {
    "m^3/rad": (2e6 * pi, "cm³/turn"), "m^3/(s*Pa)": (1e12, "1e-12 m³/(s·Pa)"), "Pa": (1e-5, "bar"),
    "m^3": (1e6, "cm³"), "m^2": (1e4, "cm²"), "degC": (1.0, "°C"), "1": (1.0, ""),
    "m^3/s": (6e7, "mL/min"), "m/s": (1e3, "mm/s"), "m/rad": (2e3 * pi, "mm/turn"), "N*s/m": (1.0, "N·s/m"),
    "rad": (180.0 / pi, "°"), "rad/s": (30.0 / pi, "rpm"),
    "m^3/(s*Pa^0.5)": (6e7 * 1e5**0.5, "mL/min/√bar"),
}  # fmt: skip
"""SI unit to factor and unit for people."""


def figure(value: float) -> str:
    """Four figures, without an exponent below ten million.

    Examples
    --------
    >>> figure(0.00123456), figure(12345.6)
    ('0.001235', '12350')
    """
    text = f"{value:.4g}"
    return f"{float(text):.0f}" if 1e4 <= abs(value) < 1e7 else text


@dataclass(frozen=True)
class Told:
    """One figure with its 95 % interval, SI, and a remark such as what the profile says."""

    quantity: str
    value: float
    low: float
    high: float
    unit: str
    note: str = ""

    @staticmethod
    def within(quantity: str, value: float, half: float, unit: str, note: str = "") -> Told:
        """With an interval of `half` on either side."""
        return Told(quantity, value, value - half, value + half, unit, note)

    def shown(self) -> tuple[str, str, str, str]:
        """Value, both ends of the interval, and unit, as people read them.

        Examples
        --------
        >>> Told.within("leakage", 6.5e-12, 1.96e-13, "m^3/(s*Pa)").shown()
        ('6.5', '6.304 … 6.696', '1e-12 m³/(s·Pa)', '')
        """
        factor, unit = SHOWN.get(self.unit, (1.0, self.unit))
        value, low, high = (figure(factor * x) for x in (self.value, self.low, self.high))
        return value, f"{low} … {high}", unit, self.note


@dataclass
class Outcome:
    """The answer of one experiment.

    Attributes
    ----------
    not_told : what the log does not excite, one sentence each. notes : what else to know.
    heads, rows : a table beside the figures, as text. figures : of the page.
    curves : what the figures show, for ``--json``: name to columns, SI.
    """

    kind: str
    title: str
    told: list[Told] = field(default_factory=list)
    not_told: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    heads: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    curves: dict[str, dict[str, Array]] = field(default_factory=dict)

    def tell(self, quantity: str, value: float, std: float, unit: str, note: str = "") -> None:
        """Add a figure by its standard deviation."""
        self.told.append(Told.within(quantity, value, NORMAL_95 * std, unit, note))

    def as_data(self) -> dict[str, Any]:
        """What ``--json`` writes; JSON lacks NaN."""

        def plain(column: Array) -> list[float | None]:
            return [float(v) if np.isfinite(v) else None for v in column]

        return {
            "schema": "fdd.experiment/1",
            "experiment": self.kind,
            "told": [{"quantity": t.quantity, "value": t.value, "interval": [t.low, t.high], "unit": t.unit,
                      "note": t.note} for t in self.told],
            "not_told": self.not_told,
            "notes": self.notes,
            "table": [dict(zip(self.heads, row, strict=True)) for row in self.rows],
            "curves": {name: {k: plain(v) for k, v in c.items()} for name, c in self.curves.items()},
        }  # fmt: skip

    def sheet(self, logs: list[str], unit: str) -> Sheet:
        """What people see of it, on a page and at a terminal: of these logs, beside this profile."""
        told: list[tuple[str, ...]] = [(t.quantity, *t.shown()) for t in self.told]
        heads = ("quantity", "value", "95 %", "unit", "remark")
        listed = [t for t in (("Figures", heads, told), ("In detail", self.heads, self.rows)) if t[2]]
        how = [" ".join(self.notes), ""]  # beside the first table, whichever that is
        tables = [Table(*t, note=note, numbers=False) for t, note in zip(listed, how, strict=False)]
        return Sheet(
            kicker=f"{', '.join(logs)}, profile {unit}", headline=self.title,
            kind="plain" if told else "inconclusive",
            remarks=[f"Not told: {sentence}" for sentence in self.not_told] + ([] if tables else self.notes),
            tables=tables, sections=[Section("Plots", "", self.figures)],
        )  # fmt: skip


def points(x: Array, y: Array, low: Array, high: Array, name: str, colour: str) -> tr.Trace:
    """Points with their intervals, already in the units of the figure."""
    reach = {"array": tr.packed(high - y), "arrayminus": tr.packed(y - low)}
    bars = {"type": "data", "symmetric": False, **reach, "thickness": 1.2, "width": 3}
    marker = {"color": colour, "size": 6}
    return tr.scatter(tr.packed(x), tr.packed(y), name, mode="markers", error_y=bars, marker=marker)


def cloud(x: Array, y: Array, name: str, colour: str) -> tr.Trace:
    """Many small points, at most `MOST_POINTS`."""
    thin = max(-(-x.size // MOST_POINTS), 1)
    marker = {"color": colour, "size": 3, "opacity": 0.35}
    shown = tr.packed(x[::thin]), tr.packed(y[::thin])
    return tr.scatter(*shown, name, mode="markers", marker=marker, hoverinfo="skip")


def curve_line(x: Array, y: Array, name: str, colour: str, dash: str = "solid") -> tr.Trace:
    """A line through all its points."""
    style = {"color": colour, "width": 1.8, "dash": dash}
    return tr.scatter(tr.packed(x), tr.packed(y), name, line=style)


def axes(x: str, **more: Any) -> dict[str, Any]:
    """Layout with the abscissa's title; `more` goes into its axis."""
    return {"xaxis": {"title": {"text": x, "standoff": 4}, **more}, "hovermode": "closest"}
