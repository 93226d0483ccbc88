"""Many logs at once: which are meant; worked in parallel, none of them able to end the others; their answers
in one folder."""

from __future__ import annotations

import os
import re
import signal
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from itertools import chain, count
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from fdd.bounds import MAX_ANSWERS_BYTES
from fdd.cli.command import INTERRUPTED, prepare_process
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError
from fdd.files import require_writable, write_text, written
from fdd.logs.formats import suffixes
from fdd.offline import Diagnoser, Job, Settings, printable

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis

ANSWERS, SUMMARY, INDEX, REPORTS = "answers.jsonl", "summary.csv", "index.html", "reports"


def find_logs(given: Sequence[Path], leave_out: Path | None = None) -> list[Path]:
    """The logs that a command line means, each once: files, whether they are there or not, and all logs below
    folders in order of their names, but for hidden ones and the folder of answers (`leave_out`). An
    InputError where there are none."""
    found: dict[str, Path] = {}
    for path in given:
        for log in _below(path, leave_out) if path.is_dir() else [path]:
            found.setdefault(os.path.realpath(log), log)
    return list(found.values())


def names_of(logs: Sequence[Path]) -> list[str]:
    """What each log is called: its file name; with folders where two would have the same."""
    times = Counter(log.name for log in logs)
    twins = [log.absolute().parent for log in logs if times[log.name] > 1]
    common = os.path.commonpath(twins) if twins else ""
    return [
        Path(os.path.relpath(log, common)).as_posix() if times[log.name] > 1 else log.name for log in logs
    ]


def file_names(names: Sequence[str]) -> list[str]:
    """A name for a file of each log, without folders, no two alike (nor on systems that ignore case)."""
    taken: set[str] = set()
    out = []
    for name in names:
        base = re.sub(r'[/\\:*?"<>|\x00-\x1f]', "-", name)
        tries = chain([base], (f"{base}-{number}" for number in count(2)))
        out.append(next(plain for plain in tries if plain.lower() not in taken))
        taken.add(out[-1].lower())
    return out


def _below(folder: Path, leave_out: Path | None) -> list[Path]:
    skipped = None if leave_out is None else os.path.realpath(leave_out)
    found = []
    for here, folders, files in os.walk(folder):
        folders[:] = sorted(
            f for f in folders if not f.startswith(".") and os.path.realpath(Path(here, f)) != skipped
        )
        found += [Path(here, f) for f in files if not f.startswith(".") and f.lower().endswith(suffixes())]
    if not found:
        mend = f"logs are taken by their suffix: {' '.join(suffixes())}"
        raise InputError("no log below this folder", where=folder, mend=mend)
    return sorted(found, key=lambda path: path.parts)


