"""The page of fdd inspect: each signal's course over the whole width, names escaped, no script."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.logs.inspection import SignalView, picture
from fdd.report.inspection import course, inspection_page


def view(values: np.ndarray, name: str = "x") -> SignalView:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return SignalView(name, "mm", values.size, 0, 1000.0, 0.001, low, 0.0, high, values, None)


@pytest.mark.parametrize("n", [2, 50, 120, 100_000])
def test_a_course_spans_the_picture_and_shows_the_extremes(n: int) -> None:
    values = np.sin(np.linspace(0.0, 7.0, n))
    values[n // 2] = 5.0
    points = np.array([[float(v) for v in p.split(",")] for p in course(view(values)).split()])
    assert points[:, 0].min() == 0.0 and points[:, 0].max() == pytest.approx(320.0)
    assert points[:, 1].min() == pytest.approx(0.0) and points[:, 1].max() == pytest.approx(48.0)


def test_names_are_escaped_and_nothing_runs() -> None:
    page = inspection_page("<b>.csv", "CSV", [view(np.arange(9.0), "<script>alert(1)</script>")])
    assert "<script" not in page and "&lt;script&gt;" in page and "default-src 'none'" in page


def test_a_picture_leaves_gaps_where_nothing_was_measured() -> None:
    values = np.concatenate([np.zeros(10), np.full(10, np.nan), np.ones(10)])
    assert picture(values, 3) == "▁ █"
