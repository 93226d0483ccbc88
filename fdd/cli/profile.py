"""``fdd profile``: a base profile from a data sheet; ``fdd identify``: a unit's own from healthy logs; and
``fdd experiment``: one experiment on logs."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fdd.cli import command
from fdd.cli.command import argument, option, require_outputs, write_json
from fdd.errors import InputError
from fdd.files import require_writable

if TYPE_CHECKING:
    from rich.table import Table

    from fdd.data_sheet.plausibility import Remark
    from fdd.data_sheet.profile import Answers, Question
    from fdd.identification import Identification, TableRow
    from fdd.identification.experiments import Outcome
    from fdd.identification.from_logs import Identified
    from fdd.identification.record import Record
    from fdd.unit import Unit

Experiment = Literal["frequency-response", "friction", "leakage", "gain", "bulk-modulus"]
WIDE = 120
"""Columns of a terminal that has room for notes."""

app = typer.Typer(help="A base profile typed from a data sheet.", no_args_is_help=True)


@app.command()
def new(
    out: Annotated[Path, option("Profile to write (YAML).", "--out", "-o")],
    answers: Annotated[
        Path | None, option("Flat YAML or JSON of answers, 'stroke: 64 mm' and so on.", "--from")
    ] = None,
) -> None:
    """Type a base profile from a data sheet, for fdd identify to start from.

    Position 0 is mid-stroke, positive extends; positive pump speed raises the pressure on side 1. What
    the sheet does not say is assumed, and the profile says so. Numbers that no actuator has are refused.
    """
    require_writable(out)

    from fdd.data_sheet.plausibility import require_plausible
    from fdd.data_sheet.profile import read_answers
    from fdd.unit import Unit

    if answers is None:
        unit, odd = _asked_profile()
    else:
        unit, odd = _typed(read_answers(answers))
        require_plausible(odd, str(answers))
    unit.save(out)
    _show(Unit.load(out), odd)
    print(f"Profile {unit.name} written to {out}; next: fdd identify HEALTHY_LOG... --base {out}")


@app.command()
def check(profile: Annotated[str, argument("A YAML file or a shipped profile.", "PROFILE")]) -> None:
    """Show what follows from a profile's numbers, and what is odd about them."""
    from fdd.data_sheet.plausibility import require_plausible, unit_remarks
    from fdd.unit import Unit

    unit = Unit.load(profile)
    odd = unit_remarks(unit)
    _show(unit, odd)
    require_plausible(odd, profile)


def _asked_profile() -> tuple[Unit, list[Remark]]:
    from fdd.data_sheet.profile import QUESTIONS, Answers

    print("Write numbers with their unit, e.g. 26 MPa. Return takes what is assumed, where that is said.")
    given: dict[str, Any] = {"name": typer.prompt("Name of the profile", err=True)}
    given |= {question.key: _asked(question) for question in QUESTIONS.values()}
    while True:
        try:
            unit, odd = _typed(Answers.of(given, "answers"))
        except InputError as error:  # only the name is left to be wrong
            typer.echo(str(error), err=True)
            given["name"] = typer.prompt("Name of the profile", err=True)
            continue
        impossible = [remark for remark in odd if remark.impossible]
        if not impossible:
            return unit, odd
        typer.echo(f"This cannot be: {impossible[0].problem}; {impossible[0].mend}", err=True)
        for key in impossible[0].keys:
            given[key] = _asked(QUESTIONS[key], given[key])


def _asked(question: Question, before: str | None = None) -> str | None:
    from fdd.data_sheet.profile import parsed

    default = before or question.assumed
    hint = f"{question.unit}; assumed: {question.assumed}" if question.assumed else question.unit
    while True:
        answer = typer.prompt(
            f"{question.words} ({hint})", default=before or ("" if default else None),
            show_default=before is not None, err=True,
        )  # fmt: skip
        if not answer.strip():
            return None
        try:
            parsed(question, answer)
        except InputError as error:
            typer.echo(str(error), err=True)
            continue
        return str(answer)


