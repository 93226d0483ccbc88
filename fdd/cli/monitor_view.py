"""What ``fdd monitor`` shows: lines for people with a status line below them, or JSON lines.

JSON lines carry ``event``: ``finding`` (with ``time_s`` and the finding's fields as in the
answer), ``note`` (``time_s``, ``text``) and, last of all, ``summary`` (``diagnosis``: the answer).
"""

from __future__ import annotations

import json
import math
import sys
from contextlib import AbstractContextManager
from typing import Any, Self

from rich.live import Live
from rich.text import Text

from fdd.cli.console import output, remark
from fdd.cli.tables import COLOURS, diagnosis_view
from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED, Diagnosis
from fdd.monitor.monitor import Event, Found, Noted, Status
from fdd.report.tables import with_std
from fdd.report.words import family_title, finding_words, percent

SHORT = {
    "leakage": "leakage", "bulk_modulus": "bulk modulus", "coulomb_friction": "Coulomb",
    "viscous_friction": "viscous",
}  # fmt: skip


class View(AbstractContextManager["View"]):
    """Shows events as they come, and the answer at the end: one JSON object a line, for programs."""

    shows_status = False

    def __exit__(self, *error: object) -> None:
        """Nothing is left open."""

    def remark(self, text: str) -> None:
        """A note before the stream begins."""
        remark(text)

    def show(self, event: Event) -> None:
        """One event."""
        if isinstance(event, Found):
            finding = json.loads(event.finding.model_dump_json())
            _print({"event": "finding", "time_s": event.time, **finding})
        elif isinstance(event, Noted):
            time = None if math.isnan(event.time) else event.time
            _print({"event": "note", "time_s": time, "text": event.text})

    def summary(self, diagnosis: Diagnosis) -> None:
        """The answer on everything."""
        _print({"event": "summary", "diagnosis": json.loads(diagnosis.model_dump_json(by_alias=True))})


def _print(line: dict[str, Any]) -> None:
    print(json.dumps(line, ensure_ascii=False), flush=True)


class TextView(View):
    """Findings line by line; on a terminal with a status line that stays below them."""

    def __init__(self) -> None:
        self._console = output()
        self.shows_status = self._console.is_terminal
        self._live = Live(console=self._console, transient=True, auto_refresh=False)

    def __enter__(self) -> Self:
        if self.shows_status:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self.shows_status:
            self._live.stop()

    def remark(self, text: str) -> None:
        self._console.print(Text(f"• {text}", style="yellow"))

    def show(self, event: Event) -> None:
        if isinstance(event, Status):
            self._live.update(status_line(event), refresh=True)
        elif isinstance(event, Found):
            words = finding_words(event.finding)
            self._console.print(
                Text(f"{stamp(event.time)} {words.headline}", style="bold red"), soft_wrap=True
            )
            if words.alternatives:
                self._console.print(Text(f"{' ' * 12} {words.alternatives}"), soft_wrap=True)
        else:
            self._console.print(Text(f"{stamp(event.time)} {event.text}", style="yellow"), soft_wrap=True)
        sys.stdout.flush()

    def summary(self, diagnosis: Diagnosis) -> None:
        self._console.print(diagnosis_view(diagnosis))


def stamp(time: float) -> str:
    """Time of the stream, of one width.

    Examples
    --------
    >>> stamp(34.5)
    '[   34.50 s]'
    """
    return "[      start]" if math.isnan(time) else f"[{time:8.2f} s]"


def status_line(status: Status) -> Text:
    """Time, the likeliest families and the estimates that the data pin down, in one line."""
    line = Text(f"{stamp(status.time)} ", no_wrap=True, overflow="ellipsis")
    line.append(status.verdict, style=COLOURS[status.verdict])
    ordered = sorted(status.probabilities.items(), key=lambda item: -item[1])
    top = [(name, p) for k, (name, p) in enumerate(ordered[:2]) if k == 0 or p >= 0.05]
    line.append("".join(f"  {family_title(name).lower()} {percent(p)}" for name, p in top))
    for name, estimate in status.estimates.items():
        if estimate.value is not None and estimate.observable:
            scale, unit = DISPLAY_SCALE[name], ESTIMATED[name][1]
            std = None if estimate.std is None else estimate.std * scale
            line.append(f"  {SHORT[name]} {with_std(estimate.value * scale, std)} {unit}")
    return line
