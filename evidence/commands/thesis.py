"""``python -m evidence thesis``: the thesis's experiments on the plant, side by side with its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

REPORT = "thesis.md"


def thesis(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for thesis.md and its pictures.")] = Path(
        "reports"
    ),
    seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of all trials.")] = 0,
) -> None:
    """Repeat the thesis's experiments on the plant and report them beside its numbers."""
    from fdd.files import require_writable, write_text, written

    require_writable(out, folder=True)

    from evidence.thesis.pictures import draw_all
    from fdd.pictures import require_matplotlib

    require_matplotlib()

    from evidence.thesis.report import PICTURES, report_text, run_all
    from fdd.cli.console import progress
    from fdd.unit import Unit

    axis_a, axis_b = Unit.load("axis_a"), Unit.load("axis_b")
    with progress("the thesis's experiments", 1.0) as advance:
        findings = run_all(axis_a, axis_b, seed=seed, progress=lambda done, total: advance(done / total))
    with written(out):
        out.mkdir(parents=True, exist_ok=True)
    draw_all(findings, out / PICTURES)
    write_text(out / REPORT, report_text(findings, axis_a, axis_b, seed))
    for finding in findings:
        met = sum(row.verdict == "meets" for row in finding.rows)
        if finding.rows:
            print(f"{finding.title}: {met} of {len(finding.rows)} numbers meet the thesis's")
    print(f"Written to {out / REPORT}")