def _typed(answers: Answers) -> tuple[Unit, list[Remark]]:
    from fdd.data_sheet.plausibility import unit_remarks
    from fdd.data_sheet.profile import completed, typed_unit

    unit = typed_unit(answers)
    return unit, unit_remarks(unit, completed(answers.values))


def _show(unit: Unit, odd: list[Remark]) -> None:
    from rich.text import Text

    from fdd.cli.console import grid, output
    from fdd.data_sheet.plausibility import derived

    console = output()
    rows = [(r.quantity, f"{r.value:.4g}", "" if r.unit == "1" else r.unit) for r in derived(unit)]
    title = f"{unit.name}: what follows"
    console.print(grid((title, "value", "unit"), rows, numbers=("value",), whole=(title, "unit")))
    for remark in odd:
        kind, style = ("impossible", "red") if remark.impossible else ("unusual", "yellow")
        console.print(Text(f"• {kind}: {remark.problem}; {remark.mend}", style=style))
    if not odd:
        console.print("Nothing is odd about these numbers.")


def identify(
    logs: Annotated[list[Path], argument("Logs of this unit while healthy.", "HEALTHY_LOG...")],
    out: Annotated[Path, option("Profile to write (YAML).", "--out", "-o")],
    base: Annotated[
        str, typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.")
    ] = "axis_a",
    map_: command.MapOption = None,
    axis: command.AxisOption = None,
    name: Annotated[str | None, option("Name of the new profile; by default base, date, hash.")] = None,
    accept: Annotated[bool, typer.Option(help="Write a profile that would be refused.")] = False,
    json_: command.JsonOption = None,
    verbose: Annotated[bool, typer.Option(help="Sensors and notes too.")] = False,
) -> None:  # fmt: skip
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    from fdd.cli.console import output, progress
    from fdd.identification.from_logs import identify_logs

    require_outputs(json_, out)
    made = identify_logs(logs, base, map_, axis=axis, name=name, accept=accept, progress=progress)
    found, judged, unit = made.found, made.judged, made.unit
    unit.save(out)
    write_json(json_, json.dumps(_as_data(made), indent=1, ensure_ascii=False))
    if json_ == "-":
        return
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
            for r in found.table
        ],
        "notes": found.notes,
    }  # fmt: skip


def _physics_table(found: Identification, *, sensors: bool, notes: bool) -> Table:
    from fdd.cli.console import NARROW, grid
    from fdd.identification.experiments import NORMAL_95, SHOWN

    numbers = ("before", "after", "± (95 %)")
    heads, shape = ("quantity", *numbers, "unit", ""), {"collapse_padding": True, **NARROW}
    table = grid(heads, numbers=numbers, whole=("unit",), **shape)
    rows = [r for r in found.table if sensors or not r.quantity.startswith("sensors.")]
    for row in rows:
        factor, unit = SHOWN.get(row.unit, (1.0, row.unit))
        table.add_row(
            row.quantity.replace(".", " ").replace("_", " "),
            f"{factor * row.base:.4g}",
            f"{factor * (row.base if row.identified is None else row.identified):.4g}",
            "" if row.std is None else f"{float(f'{NORMAL_95 * factor * row.std:.2g}'):g}",
            unit,
            _word(row) + (f" ({row.note})" if row.note and notes else ""),
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
    map_: command.MapOption = None,
    axis: command.AxisOption = None,
    html: Annotated[Path | None, option("Write a page with plots.")] = None,
    json_: command.JsonOption = None,
    given: Annotated[
        Literal["pump_speed", "command"], typer.Option("--input", help="Of the frequency response.")
    ] = "pump_speed",
    window: Annotated[
        float, typer.Option(min=0.05, max=60.0, help="s, windows of its measured spectra.")
    ] = 1.0,
) -> None:
    """Find frequency response, friction, leakage, gain or bulk modulus in logs, with 95 % intervals.

    What a log does not tell is said, and why.
    """
    from fdd.cli.console import progress, tell_sheet
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
    response = partial(frequency_response, given=given, window_s=window)
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
