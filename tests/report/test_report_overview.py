"""The page and the table over many answers; decimation, by which no spike and no gap is ever lost."""

import csv
import io
import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pages import EVIL, Page, case, decoded, hash_source

from fdd.diagnosis.findings import Diagnosis
from fdd.report.page import COLUMNS, Row, render_index, summary_csv
from fdd.report.traces import (
    KEPT_PER_BUCKET,
    break_at_gaps,
    bucket_means,
    decimate,
    envelope,
    intervals,
    packed,
)


@pytest.fixture
def rows() -> list[Row]:
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


def test_the_worst_stands_first(rows):
    html = render_index(rows, missing=2)
    order = [next(n for n in ("h.csv", "mild", "i.csv", "bad", "u.csv") if n in r) for r in body_rows(html)]
    assert order == ["bad", "mild", "u.csv", "i.csv", "h.csv"]
    page = Page(html)
    for words in ("2 faulty", "1 unreadable", "1 inconclusive", "1 healthy", "2 more logs were not worked"):
        assert words in page.text
    assert "the file is empty" in page.text and "internal leakage or pump gear wear and 1 more" in page.text
    assert page.attributes("href") == [f"reports/{n}.html" for n in ("bad.csv", "mild.csv", "i.csv", "h.csv")]
    assert len([1 for tag, _ in page.tags if tag == "button"]) == 8, "every column can be sorted by"


def test_the_policy_lets_only_the_pages_own_script_run_and_text_from_logs_stays_text(rows):
    plain = Page(render_index(rows))
    (script,) = plain.scripts
    assert plain.script_policy() == hash_source(script.encode())
    assert plain.attributes("src", "srcset") == []
    for row in rows:
        row.answer.unit = EVIL
    rows[0].answer.log = rows[1].answer.faults[0].fault = EVIL
    rows[0] = Row(rows[0].answer, f"reports/{EVIL}.html")
    page = Page(render_index(rows))
    assert {tag for tag, _ in page.tags} == {tag for tag, _ in plain.tags}
    assert not [k for _, attrs in page.tags for k in attrs if k.startswith("on")]
    assert page.text.count(EVIL) >= 6
    assert not any('"' in link or "<" in link for link in page.attributes("href"))


def test_the_table_has_a_row_for_each_fault_and_no_cell_is_a_formula(rows):
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
    rows[0].answer.log = "=HYPERLINK(1)"
    rows[1].answer.unit = "@SUM(1)"
    cells = list(csv.reader(io.StringIO(summary_csv(rows).removeprefix("\ufeff"))))
    assert cells[1][0] == "'=HYPERLINK(1)" and cells[2][1] == "'@SUM(1)"


values_and_gaps = st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")), st.just(0.0))
signals = arrays(np.float64, st.integers(1, 700), elements=values_and_gaps)


@given(values=signals, buckets=st.integers(1, 60))
@settings(max_examples=100, deadline=None)
def test_every_sample_lies_within_what_is_kept_nearby_and_ends_and_gaps_are_kept(values, buckets):
    time = np.arange(values.size, dtype=float)
    kept_time, kept = decimate(time, values, buckets)
    assert kept.size <= max(4 * buckets, KEPT_PER_BUCKET * buckets)
    assert (np.diff(kept_time) > 0).all() and (kept_time[0], kept_time[-1]) == (time[0], time[-1])
    np.testing.assert_array_equal(kept, values[kept_time.astype(int)])
    size = -(-values.size // buckets)
    for at in np.flatnonzero(np.isfinite(values)):
        near = kept[np.abs(kept_time - at) < size]
        assert np.nanmin(near) <= values[at] <= np.nanmax(near)
    assert np.isnan(kept).any() == np.isnan(values).any()


def test_small_signals_are_left_alone_shares_sum_to_one_and_a_hole_breaks_the_line_once():
    time = np.arange(40.0)
    assert decimate(time, time, 10)[1] is time
    reduced = bucket_means(np.random.default_rng(3).dirichlet(np.ones(5), 4321), 100)
    assert reduced.shape[0] <= 100
    np.testing.assert_allclose(reduced.sum(axis=1), 1.0)
    np.testing.assert_allclose(bucket_means(np.arange(6.0), 3), [0.5, 2.5, 4.5])
    time = np.concatenate((np.arange(0.0, 10.0, 0.001), np.arange(11.0, 20.0, 0.001)))
    broken_time, broken = break_at_gaps(time, np.ones(time.size))
    assert np.isnan(broken).sum() == 1
    assert 10.0 < broken_time[np.isnan(broken)][0] < 11.0
    assert (np.diff(broken_time) > 0).all()
    jitter = time[:5000] + np.random.default_rng(5).uniform(0.0, 9e-4, 5000)
    assert break_at_gaps(jitter, np.ones(5000))[1].size == 5000


@given(values=signals, buckets=st.integers(2, 60))
@settings(max_examples=100, deadline=None)
def test_envelope_covers_the_band(values, buckets):
    time = np.arange(values.size, dtype=float)
    mid, low, high = envelope(time, values - 1.0, values + 1.0, buckets)
    assert mid.size == low.size == high.size <= max(buckets, 1)
    assert (np.diff(mid) > 0).all()
    if np.isfinite(values).any():
        assert (np.nanmin(low), np.nanmax(high)) == (np.nanmin(values) - 1.0, np.nanmax(values) + 1.0)
    else:
        assert np.isnan(low).all()


@given(arrays(np.bool_, st.integers(1, 400)), st.integers(2, 20))
@settings(max_examples=100, deadline=None)
def test_intervals_cover_the_mask_and_are_few(mask, at_most):
    time = np.arange(mask.size, dtype=float)
    found = intervals(time, mask, at_most)
    assert len(found) <= at_most
    assert all(any(a <= t <= b for a, b in found) for t in time[mask])
    assert all(a[1] < b[0] for a, b in itertools.pairwise(found))
    assert mask.any() or found == []


def test_packed_numbers_keep_six_digits_and_stamps_all():
    rng = np.random.default_rng(3)
    values = rng.normal(size=10_000) * 10.0 ** rng.uniform(-6, 6, 10_000)
    values[::100] = np.nan
    values[1::100] = np.inf
    np.testing.assert_allclose(decoded(packed(values)), values, rtol=6e-7)
    epoch = 1.7e9 + np.arange(1000) * 1e-3
    np.testing.assert_array_equal(decoded(packed(epoch)), epoch)