class AnswersFolder:
    """Answers, table and pages of many logs in one folder, which `begin` makes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        require_writable(path, folder=True)
        with written(path):
            if path.is_dir() and any(path.iterdir()) and not (path / ANSWERS).is_file():
                problem = "not empty, and not an earlier answer of fdd diagnose"
                raise InputError(problem, where=path, mend="name another folder")

    def page(self, name: str) -> Path:
        """Where the report of the log with this file name goes."""
        return self.path / REPORTS / f"{name}.html"

    def begin(self) -> None:
        """Make the folder, with what its pages share."""
        from fdd.report.page import write_bundle

        with written(self.path):
            (self.path / REPORTS).mkdir(parents=True, exist_ok=True)
        write_bundle(self.path / REPORTS)

    def earlier(self, jobs: Sequence[Job], diagnoser: Diagnoser) -> dict[int, Diagnosis]:
        """Answers of an earlier run that would come out again, by the number of the job.

        Those of the same name, hashes (log, map, profile, model) and versions whose outputs are there.
        """
        from pydantic import ValidationError

        from fdd.diagnosis.findings import Diagnosis

        path, axis = self.path / ANSWERS, diagnoser.settings.axis
        if not path.is_file() or path.stat().st_size > MAX_ANSWERS_BYTES:
            return {}
        known: dict[str, Diagnosis] = {}
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                answer = Diagnosis.model_validate_json(line)
            except ValidationError:  # of another version
                continue
            versions = {k: v for k, v in answer.versions.items() if k != "model"}
            if versions == diagnoser.versions and (axis is None or answer.axis in (axis, "")):
                known[answer.log] = answer
        found = {}
        for number, job in enumerate(jobs):
            before = known.get(printable(job.name))
            if before is None or not (before.error or all(p.is_file() for p in job.outputs)):
                continue
            with suppress(InputError):
                if diagnoser.hashes(job.path) == before.sha256:
                    found[number] = before
        return found

    def write(self, jobs: Sequence[Job], answers: dict[int, Diagnosis], *, pages: bool = True) -> None:
        """Write the answers so far, by the number of their job, in order; without `pages`, which are
        table and index, only what ``--resume`` goes on from."""
        from fdd.report.page import Row, render_index, summary_csv

        ordered = [(jobs[k], answers[k]) for k in sorted(answers)]
        lines = [f"{answer.model_dump_json(by_alias=True)}\n" for _, answer in ordered]
        write_text(self.path / ANSWERS, "".join(lines))
        if not pages:
            return
        rows = [
            Row(answer, "" if answer.error or job.page is None else f"{REPORTS}/{job.page.name}")
            for job, answer in ordered
        ]
        write_text(self.path / SUMMARY, summary_csv(rows))
        write_text(self.path / INDEX, render_index(rows, missing=len(jobs) - len(rows)))


def worked(
    jobs: Sequence[Job], settings: Settings, workers: int | None, engine: Engine = "local"
) -> Iterator[tuple[int, Diagnosis]]:
    """Work jobs, see `fdd.engines.map_unordered`, and show how far they are; gives their numbers and answers
    as they come. The answer of a log that could not be read has an `error`."""
    from fdd.cli.console import progress

    _diagnoser.cache_clear()  # its files may have changed since the last call in this process
    answers = map_unordered(partial(_work, settings), jobs, engine=engine, workers=workers, begin=_begin)
    with progress(f"diagnosing {len(jobs)} logs", len(jobs)) as advance:
        for done, answer in enumerate(answers, 1):
            yield answer
            advance(done)


class _Worker:
    """What a process of the pool knows."""

    stopped = False


def _begin() -> None:
    prepare_process()
    signal.signal(signal.SIGINT, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    # Raised as an exit, so that temporary files are cleared away and nothing is printed.
    _Worker.stopped = True
    raise SystemExit(INTERRUPTED)


_diagnoser = lru_cache(maxsize=1)(Diagnoser)
"""What the logs that a process works share."""


def _work(settings: Settings, job: Job) -> Diagnosis:
    """The job's answer, its outputs written; whatever is wrong with the log is in the answer."""
    from fdd.diagnosis.findings import Diagnosis

    if _Worker.stopped:  # what the pool had already handed out
        raise SystemExit(INTERRUPTED)
    diagnoser = _diagnoser(settings)
    try:
        found = diagnoser.diagnose(job, diagnoser.read(job), keep_trajectories=bool(job.outputs))
        diagnoser.write(job, found)
        return found.diagnosis
    except InputError as error:
        line = str(error)
    except MemoryError:
        line = f"{job.path}: not enough memory for this log; split it, or give fewer --workers"
    except Exception as error:
        if os.environ.get("FDD_DEBUG"):
            traceback.print_exc()
        line = f"{job.path}: internal error: {type(error).__name__}: {error}"[:500]
    hashes: dict[str, str] = {}
    with suppress(InputError):
        hashes = diagnoser.hashes(job.path)
    return Diagnosis.unreadable(printable(job.name), printable(" ".join(line.split())), hashes)
