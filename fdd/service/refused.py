"""Axes that send and cannot be watched: why, and what was refused of them."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

from fdd.service.status import AxisStatus

LOG = logging.getLogger("fdd.service")
MOST_REFUSED = 100
"""Names that are known; strangers may give any number."""
MOST_TOLD = 3


@dataclass
class _Axis:
    why: str
    samples: int = 0
    heard: float = math.inf


class Refused(dict[str, _Axis]):
    """By name: reason, samples that were refused, when the axis was last heard (s; infinite in the store)."""

    def note(self, name: str, why: str, samples: int = 0, now: float = math.inf) -> None:
        """Refuse some samples of an axis."""
        if name not in self:
            LOG.warning("%s", why)
        axis = self.setdefault(name, _Axis(why))
        axis.why, axis.heard, axis.samples = why, now, axis.samples + samples
        while len(self) > MOST_REFUSED:
            del self[next(iter(self))]

    def forget(self, now: float, silence: float) -> None:
        """Forget axes that were not heard for so long (s)."""
        for name in [n for n, axis in self.items() if silence < now - axis.heard < math.inf]:
            del self[name]

    def problems(self) -> list[str]:
        """Why the first ones are refused, a line each."""
        return [axis.why for axis in list(self.values())[:MOST_TOLD]]

    def statuses(self) -> list[AxisStatus]:
        """How each stands."""
        return [
            AxisStatus(
                name=name, unit="", state="failed", headline=axis.why, quality={"refused": axis.samples}
            )
            for name, axis in self.items()
        ]
