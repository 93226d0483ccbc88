"""The lives of axes as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evidence.live.soak import FAULT, Life, Plan
from evidence.machine import load_now, machine
from fdd import __version__
from fdd.faults import fault
from fdd.markdown import table


def report_text(plan: Plan, lives: Sequence[Life]) -> str:
    """The whole report."""
    parts = [
        "# Weeks of an axis in compressed time",
        "",
        f"Made by `python -m evidence soak` of fdd {__version__} on {machine()}; {load_now()}",
        f"{plan.days} days with {plan.flights} flights of {plan.minutes:g} min each at 100 Hz, from "
        "the fleet's inbox to the store; between flights it stands still and sends nothing. The oil is "
        "as warm as the day, 27 to 43 °C, give or take 2 K. Each night the service is restarted, every "
        "other time by a kill. The profile is made from four healthy logs of two minutes, at 25 to 45 °C.",
        "",
    ]
    for life in lives:
        parts += _of(plan, life)
    return "\n".join(parts).rstrip() + "\n"


def _of(plan: Plan, life: Life) -> list[str]:
    what = (
        f"a leak grows from day {plan.onset:g} on, to severity {plan.severity:g}" if life.wears else "healthy"
    )
    rows = [
        [
            str(day.number), f"{day.severity:.2f}", f"{1e12 * day.leakage:.2f} ± {1e12 * day.std:.2f}",
            f"{day.resident / 1e6:.0f}", f"{day.store / 1e6:.1f}", f"{day.cpu_us:.0f}",
        ]
        for day in life.days[:: max(len(life.days) // 10, 1)]
    ]  # fmt: skip
    lines = [
        f"## {life.hours:.0f} hours in motion: {what}",
        "",
        *table(
            ["day", "severity", "leakage (1e-12 m³/(s·Pa))", "memory (MB)", "store (MB)", "µs a sample"],
            rows,
            "lr",
        ),
        f"{life.samples:,} samples; restarted {life.restarts[0]} times, killed {life.restarts[1]} times. "
        f"Memory grew by {_growth(life):.2f} MB a day over the second half.",
        "",
    ]
    told = [
        f"- day {day:.1f}: {fault(name).title}" + ("" if size is None else f", severity {size:.2f}")
        for day, name, size in life.alarms
    ]
    early = [x for x in life.alarms if not life.wears or x[0] < plan.onset]
    found = next((x for x in life.alarms if life.wears and x[1] == FAULT and x[0] >= plan.onset), None)
    verdict = f"{len(early)} false alarms"
    if life.wears:
        verdict += (
            "; the leak was not found"
            if found is None
            else f"; the leak was found on day {found[0]:.1f}, at a severity of {plan.at(found[0]):.2f}"
        )
    return [*lines, "Alarms:" if told else "No alarm.", "", *told, *([""] if told else []), f"{verdict}.", ""]


def _growth(life: Life) -> float:
    """MB a day, by the line through the second half."""
    days = life.days[len(life.days) // 2 :]
    if len(days) < 2:
        return 0.0
    return float(np.polyfit([d.number for d in days], [d.resident / 1e6 for d in days], 1)[0])
