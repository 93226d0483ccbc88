"""``fdd identify``: a unit's own profile from healthy logs; ``fdd experiment``: one experiment on logs."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fdd.cli import options
from fdd.cli.options import argument, option, require_outputs, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.identification import Identification, TableRow
    from fdd.identification.experiments import Outcome
    from fdd.identification.from_logs import Identified
    from fdd.identification.record import Record

Experiment = Literal["frequency-response", "friction", "leakage", "gain", "bulk-modulus"]
WIDE = 120
"""Columns of a terminal that has room for notes."""


def identify(
    logs: Annotated[list[Path], argument("Logs of this unit while healthy.", "HEALTHY_LOG...")],
    out: Annotated[Path, option("Profile to write (YAML).", "--out", "-o")],
    base: Annotated[
        str, typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.",
                          autocompletion=options.units)
    ] = "axis_a",
    map_: options.MapOption = None,
    axis: options.AxisOption = None,
    name: Annotated[str | None, option("Name of the new profile; by default base, date, hash.")] = None,
    add: Annotated[
        Path | None, option("Narrow this identified profile with more logs.", metavar="PROFILE")
    ] = None,
    accept: Annotated[bool, typer.Option(help="Write a profile that would be refused.")] = False,
    json_: options.JsonOption = None,
    verbose: Annotated[bool, typer.Option(help="Sensors and notes too.")] = False,
) -> None:  # fmt: skip
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    from fdd.cli.console import progress
    from fdd.identification.from_logs import identify_logs

    require_outputs(json_, out)
    made = identify_logs(logs, base, map_, add=add, axis=axis, name=name, accept=accept, progress=progress)
    made.unit.save(out)
    write_json(json_, json.dumps(_as_data(made), indent=1, ensure_ascii=False))
    if json_ != "-":
        _print_result(made, out, verbose=verbose)


def _print_result(made: Identified, out: Path, *, verbose: bool) -> None:
    from fdd.cli.console import output

    found, judged, unit = made.found, made.judged, made.unit
    console = output()
    console.print(judged.sentence + (" (accepted)" if judged.refusals else ""), soft_wrap=True)
    console.print(_physics_table(found, sensors=verbose, notes=verbose and console.width >= WIDE))
    for note in found.notes if verbose else ():
        console.print(f"• {note}")
    for remark in judged.remarks:
        console.print(f"• {remark}", soft_wrap=True)
    seconds = 0.0 if unit.baseline is None else unit.baseline.seconds
    told = f"Healthy baseline from {seconds:.0f} s. Profile {unit.name} written to {out}"
    console.print(told, soft_wrap=True)


def _as_data(made: Identified) -> dict[str, Any]:
    """The result as ``--json`` writes it, SI; `std` is one standard deviation."""
    found, judged, unit = made.found, made.judged, made.unit
    return {
        "schema": "fdd.identification/1",
        "verdict": judged.verdict, "sentence": judged.sentence,
        "refusals": judged.refusals, "limits": judged.limits, "remarks": judged.remarks,
        "profile": unit.name,
        "baseline_seconds": 0.0 if unit.baseline is None else unit.baseline.seconds,
        "origin": None if unit.origin is None else unit.origin.to_plain(),
        "table": [
            {"quantity": r.quantity, "unit": r.unit, "before": r.base, "after": r.identified, "std": r.std,
             "word": _word(r), "note": r.note}
            for r in (*found.balances, *found.table)
        ],
        "notes": found.notes,
    }  # fmt: skip


def _physics_table(found: Identification, *, sensors: bool, notes: bool) -> Table:
    from fdd.cli.console import NARROW, grid
    from fdd.identification.experiments import NORMAL_95, SHOWN

    numbers = ("before", "after", "± (95 %)")
    heads, shape = ("quantity", *numbers, "unit", ""), {"collapse_padding": True, **NARROW}
    table = grid(heads, numbers=numbers, whole=("unit",), **shape)
    rows = found.balances or [r for r in found.table if sensors or not r.quantity.startswith("sensors.")]
    for row in rows:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        table.add_row(
            row.quantity.replace(".", " ").replace("_", " "),
            f"{factor * row.base:.4g}",
            f"{factor * (row.base if row.identified is None else row.identified):.4g}",
            "" if row.std is None else f"{float(f'{NORMAL_95 * factor * row.std:.2g}'):g}",
            unit,
            _word(row) + (f" ({row.note})" if row.note and (notes or found.balances) else ""),
            style="dim" if row.identified is None else "",
        )
    return table


def _word(row: TableRow) -> str:
    if row.identified is not None:
        return "identified"
    return "kept, not measured" if "measured" in row.note else "kept, the logs do not excite it"


def experiment(
    kind: Annotated[Experiment, argument("What to find out.")],
    logs: Annotated[list[Path], argument("Logs of one unit.", "LOG...")],
    unit: Annotated[
        str, typer.Option("--unit", "--base", help="Profile to compare with: a YAML file or a shipped one.")
    ] = "axis_a",
    map_: options.MapOption = None,
    axis: options.AxisOption = None,
    html: Annotated[Path | None, option("Write a page with plots.")] = None,
    json_: options.JsonOption = None,
    given: Annotated[
        Literal["pump_speed", "command"], typer.Option("--input", help="Of the frequency response.")
    ] = "pump_speed",
    caused: Annotated[
        Literal["rate", "position", "pressure_difference"],
        typer.Option("--output", help="Of the frequency response; rate is the piston's velocity."),
    ] = "rate",
    order: Annotated[int | None, option("Poles of its model; by BIC from 1 to 4 else.", min=1, max=8)] = None,
    window: Annotated[
        float, typer.Option(min=0.05, max=60.0, help="s, windows of its measured spectra.")
    ] = 1.0,
) -> None:
    """Find frequency response, friction, leakage, gain or bulk modulus in logs, with 95 % intervals.

    What a log does not tell is said, and why.
    """
    from fdd.cli.console import progress
    from fdd.cli.tables import tell_sheet
    from fdd.identification.experiments.bulk_modulus import bulk_modulus
    from fdd.identification.experiments.friction import friction
    from fdd.identification.experiments.gain import gain
    from fdd.identification.experiments.leakage import leakage
    from fdd.identification.experiments.response import frequency_response
    from fdd.identification.record import even_record
    from fdd.logs import read_log
    from fdd.unit import Unit

    require_outputs(json_, html)
    profile = Unit.load(unit)
    response = partial(frequency_response, given=given, caused=caused, order=order, window_s=window)
    kinds: dict[Experiment, Callable[[list[Record], Unit], Outcome]] = {
        "frequency-response": response, "friction": friction, "leakage": leakage, "gain": gain,
        "bulk-modulus": bulk_modulus,
    }  # fmt: skip
    with progress(f"{kind} of {len(logs)} logs"):
        records = [even_record(read_log(path, map_, axis).samples, profile, str(path)) for path in logs]
        found = kinds[kind](records, profile)
    names = [path.name for path in logs]
    data = {**found.as_data(), "logs": names, "unit": profile.name}
    told = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
    tell_sheet(told, found.sheet(names, profile.name), json_, html)
