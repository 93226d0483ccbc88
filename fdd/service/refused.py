"""Axes that send and cannot be watched: why, and how much of theirs was refused."""

from __future__ import annotations

import logging
from collections.abc import Collection

from fdd.service.status import AxisStatus

LOG = logging.getLogger("fdd.service")
MOST_REFUSED = 100
"""Names that are known, as strangers may give any number."""


class Refused(dict[str, AxisStatus]):
    """By name; the oldest go beyond `MOST_REFUSED`."""

    def note(self, name: str, why: str, samples: int = 0) -> Collection[str]:
        """Count samples that are refused, and why; names that are known no more."""
        if name not in self:
            LOG.warning("%s", why)
            self[name] = AxisStatus(name=name, unit="", state="failed", headline=why, quality={"refused": 0})
        self[name].headline = why
        self[name].quality["refused"] += samples
        gone = [*self][: max(0, len(self) - MOST_REFUSED)]
        for oldest in gone:
            del self[oldest]
        return gone
