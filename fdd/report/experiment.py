"""The page of ``fdd experiment``: figures with intervals, what the log does not tell, and plots."""

from __future__ import annotations

from collections.abc import Sequence

from fdd.report.page import page
from fdd.report.plots import Figure
from fdd.report.tables import version_rows


def experiment_page(
    title: str,
    logs: Sequence[str],
    unit: str,
    told: Sequence[tuple[str, ...]],
    not_told: Sequence[str],
    notes: Sequence[str],
    table: tuple[Sequence[str], Sequence[Sequence[str]]],
    figures: list[Figure],
) -> str:
    """The page as HTML; it stands alone.

    Parameters
    ----------
    title : of the experiment. logs, unit : names.
    told : quantity, value, interval, unit and remark of each figure.
    not_told, notes : sentences. table : heads and rows, maybe none. figures : of plotly.
    """
    return page(
        "experiment.html", figures, title=title, logs=logs, unit=unit, told=told, not_told=not_told,
        notes=notes, heads=table[0], rows=table[1], plots=figures, versions=version_rows(),
    )  # fmt: skip
