"""The report on the service's own troubles: what it writes, and that it sees a loss."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from reports.__main__ import app
from reports.troubles import TROUBLES, Outcome, report_text


def test_a_loss_is_told_as_wrong() -> None:
    kept = Outcome("store locked", "held", "is locked", 100, 100, 0)
    lost = Outcome("disk full", "filled", "ok | fine", 100, 90, 7, ["10 samples were never taken"])
    rows = report_text([kept, lost], ["quota reached"]).splitlines()
    assert "| store locked | held | is locked | 100 | 100 | 0 | as it should be |" in rows
    told = "| disk full | filled | ok \\| fine | 100 | 90 | 7 | WRONG: 10 samples were never taken |"
    assert told in rows and "Left out: quota reached (needs root, to mount a small disk)." in rows


def test_an_unknown_trouble_is_refused_in_one_line(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["troubles", "--only", "flood", "-o", str(tmp_path)])
    assert refused.exit_code == 2 and "no trouble 'flood'" in refused.output
    assert len({trouble.tried for trouble in TROUBLES}) == len(TROUBLES)
