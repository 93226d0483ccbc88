"""The report's section on speed, which `evidence.estimators.speed` measures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fdd.markdown import table

if TYPE_CHECKING:
    from evidence.estimators.speed import SpeedTable

MOST_MICROSECONDS, LEAST_PEER, MOST_CPP = 2.0, 25.0, 2.0
"""Goals: µs of a sample for EKF and SVSF; times slower that filterpy is; times the plain C++ loop."""


def measure_speed() -> SpeedTable:
    """Measure, in this process: nothing else of the benchmark may run beside it."""
    from evidence.estimators.speed import measure

    return measure()


def speed_lines(measured: SpeedTable | None) -> list[str]:
    """The section as lines of Markdown, empty where nothing was measured.

    Examples
    --------
    >>> speed_lines(None)
    []
    """
    if measured is None:
        return []
    rows = [[r.name, *(_figure(v) for v in (r.microseconds, r.best, r.ratio)), r.note] for r in measured.rows]
    head = ["filter", "µs per sample, median", "best", "over our EKF", "note"]
    hours = ", ".join(f"{name.upper()} {seconds:.1f} s" for name, seconds in measured.hour.items())
    return [
        "## Speed",
        "",
        f"One process, one core, in turns on one log of {measured.samples} samples; processor time. C++: "
        f"{measured.compiler}." + (f" An hour at 1 kHz: {hours}." if hours else ""),
        "",
        *_verdicts(measured),
        "",
        *table(head, rows, "lrrrl"),
    ]


def _verdicts(table: SpeedTable) -> list[str]:
    """The goals on speed, each with its figure."""
    took = {row.name: row.microseconds for row in table.rows}
    lines = []
    for name in ("EKF", "SVSF"):
        if name in took:
            lines.append(_verdict(f"{name} within {MOST_MICROSECONDS:g} µs a sample", took[name], "µs",
                                  took[name] <= MOST_MICROSECONDS))  # fmt: skip
            ratio = took[name] / took.get(f"C++ {name}", float("nan"))
            if ratio == ratio:
                lines.append(
                    _verdict(f"{name} within {MOST_CPP:g} times C++", ratio, "times", ratio <= MOST_CPP)
                )
    peer = took.get("filterpy EKF", float("nan")) / took.get("EKF", float("nan"))
    if peer == peer:
        lines.append(_verdict(f"{LEAST_PEER:g} times filterpy's speed", peer, "times", peer >= LEAST_PEER))
    return lines


def _verdict(name: str, value: float, unit: str, met: bool) -> str:
    return f"- {name}: **{'met' if met else 'short'}**, {value:.2f} {unit}"


def _figure(value: float) -> str:
    return f"{value:.2f}" if value == value else ""
