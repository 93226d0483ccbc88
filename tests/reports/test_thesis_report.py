"""The report: each failure has its reason, and the command makes it the same each time."""

import re
import struct
from pathlib import Path

from typer.testing import CliRunner

from reports.__main__ import app
from reports.thesis import flow, report
from reports.thesis.report import EXPERIMENTS, Row, anchor, report_text

COMMITTED = Path(__file__).parents[2] / "reports" / "thesis.md"
QUICK = (flow.bulk_modulus, flow.transfer_function)


def table_rows(text: str) -> list[list[str]]:
    return [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]


def test_each_row_has_a_verdict_and_each_failure_a_reason():
    text = COMMITTED.read_text("utf-8")
    _, *sections = re.split(r"^## \d+\. ", text, flags=re.M)
    assert len(sections) == len(EXPERIMENTS)
    for one in sections:
        rows = [r for r in table_rows(one) if len(r) == 8 and r[7].startswith("±")]
        assert rows
        for row in rows:
            verdict = row[6].strip("*")
            assert verdict in ("meets", "does not meet")
            if verdict == "does not meet":
                reasons = [x for x in one.splitlines() if x.startswith("- Does not meet") and row[0] in x]
                assert reasons, row[0]


def test_every_link_and_picture_of_the_committed_report_is_there():
    text = COMMITTED.read_text("utf-8")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert len(pictures) == len(set(pictures)) == 7
    for name in pictures:
        head = (COMMITTED.parent / name).read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        assert 800 <= struct.unpack(">I", head[16:20])[0] <= 1000
    made = {f"thesis/{p.name}" for p in (COMMITTED.parent / "thesis").glob("*.png")}
    assert made == set(pictures)
    headings = {anchor(h) for h in re.findall(r"^## (.+)$", text, flags=re.M)}
    assert set(re.findall(r"\(#([^)]+)\)", text)) <= headings


def test_the_committed_report_is_what_the_command_measures(monkeypatch, tmp_path):
    """As far as quick experiments tell; after a change of the plant: ``python -m reports thesis``."""
    monkeypatch.setattr(report, "EXPERIMENTS", QUICK)
    result = CliRunner().invoke(app, ["thesis", "-o", str(tmp_path)])
    assert result.exit_code == 0, result.stderr
    assert "Bulk modulus: 2 of 2 numbers meet" in result.stdout
    made = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.*")}
    assert made == {"thesis.md", "thesis/bulk_modulus.png"}
    committed, again = (
        {(r[0], r[2], r[3]) for r in table_rows(path.read_text("utf-8")) if len(r) == 7}
        for path in (COMMITTED, tmp_path / "thesis.md")
    )
    # The table's head and each section's line of how many meet are of this run.
    numbers = {row for row in again if row[1] and row[0] not in ("what", "---")}
    assert len(numbers) == 18 and numbers <= committed


def test_text_of_made_up_findings():
    good = Row("speed", "1.1", 2.0, 2.01, "m/s", note="A remark.")
    bad = Row("force", "1.2", 10.0, 20.0, "N", why="It slips.")
    worse = Row("work", "1.3", 10.0, 30.0, "J", why="It slips.")
    said = "\n".join(report._said([good, bad, worse]))
    assert "- Does not meet, force; work: It slips." in said and "- Note, speed: A remark." in said
    text = report_text([("## First\n\nHow.", [good]), ("## Second\n\nSo.", [bad, worse])], 3)
    assert "**1 of 3 numbers meet the thesis's.**" in text and "--seed 3" in text
    assert "| speed | 1.1 | 2.00 | 2.01 | m/s | +0.5 % | meets |" in text
    assert "| force | 1.2 | 10.0 | 20.0 | N | +100.0 % | **does not meet** |" in text
    assert "## 2. Second" in text and "(#2-second)" in text
