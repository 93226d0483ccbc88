"""All findings on the sensors: events of one channel and kind are one finding, with their count."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from fdd.sensors.finding import CONFIDENCE, FAILING, Kind, SensorFinding

SAME_INSTANT_S = 0.05


class SensorFindings:
    """Findings so far, by channel and kind.

    Examples
    --------
    >>> found = SensorFindings()
    >>> for at in (1.0, 3.0):
    ...     found.report("position", "slip", at, None, at + 0.5, 1e-3, "jumps by 1 mm")
    >>> [(f.onset_s, f.count, f.size) for f in found.by_onset()]
    [(1.0, 2, 0.002)]
    """

    def __init__(self, findings: Iterable[SensorFinding] = ()) -> None:
        self._found: dict[tuple[str, str], SensorFinding] = {(f.channel, f.kind): f for f in findings}

    def by_onset(self) -> list[SensorFinding]:
        """In the order of their onsets."""
        return sorted(self._found.values(), key=lambda f: (f.onset_s, f.channel, f.kind))

    def get(self, channel: str, kind: Kind) -> SensorFinding | None:
        """The finding, None where there is none."""
        return self._found.get((channel, kind))

    def report(
        self, channel: str, kind: Kind, onset: float, until: float | None, now: float, size: float,
        evidence: str, *, adds: bool = True, count: int = 1, channels: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        """Enter an event; `adds` says whether its size adds to that of the events before."""
        known = self._found.get((channel, kind))
        if known is None:
            self._found[channel, kind] = SensorFinding(
                channel,
                kind,
                onset,
                until,
                now,
                CONFIDENCE[kind],
                size,
                evidence,
                count,
                channels or (channel,),
            )
            return
        again = known.until_s is not None or kind not in FAILING
        self._found[channel, kind] = replace(
            known,
            onset_s=min(known.onset_s, onset),
            until_s=until,
            size=known.size + size if adds else known.size,
            count=known.count + (count if again else 0),
        )

    def close(self, channel: str, at: float) -> None:
        """The channel is good again since `at`."""
        for key, found in self._found.items():
            if channel in found.channels and found.kind in FAILING and found.until_s is None:
                lost = at - found.onset_s if found.kind == "dropout" and found.count == 1 else found.size
                self._found[key] = replace(found, until_s=at, size=lost)

    def rename(self, channel: str, onset: float, kind: Kind, size: float) -> None:
        """What began at `onset` turned out to be of another kind."""
        for key, found in list(self._found.items()):
            if found.channel == channel and found.onset_s == onset and found.kind != kind:
                del self._found[key]
                self._found[channel, kind] = replace(found, kind=kind, size=size)

    def was_slip(self, channel: str, onset: float, kind: Kind, size: float, evidence: str) -> None:
        """A slip, the channel's only one, turned out to be where it failed."""
        slip = self._found.get((channel, "slip"))
        if slip is not None and slip.count == 1 and abs(slip.onset_s - onset) < SAME_INSTANT_S:
            del self._found[channel, "slip"]
            self._found[channel, kind] = replace(slip, kind=kind, size=size, evidence=evidence)

    def merge(self, channels: tuple[str, ...], onset: float, now: float, evidence: str) -> None:
        """Make one lost supply of what these channels' own findings since `onset` say."""
        for key, found in list(self._found.items()):
            of_these = found.channel in channels and found.onset_s >= onset - 0.2
            if of_these and found.kind != "supply_loss":
                del self._found[key]
        self.report(
            channels[0], "supply_loss", onset, None, now, float(len(channels)), evidence,
            adds=False, channels=channels,
        )  # fmt: skip
