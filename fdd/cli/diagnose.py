"""``fdd diagnose``: logs in, answers out; ``fdd demo``: the same on a shipped log."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli import command
from fdd.cli.command import USAGE, argument, option, require_outputs, write_json
from fdd.errors import InputError
from fdd.files import require_writable

if TYPE_CHECKING:
    from fdd.cli.batch import AnswersFolder
    from fdd.diagnosis.findings import Diagnosis
    from fdd.offline import Diagnoser, Job
    from fdd.unit import Unit

FAULT_STATUS, INCONCLUSIVE_STATUS = 1, 3
SAVE_EVERY_S = 5.0
DEMO_LOG, DEMO_UNIT = "demo.mcap", "unit.yaml"


def diagnose(
    logs: Annotated[list[Path], argument("Files, and folders for all logs below.", "LOG...")],
    unit: command.UnitOption = None,
    map_: command.MapOption = None,
    model: command.ModelOption = None,
    json_: command.JsonOption = None,
    report: Annotated[Path | None, option("Write a report of one log.", metavar="FILE.html")] = None,
    mcap: Annotated[Path | None, option("Write one log with its diagnosis.", metavar="FILE.mcap")] = None,
    axis: command.AxisOption = None,
    prior: Annotated[
        float | None,
        option("Share of such logs that is faulty, before they are looked at; the model's else (0.5 as "
               "shipped). A fault is answered where it is then likelier than not, and one healthy log in "
               "fifty at most would be.", min=0.001, max=0.999),
    ] = None,
    tracker: Annotated[
        list[str] | None,
        option("A tracker of an installed package that runs beside fdd's own. Repeatable.", metavar="NAME"),
    ] = None,
    classifier: Annotated[
        Path | None,
        option("Ask a classifier that fdd train --classifier wrote, too; its opinion stands beside ours.",
               metavar="FILE.skops"),
    ] = None,
    output_: Annotated[
        Path | None,
        option("Folder for all of it: index.html, summary.csv, answers.jsonl and reports.", "--output", "-o",
               metavar="DIR"),
    ] = None,
    resume: Annotated[
        bool, option("Keep what --output holds of unchanged logs and settings.", "--resume")
    ] = False,
    workers: command.WorkersOption = None,
    engine: command.EngineOption = "local",
    exit_code: Annotated[
        bool,
        option("Exit with 1 for a fault, else 2 for an unreadable log, else 3 if inconclusive.",
               "--exit-code"),
    ] = False,
) -> None:  # fmt: skip
    """Diagnose logs: is there a fault, since when, which one, and how severe."""
    from fdd.cli.batch import AnswersFolder, file_names, find_logs, names_of, worked
    from fdd.offline import Diagnoser, Job, Settings

    if resume and output_ is None:
        raise InputError("--resume needs --output", mend="name the folder of the earlier run")
    folder = None if output_ is None else AnswersFolder(output_)
    paths = find_logs(logs, leave_out=output_)
    if len(paths) > 1 and (report or mcap):
        problem = f"--report and --mcap are files of one log, not of {len(paths)}"
        raise InputError(problem, mend="-o writes a report of each; diagnose one after the other for MCAP")
    names = names_of(paths)
    pages = [folder.page(name) if folder else None for name in file_names(names)]
    given = zip(paths, names, pages, strict=True)
    jobs = [Job(path, name, report, page, mcap) for path, name, page in given]
    require_outputs(json_, report, mcap, inputs=paths)
    trackers = tuple(dict.fromkeys(tracker or ()))
    settings = Settings(unit, map_, model, axis, trackers, classifier, prior)
    diagnoser = Diagnoser(settings)
    answers = folder.earlier(jobs, diagnoser) if folder and resume else {}
    profile = diagnoser.unit
    try:
        if len(jobs) == 1 and not answers:
            answers[0], profile = _alone(jobs[0], diagnoser, folder)
        elif len(jobs) > 1:
            if folder:
                folder.begin()
            todo, saved = [k for k in range(len(jobs)) if k not in answers], time.monotonic()
            for place, answer in worked([jobs[k] for k in todo], settings, workers, engine):
                answers[todo[place]] = answer
                if folder and time.monotonic() - saved > SAVE_EVERY_S:
                    folder.write(jobs, answers, pages=False)
                    saved = time.monotonic()
    finally:
        if answers:
            if folder:
                folder.write(jobs, answers)
            _tell(jobs, answers, profile, folder, quiet=json_ == "-")
    found = [answers[k] for k in range(len(jobs))]
    if json_ is not None:
        plain = [json.loads(a.model_dump_json(by_alias=True)) for a in found]
        write_json(json_, json.dumps(plain[0] if len(plain) == 1 else plain, indent=2, ensure_ascii=False))
    raise typer.Exit(status_of(found) if exit_code else USAGE if any(a.error for a in found) else 0)


def status_of(answers: Sequence[Diagnosis]) -> int:
    """Exit status that tells the worst of the answers."""
    if any(a.verdict == "faulty" for a in answers):
        return FAULT_STATUS
    if any(a.error for a in answers):
        return USAGE
    return INCONCLUSIVE_STATUS if any(a.verdict == "inconclusive" for a in answers) else 0


def _alone(job: Job, diagnoser: Diagnoser, folder: AnswersFolder | None) -> tuple[Diagnosis, Unit]:
    """The answer of the only log, and its profile; nothing is written where it cannot be read."""
    from fdd.cli.console import progress

    with progress(f"reading {job.name}"):
        log = diagnoser.read(job)
    with progress(f"diagnosing {job.name}", max(len(log.samples), 1)) as advance:
        found = diagnoser.diagnose(job, log, advance, keep_trajectories=bool(job.outputs))
    if folder:
        folder.begin()
    diagnoser.write(job, found)
    return found.diagnosis, found.unit


def _tell(
    jobs: Sequence[Job], answers: dict[int, Diagnosis], unit: Unit | None, folder: AnswersFolder | None, *,
    quiet: bool,
) -> None:  # fmt: skip
    """Answers for people, in the order of the logs; what could not be read goes to standard error."""
    from fdd.cli.console import diagnosis_view, output
    from fdd.report import headline

    console = output()
    for k in sorted(answers):
        if answers[k].error:
            print(f"fdd: error: {answers[k].error}", file=sys.stderr)
        elif not quiet and folder and len(jobs) > 1:
            console.print(f"{answers[k].log}: {headline(answers[k])}", soft_wrap=True)
        elif not quiet:
            console.print(diagnosis_view(answers[k], unit))
    if folder and not quiet:
        unread = sum(a.error is not None for a in answers.values())
        told = f"{len(answers) - unread} of {len(jobs)} logs diagnosed"
        told += f", {unread} could not be read" if unread else ""
        console.print(f"{told}; written to {folder.path / 'index.html'}", soft_wrap=True)


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Report to write.")] = Path("fdd-demo-report.html"),
    model: command.ModelOption = None,
) -> None:
    """Diagnose a shipped log of a leaking actuator and write its report."""
    require_writable(out)

    from importlib import resources

    from fdd.cli.console import diagnosis_view, output
    from fdd.offline import Diagnoser, Job, Settings

    with resources.as_file(resources.files("fdd") / "demo") as folder:
        job = Job(folder / DEMO_LOG, DEMO_LOG, report=out)
        diagnoser = Diagnoser(Settings(unit=str(folder / DEMO_UNIT), model=model))
        found = diagnoser.diagnose(job, diagnoser.read(job))
    diagnoser.write(job, found)
    output().print(diagnosis_view(found.diagnosis, found.unit))
    print(f"Report with all plots: {out.resolve()}")
    fdd = "fdd" if shutil.which("fdd") else sys.argv[0]  # make demo's stands in .venv/bin, in no path
    words = [fdd, "diagnose", folder / DEMO_LOG, "--unit", folder / DEMO_UNIT, "--report", "report.html"]
    print(f"The same by hand: {shlex.join(map(str, words))}")
