"""``fdd demo``: the main job on a shipped log, end to end."""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.options import ModelOption

LOG, UNIT = "demo.mcap", "unit.yaml"


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Report to write.")] = Path("fdd-demo-report.html"),
    model: ModelOption = None,
) -> None:
    """Diagnose a shipped log of a leaking actuator and write its report."""
    from fdd.files import require_writable

    require_writable(out)

    from importlib import resources

    from fdd.cli.console import output
    from fdd.cli.tables import diagnosis_view
    from fdd.offline.diagnoser import Diagnoser, Job, Settings

    with resources.as_file(resources.files("fdd") / "demo") as folder:
        job = Job(folder / LOG, LOG, report=out)
        diagnoser = Diagnoser(Settings(unit=str(folder / UNIT), model=model))
        found = diagnoser.diagnose(job, diagnoser.read(job))
    diagnoser.write(job, found)
    output().print(diagnosis_view(found.diagnosis, found.unit))
    print(f"Report with all plots: {out.resolve()}")
    fdd = "fdd" if shutil.which("fdd") else sys.argv[0]  # make demo's stands in .venv/bin, in no path
    words = [fdd, "diagnose", folder / LOG, "--unit", folder / UNIT, "--report", "report.html"]
    print(f"The same by hand: {shlex.join(map(str, words))}")
