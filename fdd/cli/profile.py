"""``fdd profile new | check``: a base profile from a data sheet, and what follows from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fdd.cli.options import argument, option
from fdd.errors import InputError
from fdd.files import require_writable

if TYPE_CHECKING:
    from fdd.data_sheet.plausibility import Remark
    from fdd.data_sheet.profile import Answers, Question
    from fdd.unit import Unit

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
