"""JSON lines, of blocks and of single samples, to blocks."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from fdd.bounds import MOST_AXES, MOST_PENDING
from fdd.errors import InputError
from fdd.monitor.mapping import all_numbers, channels_in_si, column_of_rows
from fdd.samples import Samples
from fdd.service.arrow import ARROW_START
from fdd.service.blocks import Block, axis_name
from fdd.service.json_form import json_object
from fdd.service.sources.intake import Intake, Window

GATHERED_S = 0.1
"""s for which single samples are gathered to a block."""


class LineFeed:
    """Lines to blocks; a line is a block message, or a sample: ``{"axis": "A1", "time": 0, "position": 0}``.

    Parameters
    ----------
    intake : takes the blocks. axis : of samples that name none.
    stop : ends a wait. window : how many blocks may be on their way; None where the sender cannot wait.

    Examples
    --------
    >>> intake = Intake("test")
    >>> intake.put = lambda block: print(block.axis, block.samples)
    >>> feed = LineFeed(intake, None, threading.Event())
    >>> feed.take(b'{"axis": "A1", "time": 0.1, "position": 0.2}')
    >>> feed.flush()
    A1 Samples(1 rows, 0.100 to 0.100 s, position)
    """

    def __init__(
        self, intake: Intake, axis: str | None, stop: threading.Event, window: Window | None = None
    ) -> None:
        self._intake, self._axis = intake, axis
        self._stop, self._window = stop, window
        self._more: dict[str, Any] = {"patient": window is not None}
        if window is not None:
            self._more["accepted"] = window.accepted
        self._rows: dict[str, list[dict[str, Any]]] = {}
        self._pending, self._since = 0, time.monotonic()

    def take(self, line: bytes) -> None:
        """One line or one datagram; what is wrong with it is counted and told by the intake."""
        decoder, name = self._intake.decoder, self._intake.name
        try:
            if line.startswith(ARROW_START):
                block = decoder.decode(line, name, **self._more)
            else:
                message = json_object(line)
                if "schema" not in message:
                    self._gather(message)
                    return
                block = decoder.decode_object(message, name, **self._more)
            self.flush()  # samples that came before
            self._give(block)
        except InputError as error:
            self._intake.refuse(error)

    def flush_if_due(self) -> None:
        """Give the samples that were gathered long enough."""
        if self._pending and time.monotonic() - self._since >= GATHERED_S:
            self.flush()

    def flush(self) -> None:
        """Give all samples that were gathered."""
        rows, self._rows, self._pending = self._rows, {}, 0
        for axis, samples in rows.items():
            try:
                for block in self._blocks(axis, samples):
                    self._give(block)
            except InputError as error:
                self._intake.refuse(error)

    def _gather(self, sample: dict[str, Any]) -> None:
        axis = axis_name(sample.get("axis", self._axis))
        if not all_numbers(sample, self._intake.decoder.keys):
            raise InputError(
                f"axis {axis}: a sample with something else than numbers", mend="send null for none"
            )
        if axis not in self._rows and len(self._rows) >= MOST_AXES:
            raise InputError(f"axis {axis}: more than {MOST_AXES} axes in {GATHERED_S} s")
        if not self._pending:
            self._since = time.monotonic()
        self._rows.setdefault(axis, []).append(sample)
        self._pending += 1
        if self._pending >= MOST_PENDING:
            self.flush()
        self.flush_if_due()

    def _blocks(self, axis: str, rows: list[dict[str, Any]]) -> list[Block]:
        """One block, or several where stamps go back: the axis's order sees to these."""
        with np.errstate(over="ignore"):
            columns = channels_in_si(self._intake.decoder.sources, lambda key: column_of_rows(rows, key))
        time_ = columns.pop("time", np.full(len(rows), np.nan))
        stamped = np.isfinite(time_)
        for _ in range(int((~stamped).sum())):
            self._intake.refuse(InputError(f"axis {axis}: a sample without a time", mend='send "time" in s'))
        time_ = time_[stamped]
        columns = {n: np.where(np.isinf(v), np.nan, v)[stamped] for n, v in columns.items()}
        cuts = np.flatnonzero(np.diff(time_) <= 0.0) + 1
        parts = [p for p in np.split(np.arange(time_.size), cuts) if p.size]
        if parts and not columns:
            raise InputError(
                f"axis {axis}: samples without a channel", mend="name keys as channels, or give a map"
            )
        return [
            Block(
                axis,
                Samples(time_[part], {n: v[part] for n, v in columns.items()}),
                None,
                self._intake.name,
                time.time(),
                **self._more,
            )
            for part in parts
        ]

    def _give(self, block: Block) -> None:
        if self._window is not None and not self._window.wait(self._stop):
            return
        self._intake.take(block)
