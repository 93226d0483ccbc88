"""``fdd diagnose``: logs in, answers out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.options import AxisOption, MapOption, ModelOption, UnitOption
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.cli.diagnosing import Diagnosed

FAULT_STATUS = 1


def diagnose(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="MCAP, Parquet or CSV.", show_default=False)
    ],
    unit: UnitOption = None,
    map_: MapOption = None,
    model: ModelOption = None,
    json_: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE|-", help="Write the answer as JSON; - is standard output."),
    ] = None,
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="Write a report; for several logs a folder or a name with {log}.",
        ),
    ] = None,
    mcap: Annotated[
        str | None,
        typer.Option(
            "--mcap", metavar="FILE.mcap", help="Write the log with its diagnosis; for several as --report."
        ),
    ] = None,
    axis: AxisOption = None,
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="Exit with status 1 where any log shows a fault.")
    ] = False,
) -> None:
    """Diagnose logs: is there a fault, since when, which one, and how severe."""
    reports = output_paths(report, logs, ".html", "--report")
    mcaps = output_paths(mcap, logs, ".mcap", "--mcap")
    _require_outputs(json_, [*reports, *mcaps], logs)

    from fdd.cli.console import output, progress
    from fdd.cli.diagnosing import diagnose_log, unit_of
    from fdd.cli.tables import diagnosis_view
    from fdd.diagnosis.model import Model
    from fdd.logs import ChannelMap, read_log
    from fdd.unit import Unit

    if unit is not None:
        Unit.load(unit)
    channel_map = None if map_ is None else ChannelMap.load(map_)
    classifier = Model.load(model)
    answers: list[str] = []
    faulty = False
    for k, path in enumerate(logs):
        with progress(f"reading {path.name}"):
            log = read_log(path, channel_map, axis)
        profile, note = unit_of(log, unit)
        found = diagnose_log(log, profile, classifier, name=path.name, notes=(note,) if note else ())
        faulty = faulty or found.diagnosis.verdict == "faulty"
        answers.append(found.diagnosis.model_dump_json(by_alias=True))
        if reports:
            write_report_of(reports[k], found, str(model or "shipped"))
        if mcaps:
            _write_mcap(mcaps[k], found, answers[-1])
        if json_ != "-":
            output().print(diagnosis_view(found.diagnosis))
    if json_ is not None:
        _write_json(json_, answers)
    if exit_code and faulty:
        raise typer.Exit(FAULT_STATUS)


def output_paths(pattern: str | None, logs: list[Path], suffix: str, option: str) -> list[Path]:
    """One output for each log: a folder, a name with ``{log}``, or, for one log, a name.

    Raises
    ------
    InputError : one name for several logs, or two logs of the same name.

    Examples
    --------
    >>> [p.as_posix() for p in output_paths("out/{log}.html", [Path("a.mcap"), Path("b.csv")], ".html", "")]
    ['out/a.html', 'out/b.html']
    """
    if pattern is None:
        return []
    if "{log}" in pattern:
        paths = [Path(pattern.replace("{log}", log.stem)) for log in logs]
    elif Path(pattern).is_dir() or pattern.endswith("/"):
        paths = [Path(pattern) / f"{log.stem}{suffix}" for log in logs]
    elif len(logs) > 1:
        raise InputError(
            f"{option} {pattern}: one file for {len(logs)} logs",
            mend=f"name a folder, or write {{log}} for the log's name: {option} '{{log}}{suffix}'",
        )
    else:
        paths = [Path(pattern)]
    if len(set(paths)) < len(paths):
        raise InputError(
            f"{option} {pattern}: two logs would be written to one file", mend="diagnose them apart"
        )
    return paths


def write_report_of(path: Path, found: Diagnosed, model: str) -> None:
    """Write the HTML report of a diagnosed log."""
    from fdd.report import write_report

    settings = {"model": model, "profile": found.unit.name, "log": found.log.name}
    write_report(path, found.diagnosis, found.trajectories, found.log.samples, found.unit, settings)


def _write_mcap(path: Path, found: Diagnosed, answer: str) -> None:
    from fdd.logs.mcap_writing import write_annotated

    write_annotated(
        path,
        found.log.samples,
        vars(found.trajectories),
        answer,
        axis=found.diagnosis.axis,
        unit_yaml=found.unit.to_yaml(),
        start_ns=found.log.start_ns,
    )


def _require_outputs(json_: str | None, others: list[Path], logs: list[Path]) -> None:
    from fdd.files import require_writable

    outputs = [*others, *([Path(json_)] if json_ not in (None, "-") else [])]
    inputs = {log.resolve() for log in logs}
    for path in outputs:
        require_writable(path)
        if path.resolve() in inputs:
            raise InputError(
                "would be written over, it is a log to diagnose", where=path, mend="name another"
            )


def _write_json(target: str, answers: list[str]) -> None:
    import json

    from fdd.files import write_text

    plain = [json.loads(a) for a in answers]
    text = json.dumps(plain[0] if len(plain) == 1 else plain, indent=2, ensure_ascii=False) + "\n"
    if target == "-":
        print(text, end="")
    else:
        write_text(Path(target), text)
