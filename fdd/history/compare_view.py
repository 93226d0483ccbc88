"""A comparison for people: tables for terminal and page, and the spectra's plots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED
from fdd.history.answers import Closure, Comparison, DutyRow, EstimateChange, Line, LogSaid
from fdd.history.compare import NO_CHANGE
from fdd.history.spectra import Spectrum
from fdd.report import traces as tr
from fdd.report.plots import TO_RPM, Figure, Section
from fdd.report.sheet import Sheet, Table
from fdd.report.tables import NOTHING, number, with_std
from fdd.report.words import candidates, percent, seconds, span
from fdd.residuals.balances import BALANCES
from fdd.samples import CHANNELS

SHOWN = {"m": (1e3, "mm"), "Pa": (1e-5, "bar"), "rad/s": (TO_RPM, "rpm"), "N": (1e-3, "kN")}
"""SI unit of a signal to factor and unit for people."""


def compare_sheet(found: Comparison, spectra: Sequence[Spectrum]) -> Sheet:
    """The page of a comparison."""
    quiet = found.headline == NO_CHANGE
    blind = all(c.changed is None for c in found.estimates)
    return Sheet(
        kicker=f"{found.a.log} (A) and {found.b.log} (B), unit {found.unit}, axis {found.axis}",
        headline=found.headline,
        kind="inconclusive" if quiet and blind else "healthy" if quiet else "faulty",
        remarks=[*verdict_lines(found), *found.notes],
        tables=compare_tables(found),
        sections=[
            Section("Spectra", "Welch's power density of what both logs measure, segments of 2 s.",
                    [_figure(s) for s in spectra])
        ],
    )  # fmt: skip


def compare_tables(found: Comparison) -> list[Table]:
    """Estimates, balances, duty and spectral lines."""
    changed = {k for k, c in enumerate(found.estimates) if c.changed}
    given = [f"{ESTIMATED[c.quantity][2].lower()} {c.conditions}" for c in found.estimates if c.conditions]
    conditions = "; ".join(given)
    tables = [
        Table(
            "Estimates at the end", ("Quantity", "A ± std", "B ± std", "B − A ± std", "Changed, p"),
            [_estimate(c) for c in found.estimates],
            f"{conditions[:1].upper() + conditions[1:]}. Test: {found.test}.", marked=changed,
        ),
        Table(
            "How well the balances close", ("Balance", "A", "B", "B over A"),
            [_balance(c) for c in found.balances],
            "Root mean square of each balance's misfit over the log, in what the profile's healthy one is: "
            "about 1 while healthy.",
        ),
        Table(
            "Duty", ("Signal", "Unit", "A", "B"), [_duty(row) for row in found.duty],
            "5th, 50th and 95th percentile, of speeds, pressures, current and load as magnitudes. "
            "Another duty explains much that differs.",
        ),
        Table(
            "Spectral lines that changed most",
            ("Channel", "Frequency", "Shaft order", "B over A", "Beyond chance"),
            [_line(x) for x in found.lines],
            "Against the frequencies around, 1 % over all of them (F test). No order where the speed varies.",
            marked={k for k, x in enumerate(found.lines) if x.beyond_chance},
        ),
    ]  # fmt: skip
    return [t for t in tables if t.rows]


def _line(x: Line) -> tuple[str, ...]:
    times = f"{number(x.ratio, 3)} times ({10.0 * np.log10(x.ratio):+.0f} dB)".replace("-", "−")
    told = "yes" if x.beyond_chance else "no"
    return x.channel.replace("_", " "), f"{x.frequency_hz:.1f} Hz", number(x.order), times, told


def _balance(c: Closure) -> tuple[str, ...]:
    title = BALANCES[c.balance].title if c.balance in BALANCES else c.balance
    return title, number(c.a, 3), number(c.b, 3), number(c.b / c.a if c.a and c.b else None, 3)


def _estimate(change: EstimateChange) -> tuple[str, ...]:
    _, unit, title = ESTIMATED[change.quantity]
    k = DISPLAY_SCALE[change.quantity]
    pairs = ((change.a, change.a_std), (change.b, change.b_std), (change.difference, change.std))
    texts = [NOTHING if v is None or std is None else with_std(v * k, std * k) for v, std in pairs]
    told = {True: "yes, ", False: "no, ", None: "not shown"}[change.changed]
    p = "" if change.p_holm is None else number(change.p_holm, 2)
    return f"{title} ({unit})", *texts, told + p


def _duty(row: DutyRow) -> tuple[str, ...]:
    factor, unit = SHOWN.get(row.unit, (1.0, row.unit))

    def shown(value: float) -> str:
        return number(value, 3) if abs(value) < 1e3 else number(round(value), 9)

    texts = [NOTHING if x is None else ", ".join(shown(v * factor) for v in x) for x in (row.a, row.b)]
    return row.signal.replace("_", " "), unit, *texts


def verdict_lines(found: Comparison) -> list[str]:
    """What was found in either log, in a line each."""
    return [f"{name}: {said.log}, {_verdict(said)}" for name, said in (("A", found.a), ("B", found.b))]


def _verdict(said: LogSaid) -> str:
    found = [
        f"{candidates(f)} since {seconds(f.onset_s)}"
        + ("" if f.severity is None else f", severity {f.severity:.2f}")
        + f", {percent(f.confidence)} sure"
        for f in said.faults
    ]
    return f"{said.verdict} in {span(said.duration_s)}" + (f": {'; '.join(found)}" if found else "")


def _figure(spectrum: Spectrum) -> Figure:
    si = CHANNELS[spectrum.channel].unit
    factor, unit = SHOWN.get(si, (1.0, si))
    data = [
        tr.line(spectrum.frequency, factor**2 * values, name, colour, width=1.2)
        for values, name, colour in ((spectrum.a, "A", tr.BLUE), (spectrum.b, "B", tr.VERMILLION))
    ]
    layout = tr.layout("frequency (Hz)", type="log", hoverformat=".3~g", exponentformat="power")
    layout["xaxis"]["hoverformat"] = ".1f"
    title = spectrum.channel.replace("_", " ").capitalize()
    return Figure(f"spectrum-{spectrum.channel}", title, data, layout, f"{unit}²/Hz")
