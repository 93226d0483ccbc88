"""The report of one diagnosis: one HTML file that works offline."""

from __future__ import annotations

from fdd.report.page import render_report
from fdd.report.words import headline

__all__ = ["headline", "render_report"]
