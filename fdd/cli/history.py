"""``fdd compare`` and ``fdd trend``: what changed between two logs of a unit, and where it is going."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli import command
from fdd.cli.command import USAGE, argument, option, require_outputs
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis
    from fdd.offline import Settings
    from fdd.unit import Unit

ANSWERS_SUFFIX = ".jsonl"
Answered = tuple[list["Diagnosis"], "Unit | None"]
"""Answers, and the profile that they were given on where it is at hand."""


def compare(
    a: Annotated[Path, argument("The log before.", "A")],
    b: Annotated[Path, argument("The log after.", "B")],
    unit: command.UnitOption = None,
    map_: command.MapOption = None,
    axis: command.AxisOption = None,
    json_: command.JsonOption = None,
    report: command.ReportOption = None,
) -> None:
    """Tell what changed between two logs of a unit: estimates, balances and duty."""
    from fdd.cli.batch import names_of
    from fdd.cli.console import progress, tell_sheet
    from fdd.history.compare import Side
    from fdd.history.compare import compare as compared
    from fdd.history.view import compare_sheet
    from fdd.offline import Diagnoser, Job, Settings, unit_of

    require_outputs(json_, report)
    diagnoser = Diagnoser(Settings(unit, map_, None, axis))
    jobs = [Job(path, name) for path, name in zip((a, b), names_of([a, b]), strict=True)]
    logs = [diagnoser.read(job) for job in jobs]
    note = None
    if diagnoser.unit is None:  # the profile in log A, or the default, is for both
        diagnoser.unit, note = unit_of(logs[0], None)
        if note is None and len({log.metadata.get("unit", {}).get("yaml") for log in logs}) > 1:
            note = "the logs carry different profiles: both are diagnosed on that in A"
    sides = []
    with progress("diagnosing 2 logs", 2) as advance:
        for job, log in zip(jobs, logs, strict=True):
            found = diagnoser.diagnose(job, log)
            sides.append(Side(found.diagnosis, found.trajectories, log.samples))
            advance(float(len(sides)))
    answer = compared(sides[0], sides[1], diagnoser.unit)
    answer.notes += [note] if note else []
    told = answer.model_dump_json(by_alias=True, indent=2)
    tell_sheet(told, compare_sheet(answer), json_, report)


def trend(
    logs: Annotated[
        list[Path], argument("Logs as fdd diagnose takes them, or the answers.jsonl that it wrote.", "LOG...")
    ],
    unit: command.UnitOption = None,
    map_: command.MapOption = None,
    axis: command.AxisOption = None,
    limit: Annotated[
        list[str] | None,
        option("How far a quantity may go, as factor of the profile's; what severity 1 makes of it else.",
               metavar="QUANTITY=FACTOR"),
    ] = None,
    json_: command.JsonOption = None,
    report: command.ReportOption = None,
    workers: command.WorkersOption = None,
) -> None:  # fmt: skip
    """Tell where a unit is going: each estimate over its logs, and when it comes to its limit."""
    from fdd.cli.console import tell_sheet
    from fdd.history.trend import given_limits, severity_one, trend_of
    from fdd.history.view import trend_sheet
    from fdd.offline import Settings

    chosen = given_limits(limit or [])
    require_outputs(json_, report)
    settings = Settings(unit, map_, None, axis)
    files = [path for path in logs if path.suffix.lower() == ANSWERS_SUFFIX]
    if files and len(files) < len(logs):
        mend = f"give either, or a {ANSWERS_SUFFIX} of all"
        raise InputError("answers and logs in one command", where=files[0], mend=mend)
    elif files:
        answers, known = _of_answers(files, settings)
    else:
        answers, known = _of_logs(logs, settings, workers)
    for answer in answers:
        if answer.error:
            print(f"fdd: error: {answer.error}", file=sys.stderr)
    limits = {**({} if known is None else severity_one(known)), **chosen}
    life, courses = trend_of(answers, limits)
    if not limits:
        life.notes.append(f"No limits: profile {life.unit} is not at hand (give --unit, or --limit).")
    told = life.model_dump_json(by_alias=True, indent=2)
    tell_sheet(told, trend_sheet(life, courses), json_, report)
    if any(a.error for a in answers):
        raise typer.Exit(USAGE)


def _of_logs(logs: list[Path], settings: Settings, workers: int | None) -> Answered:
    from fdd.cli.batch import find_logs, names_of, worked
    from fdd.offline import Diagnoser, Job, unit_of

    paths = find_logs(logs)
    jobs = [Job(path, name) for path, name in zip(paths, names_of(paths), strict=True)]
    diagnoser = Diagnoser(settings)
    found = dict(worked(jobs, settings, workers))
    answers, unit = [found[k] for k in sorted(found)], diagnoser.unit
    first = next((job for job, answer in zip(jobs, answers, strict=True) if answer.error is None), None)
    if unit is None and first is not None:
        unit = unit_of(diagnoser.read(first), None)[0]
    return answers, unit


def _of_answers(files: list[Path], settings: Settings) -> Answered:
    """What `fdd diagnose -o` wrote; of the axis and profile that the command line names, if it does."""
    from pydantic import ValidationError

    from fdd.diagnosis.findings import Diagnosis
    from fdd.unit import Unit, shipped_units

    if settings.map is not None:
        raise InputError("--map is for logs", where=files[0], mend="leave it out: nothing is diagnosed anew")
    unit = settings.load_unit()
    found = []
    for path in files:
        try:
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None
        for number, line in enumerate(lines, 1):
            try:
                answer = Diagnosis.model_validate_json(line)
            except ValidationError:
                problem = f"line {number}: no answer of fdd diagnose"
                raise InputError(problem, where=path, mend="make it anew with fdd diagnose -o") from None
            if len(files) > 1:  # the logs of each month may have the same names
                answer.log = f"{path.parent.name}/{answer.log}"
            wanted = settings.axis in (None, answer.axis) and (unit is None or answer.unit == unit.name)
            if wanted or answer.error is not None:
                found.append(answer)
    named = {a.unit for a in found if a.error is None}
    if unit is not None and not named:
        problem = f"no answer on profile {unit.name}"
        raise InputError(problem, where=files[0], mend="name the profile it was made with")
    if unit is None and len(named) == 1 and (name := min(named)) in shipped_units():
        unit = Unit.load(name)
    return found, unit
