"""What ``fdd identify`` prints: may the profile be used, what changed, and on wish everything behind it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table
from rich.text import Text

from fdd.cli.console import output
from fdd.identify.experiments.outcome import NORMAL_95, SHOWN

if TYPE_CHECKING:
    from fdd.identify import Identification
    from fdd.identify.judgement import Judgement
    from fdd.identify.noise import NoiseFit
    from fdd.identify.profile import TableRow
    from fdd.unit import Unit

WIDE = 120
"""Columns of a terminal that has room for notes."""


def print_result(
    found: Identification, judged: Judgement, unit: Unit, fit: NoiseFit | None, out: Path, *, verbose: bool
) -> None:
    """Print the verdict, the table, and with `verbose` sensors, noise, innovations and notes."""
    console = output()
    wide = console.width >= WIDE
    accepted = " (accepted)" if judged.refusals else ""
    console.print(Text(judged.sentence + accepted), soft_wrap=True)
    console.print(physics_table(found, sensors=verbose, notes=verbose and wide))
    if verbose:
        if fit is not None:
            console.print(noise_table(fit, notes=wide))
            console.print(innovation_table(fit, notes=wide))
        for note in (*found.notes, *(() if fit is None else noise_notes(fit, innovations=not wide))):
            console.print(Text(f"• {note}"))
    for remark in judged.remarks:
        console.print(Text(f"• {remark}"), soft_wrap=True)
    seconds = 0.0 if unit.baseline is None else unit.baseline.seconds
    console.print(
        Text(f"Healthy baseline from {seconds:.0f} s. Profile {unit.name} written to {out}"), soft_wrap=True
    )


def as_data(found: Identification, judged: Judgement, unit: Unit) -> dict[str, Any]:
    """The result as ``--json`` writes it, SI; `std` is one standard deviation."""
    return {
        "schema": "fdd.identification/1",
        "verdict": judged.verdict, "sentence": judged.sentence,
        "refusals": judged.refusals, "limits": judged.limits, "remarks": judged.remarks,
        "profile": unit.name,
        "baseline_seconds": 0.0 if unit.baseline is None else unit.baseline.seconds,
        "origin": None if unit.origin is None else unit.origin.to_plain(),
        "table": [
            {"quantity": r.quantity, "unit": r.unit, "before": r.base, "after": r.identified, "std": r.std,
             "word": word(r), "note": r.note}
            for r in (*found.balances, *found.table)
        ],
        "notes": found.notes,
    }  # fmt: skip


def physics_table(found: Identification, *, sensors: bool, notes: bool) -> Table:
    """Quantity, before, after, its 95 % uncertainty, unit, and a plain word."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column("quantity", overflow="fold")
    for title in ("before", "after", "± (95 %)"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("")
    rows = found.balances or [r for r in found.table if sensors or not r.quantity.startswith("sensors.")]
    for row in rows:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        table.add_row(
            Text(row.quantity.replace(".", " ").replace("_", " ")),
            f"{factor * row.base:.4g}",
            f"{factor * (row.base if row.identified is None else row.identified):.4g}",
            "" if row.std is None else f"{float(f'{NORMAL_95 * factor * row.std:.2g}'):g}",
            unit,
            Text(word(row) + (f" ({row.note})" if row.note and (notes or found.balances) else "")),
            style="dim" if row.identified is None else "",
        )
    return table


def word(row: TableRow) -> str:
    """Whether a number is this unit's own, and if not why."""
    if row.identified is not None:
        return "identified"
    return "kept, not measured" if "measured" in row.note else "kept, the logs do not excite it"


def noise_table(fit: NoiseFit, *, notes: bool) -> Table:
    """The filters' noise: what is argued, what the likelihood of the logs says, and what is used."""

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("noise of", no_wrap=True)
    for title in ("argued", "likelihood", "±", "used"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    if notes:
        table.add_column("why")
    for row in fit.rows:
        table.add_row(
            row.name.replace("_", " "),
            f"{row.argued:.3g}",
            "-" if row.likelihood is None else f"{row.likelihood:.3g}",
            "" if row.std is None else f"{row.std:.1g}",
            f"{row.used:.3g}",
            row.unit,
            *([Text(row.why)] if notes else []),
            style="" if row.used > row.argued else "dim",
        )
    return table


def innovation_table(fit: NoiseFit, *, notes: bool) -> Table:
    """Are the innovations as large as the filter says, and white; if not, what they are made of."""

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("innovation", no_wrap=True)
    for title in ("NIS", "95 % band", "inside", "lags 1, 2, 3", "slow"):
        table.add_column(title, justify="right", no_wrap=True)
    if notes:
        table.add_column("what remains")
    for test in fit.tests:
        table.add_row(
            test.channel,
            f"{test.nis:.2g}",
            f"{test.low:.2f} … {test.high:.2f}",
            f"{100 * test.inside:.1f} %",
            " ".join(f"{rho:+.2f}" for rho in test.autocorrelation[:3]),
            f"{test.slow:.2f}",
            *([Text(test.words)] if notes else []),
        )
    return table


def noise_notes(fit: NoiseFit, *, innovations: bool) -> list[str]:
    """What the two tables rest on, and on wish what each innovation is made of; one sentence each."""
    before, after = fit.slow
    slow = (
        f"half-second means of the pressures' innovations scatter {before:.2f} times their 97.5 % bound with "
        f"the argued noise"
    )
    return [
        f"noise: likelihood on {fit.likelihood_seconds:.0f} s of the logs, innovations over "
        f"{fit.tested_seconds:.0f} s; how fast leakage, air and friction may change is a choice, not fitted",
        f"{slow}, {after:.2f} times with the one used" if after != before else slow,
        *(f"{test.channel}: {test.words}" for test in fit.tests if innovations),
    ]
