"""``fdd identify``: a unit's own profile from its healthy logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.options import AxisOption, MapOption
from fdd.errors import InputError

WIDE = 120
"""Columns of a terminal that has room for notes."""

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.identify import Identification
    from fdd.identify.noise import NoiseFit


def identify(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="HEALTHY_LOG...", help="Logs of this unit while healthy.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Profile to write (YAML).", show_default=False)],
    base: Annotated[
        str, typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.")
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    name: Annotated[str | None, typer.Option(help="Name of the new profile.", show_default=False)] = None,
    noise: Annotated[
        bool, typer.Option(help="Fit the filters' noise too, and show whether their innovations are white.")
    ] = True,
) -> None:
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    from fdd.files import require_writable

    require_writable(out)

    from pydantic import ValidationError
    from rich.text import Text

    from fdd.cli.console import output, progress
    from fdd.diagnosis.baseline import add_baseline
    from fdd.identify import identify_unit
    from fdd.identify.noise import fit_noise
    from fdd.logs import ChannelMap, read_log
    from fdd.unit import Unit

    profile = Unit.load(base)
    try:
        profile.model_copy().name = name or profile.name
    except ValidationError:
        raise InputError(
            f"--name {name!r} is no name", mend="use 1 to 64 letters, digits, blanks, _ . and -"
        ) from None
    channel_map = None if map_ is None else ChannelMap.load(map_)
    with progress("reading", len(logs)) as advance:
        samples = []
        for k, path in enumerate(logs):
            samples.append(read_log(path, channel_map, axis).samples)
            advance(k + 1)
    with progress("identifying"):
        found = identify_unit(samples, profile, name)
    fit = None
    if noise:
        with progress("fitting the filters' noise"):
            fit = fit_noise(samples, found.unit)
        found.unit.estimation = None if fit is None else fit.estimation
    with progress("measuring the healthy baseline"):
        unit = add_baseline(found.unit, samples)
    unit.save(out)
    console = output()
    console.print(identification_table(found, notes=console.width >= WIDE))
    if fit is not None:
        console.print(noise_table(fit, notes=console.width >= WIDE))
        console.print(innovation_table(fit, notes=console.width >= WIDE))
    for note in (*found.notes, *(() if fit is None else noise_notes(fit, innovations=console.width < WIDE))):
        console.print(Text(f"• {note}"))
    seconds = 0.0 if unit.baseline is None else unit.baseline.seconds
    console.print(Text(f"Healthy baseline from {seconds:.0f} s. Profile {unit.name} written to {out}"))


def identification_table(found: Identification, *, notes: bool) -> Table:
    """Quantity, base, identified value with its spread, and (where there is room) how it was found."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD)
    # In a narrow window long names go on in the next line: cut numbers would say something else.
    table.add_column("quantity", no_wrap=notes, overflow="fold", max_width=None if notes else 29)
    for title in ("base", "identified", "±"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    if notes:
        table.add_column("note")
    for row in found.table:
        kept = row.identified is None
        table.add_row(
            Text(row.quantity),
            f"{row.base:.4g}",
            "kept" if row.identified is None else f"{row.identified:.4g}",
            "" if row.std is None else f"{row.std:.2g}",
            row.unit,
            *([Text(row.note)] if notes else []),
            style="dim" if kept else "",
        )
    return table


def noise_table(fit: NoiseFit, *, notes: bool) -> Table:
    """The filters' noise: what is argued, what the likelihood of the logs says, and what is used."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

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
    from rich import box
    from rich.table import Table
    from rich.text import Text

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
