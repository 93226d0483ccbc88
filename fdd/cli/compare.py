"""``fdd compare``: what changed between two logs of a unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fdd.cli import options
from fdd.cli.options import argument, require_outputs, write_json


def compare(
    a: Annotated[Path, argument("The log before.", "A")],
    b: Annotated[Path, argument("The log after.", "B")],
    unit: options.UnitOption = None,
    map_: options.MapOption = None,
    axis: options.AxisOption = None,
    json_: options.JsonOption = None,
    report: options.ReportOption = None,
) -> None:
    """Tell what changed between two logs of a unit: estimates, balances, duty and spectra."""
    from fdd.cli.console import output, progress
    from fdd.cli.tables import print_sheet
    from fdd.cli.which_logs import jobs_of
    from fdd.files import write_text
    from fdd.history.compare import Side
    from fdd.history.compare import compare as compared
    from fdd.history.compare_view import compare_sheet, compare_tables, verdict_lines
    from fdd.offline.diagnoser import Diagnoser, Settings, unit_of

    require_outputs(json_, report)
    diagnoser = Diagnoser(Settings(unit, map_, None, axis))
    jobs = jobs_of([a, b])
    logs = [diagnoser.read(job) for job in jobs]
    notes = []
    if diagnoser.unit is None:  # the profile in log A, or the default, is for both
        diagnoser.unit, note = unit_of(logs[0], None)
        notes = [note] if note else []
        if note is None and len({log.metadata.get("unit", {}).get("yaml") for log in logs}) > 1:
            notes = ["the logs carry different profiles: both are diagnosed on that in A"]
    sides = []
    with progress("diagnosing 2 logs", 2) as advance:
        for job, log in zip(jobs, logs, strict=True):
            found = diagnoser.diagnose(job, log)
            sides.append(Side(found.diagnosis, found.trajectories, log.samples))
            advance(float(len(sides)))
    answer, spectra = compared(sides[0], sides[1], diagnoser.unit)
    answer.notes += notes
    write_json(json_, answer.model_dump_json(by_alias=True, indent=2))
    if report is not None:
        from fdd.report.sheet import render_sheet

        write_text(report, render_sheet(compare_sheet(answer, spectra)))
    if json_ != "-":
        lines = [answer.headline, *verdict_lines(answer)]
        print_sheet(output(), lines, compare_tables(answer), answer.notes)
