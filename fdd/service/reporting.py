"""What is said of an axis: its state and the reason, in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fdd.faults import fault
from fdd.service.alarms import Alarm
from fdd.service.axis import AxisWatch
from fdd.service.priority import PRIORITIES
from fdd.service.status import AxisStatus

SILENT_S = 10.0
"""s without a sample after which an axis is told to be silent."""
STANDING = ("UNACK", "ACKED", "RTNUN")


def status_of(
    watch: AxisWatch, alarms: Sequence[Alarm], counters: Mapping[str, float], now: float
) -> AxisStatus:
    """How an axis stands.

    Parameters
    ----------
    alarms : of this axis. counters : of the inbox. now : Unix seconds.
    """
    live = [a for a in alarms if a.state in STANDING]
    open_ = [a for a in live if a.state in ("UNACK", "RTNUN")]
    silent = watch.last_wall is None or abs(now - watch.last_wall) > SILENT_S
    state = (
        "failed" if watch.failed else "unacknowledged" if open_ else "in alarm" if live
        else "silent" if silent else "learning" if watch.learning is not None else "healthy"
    )  # fmt: skip
    dropped = int(counters.get("dropped_samples", 0))
    return AxisStatus(
        name=watch.name, unit=watch.unit.name, state=state, headline=_headline(watch, live, state),
        last_wall=watch.last_wall, lag_s=float(counters.get("lag_s", 0.0)), samples=watch.samples,
        rate_hz=watch.rate_hz,
        verdict=(
            "faulty" if watch.standing else "inconclusive" if state in ("failed", "learning") else "healthy"
        ),
        probabilities=watch.probabilities,
        estimates={n: e.model_dump(mode="json") for n, e in watch.estimates.items()},
        quality=watch.quality() | {"overrun": dropped}, alarms=len(live), unacknowledged=len(open_),
        priority=max((a.priority for a in live), key=PRIORITIES.index, default=None),
    )  # fmt: skip


def _headline(watch: AxisWatch, live: Sequence[Alarm], state: str) -> str:
    if watch.failed:
        return watch.failed
    if live:
        # What the last look still saw comes before what waits to return: it may have been the same fault.
        worst = max(live, key=lambda a: (a.seen >= a.time, PRIORITIES.index(a.priority), a.confidence or 0.0))
        size = "" if worst.severity is None else f", severity {worst.severity:.2f}"
        sure = "" if worst.confidence is None else f", {100 * worst.confidence:.0f} % sure"
        gone = "" if worst.standing else "; it is gone"
        return (
            f"{fault(worst.fault).title.capitalize()}{size}{sure}, since {worst.body['onset_s']:.0f} s{gone}"
        )
    if state == "silent":
        return "No samples come"
    if watch.learning is not None:
        return "Learning what is normal; until then only changes are told"
    return "No fault found"
