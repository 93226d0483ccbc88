"""Which faults stand: raised, seen again or missed at each look, and over in the end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import FaultFinding

LOOKS = 3
"""Looks running that must see a fault: an on-delay of ten seconds (ISA-18.2), as passing oddities pass. As
many must miss it before it stands no more."""
HEALED_S = 60.0
"""s for which a fault has to be gone before it is over: one that comes and goes within a minute stands."""


@dataclass(frozen=True)
class Look:
    """What one look at the evidence gave.

    Attributes
    ----------
    now : s, its time. findings : those that stand. scores : the last looks' largest, with this one's.
    stands : the largest that stood for `LOOKS` looks. labels : family to the hypothesis that leads.
    over : family whose fault seems to be over, to since when (s).
    """

    now: float
    evidence: Evidence
    findings: list[FaultFinding]
    scores: list[float]
    stands: float
    labels: dict[str, str]
    over: dict[str, float]


@dataclass
class Standing:
    """Families of faults over the looks of one axis.

    Attributes
    ----------
    alarms : the first finding of each family that ever was.
    now : families whose evidence stands, and how many looks have missed it.
    labels : of the hypotheses that lead them. sick : s, from when to when others stood.
    healed : families that a fault of was over, told by the evidence.

    Examples
    --------
    >>> Standing().spans()
    []
    """

    alarms: dict[str, FaultFinding] = field(default_factory=dict)
    now: dict[str, tuple[FaultFinding, int]] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    sick: list[tuple[float, float]] = field(default_factory=list)
    healed: set[str] = field(default_factory=set)

    def findings(self) -> list[FaultFinding]:
        """Those that stand."""
        return [finding for finding, _ in self.now.values()]

    def spans(self) -> list[tuple[float, float]]:
        """When something was wrong, s; without an end where it still is."""
        return [*self.sick, *((finding.onset_s, math.inf) for finding in self.findings())]

    def take(self, look: Look, oldest: float) -> tuple[list[FaultFinding], list[tuple[float, float]]]:
        """Take a look.

        Parameters
        ----------
        oldest : s, of the evidence that is kept.

        Returns
        -------
        Findings that are new, and spans (s) of faults that are over: what came in them would look like
        another fault.
        """
        seen = {f.family: f for f in reversed(look.findings)}
        over = []
        for family, since in look.over.items():
            if look.now - since >= HEALED_S and family in self.now:
                finding, _ = self.now.pop(family)
                over.append((finding.onset_s, since))
                self.healed.add(family)
                seen.pop(family, None)
        fresh = [f for family, f in seen.items() if family not in self.now]
        missed = {k: (f, n + 1) for k, (f, n) in self.now.items() if k not in seen}
        gone = [(f.onset_s, look.now) for f, n in missed.values() if n >= LOOKS]
        self.sick = [*(s for s in self.sick if s[1] > oldest), *over, *gone]
        self.now = {k: (f, 0) for k, f in seen.items()} | {k: v for k, v in missed.items() if v[1] < LOOKS}
        self.labels = {k: v for k, v in (self.labels | look.labels).items() if k in self.now}
        self.alarms = {f.family: f for f in fresh} | self.alarms
        return fresh, over

    def past(self, seen: set[str], start: float) -> list[FaultFinding]:
        """Alarms of families not seen now that nothing has refuted: over, or older than `start` (s)."""
        return [
            f for k, f in self.alarms.items() if k not in seen and (f.onset_s < start or k in self.healed)
        ]

    def state(self) -> dict[str, Any]:
        """All of it, as JSON takes it."""
        return {
            "alarms": {k: f.model_dump() for k, f in self.alarms.items()},
            "now": {k: (f.model_dump(), n) for k, (f, n) in self.now.items()},
            "labels": self.labels, "sick": self.sick, "healed": sorted(self.healed),
        }  # fmt: skip

    @classmethod
    def of(cls, state: dict[str, Any]) -> Standing:
        """What `state` gave."""
        return cls(
            alarms={k: FaultFinding.model_validate(f) for k, f in state["alarms"].items()},
            now={k: (FaultFinding.model_validate(f), int(n)) for k, (f, n) in state["now"].items()},
            labels=dict(state["labels"]),
            sick=[(float(a), float(b)) for a, b in state["sick"]],
            healed=set(state["healed"]),
        )
