"""The page and the table over many answers, read back as a browser and a spreadsheet would."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest
from pages import EVIL, Page

from fdd.diagnosis.findings import Diagnosis
from fdd.report.overview import COLUMNS, Row, render_index, summary_csv


@pytest.fixture
def rows(case: Callable[..., Any]) -> list[Row]:
    made = [case(v, rows=6_000).diagnosis for v in ("healthy", "faulty", "inconclusive", "faulty")]
    for name, answer in zip(("h.csv", "mild.csv", "i.csv", "bad.csv"), made, strict=True):
        answer.log = name
    made[3].faults[0].severity = 0.9
    made[3].faults.append(made[3].faults[0].model_copy(update={"fault": "aeration", "confidence": 0.6}))
    unread = Diagnosis.unreadable("u.csv", "u.csv: the file is empty; record or copy it again", {})
    return [*(Row(a, f"reports/{a.log}.html") for a in made), Row(unread, "")]


def body_rows(html: str) -> list[str]:
    table = html[html.index("<tbody>") : html.index("</tbody>")]
    return table.split("<tr ")[1:]


def test_the_worst_stands_first(rows: list[Row]) -> None:
    html = render_index(rows, missing=2)
    order = [next(n for n in ("h.csv", "mild", "i.csv", "bad", "u.csv") if n in r) for r in body_rows(html)]
    assert order == ["bad", "mild", "u.csv", "i.csv", "h.csv"]
    page = Page(html)
    for words in ("2 faulty", "1 unreadable", "1 inconclusive", "1 healthy", "2 more logs were not worked"):
        assert words in page.text
    assert "the file is empty" in page.text and "internal leakage or pump gear wear and 1 more" in page.text
    assert page.attributes("href") == [f"reports/{n}.html" for n in ("bad.csv", "mild.csv", "i.csv", "h.csv")]
    assert len([1 for tag, _ in page.tags if tag == "button"]) == 8, "every column can be sorted by"


def test_the_policy_lets_only_the_pages_own_script_run(rows: list[Row]) -> None:
    page = Page(render_index(rows))
    policy = next(c for c in page.attributes("content") if "default-src" in c)
    (script,) = page.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy.split("script-src ")[1].split(";")[0] == f"'sha256-{digest}'"
    assert page.attributes("src", "srcset") == []


def test_text_from_logs_stays_text(rows: list[Row]) -> None:
    plain = Page(render_index(rows))
    for row in rows:
        row.answer.unit = EVIL
    rows[0].answer.log = rows[1].answer.faults[0].fault = EVIL
    rows[0] = Row(rows[0].answer, f"reports/{EVIL}.html")
    page = Page(render_index(rows))
    assert {tag for tag, _ in page.tags} == {tag for tag, _ in plain.tags}
    assert not [k for _, attrs in page.tags for k in attrs if k.startswith("on")]
    assert page.text.count(EVIL) >= 6
    assert not any('"' in link or "<" in link for link in page.attributes("href"))


def test_the_table_has_a_row_for_each_fault(rows: list[Row]) -> None:
    text = summary_csv(rows)
    table = pd.read_csv(io.BytesIO(text.encode()))
    assert tuple(table.columns) == COLUMNS
    assert list(table["log"]) == ["h.csv", "mild.csv", "i.csv", "bad.csv", "bad.csv", "u.csv"]
    assert list(table["fault"].fillna("")) == ["", "internal_leakage", "", "internal_leakage", "aeration", ""]
    assert table["severity"][1] == 0.41 and table["severity_low"][1] == 0.35
    assert table["confidence"][1] == 0.97 and table["onset_s"][1] == pytest.approx(0.338 * 6)
    assert table["ambiguity"][1] == "internal_leakage pump_wear"
    assert "the file is empty" in table["error"][5]
    assert text.startswith("\ufeff"), "a spreadsheet takes it for UTF-8"


def test_no_cell_is_a_formula(rows: list[Row]) -> None:
    rows[0].answer.log = "=HYPERLINK(1)"
    rows[1].answer.unit = "@SUM(1)"
    cells = list(csv.reader(io.StringIO(summary_csv(rows).removeprefix("\ufeff"))))
    assert cells[1][0] == "'=HYPERLINK(1)" and cells[2][1] == "'@SUM(1)"
