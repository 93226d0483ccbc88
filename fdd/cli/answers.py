"""The folder that holds the answers of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fdd.bounds import MAX_ANSWERS_BYTES
from fdd.errors import InputError
from fdd.files import require_writable, write_text, written
from fdd.offline.diagnoser import Diagnoser, Job, printable

if TYPE_CHECKING:
    from fdd.diagnosis.findings import Diagnosis

ANSWERS, SUMMARY, INDEX, REPORTS = "answers.jsonl", "summary.csv", "index.html", "reports"


class AnswersFolder:
    """Answers, table and pages of many logs in one folder.

    Parameters
    ----------
    path : the folder; made by `begin`.

    Raises
    ------
    InputError : it cannot be written, or holds something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        require_writable(path, folder=True)
        with written(path):
            if path.is_dir() and any(path.iterdir()) and not (path / ANSWERS).is_file():
                raise InputError(
                    "not empty, and not an earlier answer of fdd diagnose", where=path,
                    mend="name another folder",
                )  # fmt: skip

    def page(self, name: str) -> Path:
        """Where the report of the log with this file name goes."""
        return self.path / REPORTS / f"{name}.html"

    def begin(self) -> None:
        """Make the folder, with what its pages share."""
        from fdd.report.plotly import write_bundle

        with written(self.path):
            (self.path / REPORTS).mkdir(parents=True, exist_ok=True)
        write_bundle(self.path / REPORTS)

    def earlier(self, jobs: Sequence[Job], diagnoser: Diagnoser) -> dict[int, Diagnosis]:
        """Answers of an earlier run that would come out again, by the number of the job.

        Those of the same name, hashes (log, map, profile, model) and versions whose outputs are there.
        """
        from pydantic import ValidationError

        from fdd.diagnosis.findings import Diagnosis

        if not (self.path / ANSWERS).is_file() or (self.path / ANSWERS).stat().st_size > MAX_ANSWERS_BYTES:
            return {}
        known: dict[str, Diagnosis] = {}
        for line in (self.path / ANSWERS).read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                answer = Diagnosis.model_validate_json(line)
            except ValidationError:  # of another version
                continue
            if {k: v for k, v in answer.versions.items() if k != "model"} == diagnoser.versions:
                known[answer.log] = answer
        axis = diagnoser.settings.axis
        found = {}
        for number, job in enumerate(jobs):
            if (name := printable(job.name)) not in known:
                continue
            answer = known[name]
            if axis is not None and answer.axis not in (axis, ""):
                continue
            pages = [p for p in (job.report, job.page, job.mcap) if p is not None]
            if answer.error is None and not all(p.is_file() for p in pages):
                continue
            try:
                if diagnoser.hashes(job.path) == answer.sha256:
                    found[number] = answer
            except InputError:
                continue
        return found

    def write(self, jobs: Sequence[Job], answers: dict[int, Diagnosis], *, pages: bool = True) -> None:
        """Write what is known so far, in the order of the jobs.

        Parameters
        ----------
        answers : by the number of the job.
        pages : with table and index; else only what ``--resume`` goes on from.

        Raises
        ------
        InputError : it cannot be written.
        """
        from fdd.report.overview import Row, render_index, summary_csv

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
