"""Alarms by ISA-18.2 (IEC 62682): a pure state machine that is handed all times."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

from fdd.diagnosis.findings import FaultFinding
from fdd.errors import InputError

State = Literal["NORMAL", "UNACK", "ACKED", "RTNUN", "SHELVED"]
STATES: tuple[State, ...] = get_args(State)
STANDING = STATES[1:]

ITSELF = "fdd"
"""Who did what no person did."""
OFF_DELAY_S, CHATTER_S = 60.0, 600.0
"""Of data without evidence, after which an alarm has returned to normal; and after that, within which it is
raised again and no new alarm made."""
QUIET_S = 3600.0
"""Span in which re-raises are counted, and after which an alarm without any no longer chatters."""
MOST_RERAISES = 5
"""In `QUIET_S`; one more and the alarm chatters."""
LONGEST_SHELF_S = 7 * 86400.0
LONGEST_NOTE = 2000
"""Characters of a name or note."""
Priority = Literal["low", "medium", "high", "urgent"]
PRIORITIES: tuple[Priority, ...] = get_args(Priority)
"""From the least on; four, as ISA-18.2 advises at most."""
LEVELS = (0.25, 0.5, 0.75)
"""Severities, 1 being gross, at which the next level begins."""
UNSIZED_LEVEL = 1
"""Of a fault that has no severity (a failed sensor, an unknown fault): neither small nor gross."""
DOUBTED = 0.5
"""Confidence below which an alarm is one priority lower: no fault is then more likely than not."""
AT_ONCE = {"external_leakage", "check_valve_stuck_open", "check_valve_clogged", "relief_valve_stuck_open"}
"""Faults one priority up, for their consequence and the time that is left, by which ISA-18.2 ranks alarms:
oil lost outside does not come back, and a valve that fails takes the force of one direction away at once.
That this is worth one step is an assumption, no figure of the thesis."""


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """One alarm as it stands; JSON-able by `dataclasses.asdict`.

    Attributes
    ----------
    key : family and fault or channel that it was raised with; one alarm at a time has it on an axis.
    fault, channel, severity, confidence, body : of the last finding; body is the whole of it, but for
        `detected_s`, which stays that of the one that raised it.
    priority : low, medium, high or urgent. level : quarters of gross that the severity passed. Neither falls.
    standing : whether the evidence is there, or has not been gone for the off-delay.
    count : how often it was raised. reraised : s, when again within the last hour. chattering : too often.
    time, seen : s of the stream's clock, last look at the axis and last one that saw the evidence.
    raised_time, raised_wall, returned_time, returned_wall : last raised, last returned to normal; s of the
        stream's clock and Unix seconds. acked_wall, shelved_until : Unix seconds.
    """

    id: int
    axis: str
    key: str
    family: str
    fault: str
    state: State
    priority: Priority
    level: int
    time: float
    seen: float
    raised_time: float
    raised_wall: float
    channel: str | None = None
    standing: bool = True
    count: int = 1
    reraised: tuple[float, ...] = ()
    chattering: bool = False
    returned_time: float | None = None
    returned_wall: float | None = None
    acked_by: str | None = None
    acked_wall: float | None = None
    shelved_by: str | None = None
    shelved_until: float | None = None
    note: str = ""
    severity: float | None = None
    confidence: float | None = None
    body: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Transition:
    """What happened to an alarm; each is a record of the audit.

    The state after it is `alarm.state`. `time`: s of the stream's clock, of the last look; `wall`: Unix
    seconds; `notify`: whether people are told; not of what a chattering alarm does.
    """

    action: str
    alarm: Alarm
    before: State
    time: float
    wall: float
    who: str = ITSELF
    note: str = ""
    notify: bool = True


Doing = Literal["acknowledge", "shelve", "unshelve"]
DOINGS: dict[Doing, tuple[str, tuple[State, ...]]] = {
    "acknowledge": ("ACKNOWLEDGED", ("UNACK", "RTNUN")),
    "shelve": ("SHELVED", ("NORMAL", "UNACK", "ACKED", "RTNUN")),
    "unshelve": ("UNSHELVED", ("SHELVED",)),
}
"""What people do, as the audit calls it, and the states that allow it."""


@dataclass(frozen=True)
class Action:
    """What a person does to an alarm, by the token's name; a shelf ends at `until`, Unix seconds."""

    kind: Doing
    alarm_id: int
    who: str
    note: str = ""
    until: float | None = None


class AlarmBook:
    """All alarms of all axes that are not over, numbered from 1 on."""

    def __init__(self) -> None:
        self._alarms: dict[int, Alarm] = {}
        self._next_id = 1

    def alarms(self, axis: str | None = None) -> list[Alarm]:
        """Alarms of an axis, or of all, in the order of their ids; those that are normal for a while too."""
        return [a for a in self._alarms.values() if axis in (None, a.axis)]

    def update(
        self, axis: str, time: float, wall: float, standing: Iterable[FaultFinding]
    ) -> list[Transition]:
        """One look at an axis at a time (s of the stream's clock, Unix seconds): all findings that stand now.

        Where the stream's clock was set back, what ran goes on from there.
        """
        surest: dict[str, FaultFinding] = {}
        for finding in sorted(standing, key=lambda f: -f.confidence):
            surest.setdefault(f"{finding.family}/{finding.channel or finding.fault}", finding)
        mine = {a.id: _at(a, time) for a in self.alarms(axis)}
        # Those that are normal for so long that another one would be a new alarm. One that chatters is the
        # same alarm until it has been quiet, however long the pauses.
        for a in list(mine.values()):
            quiet_s = a.time - (a.time if a.returned_time is None else a.returned_time)
            if a.state == "NORMAL" and not a.chattering and quiet_s > CHATTER_S:
                del mine[a.id], self._alarms[a.id]
        live = {a.key for a in mine.values() if a.state != "NORMAL"}
        out = []
        # Those first whose own alarm is not over: else a fault that looks alike would take it from them.
        for key, finding in sorted(surest.items(), key=lambda item: item[0] not in live):
            alarm = _alarm_of(key, finding, mine.values())
            if alarm is None:
                alarm = Alarm(
                    id=self._next_id, axis=axis, key=key, family=finding.family, state="UNACK",
                    time=time, seen=time, raised_time=time, raised_wall=wall, level=severity_level(finding),
                    priority=priority_of(finding), **_words(finding, finding.detected_s),
                )  # fmt: skip
                self._next_id += 1
                out.append(self._moved("RAISED", alarm, "NORMAL", wall))
            else:
                del mine[alarm.id]
                out += self._seen(alarm, finding, time, wall)
        for unseen in mine.values():
            out += self._unseen(unseen, time, wall)
        return out

    def _seen(self, alarm: Alarm, finding: FaultFinding, time: float, wall: float) -> list[Transition]:
        before, chattered = alarm.state, alarm.chattering
        level = max(alarm.level, severity_level(finding))
        priority = max(alarm.priority, priority_of(finding), key=PRIORITIES.index)
        escalated = (level, priority) != (alarm.level, alarm.priority)
        again = not alarm.standing
        recent = alarm.reraised + (time,) * again
        # A finding that stands is detected anew at each look; people ask when it was told.
        detected = finding.detected_s if again else alarm.body["detected_s"]
        alarm = replace(
            alarm, seen=time, standing=True, level=level, priority=priority, reraised=recent,
            count=alarm.count + again, chattering=chattered or len(recent) > MOST_RERAISES,
            **_words(finding, detected),
        )  # fmt: skip
        if again:
            alarm = replace(alarm, raised_time=time, raised_wall=wall)
        if before == "SHELVED" or not (again or escalated):
            self._alarms[alarm.id] = alarm
            return []
        alarm = replace(alarm, state="UNACK", acked_by=None, acked_wall=None)
        # An escalation is told of a chattering alarm too: it comes once a level at most.
        action, notify = ("RERAISED", not chattered) if again else ("ESCALATED", True)
        return [self._moved(action, alarm, before, wall, notify=notify)]

    def _unseen(self, alarm: Alarm, time: float, wall: float) -> list[Transition]:
        before = alarm.state
        if alarm.standing and time - alarm.seen >= OFF_DELAY_S:
            alarm = replace(alarm, standing=False, returned_time=time, returned_wall=wall)
            if before in ("UNACK", "ACKED"):
                alarm = replace(alarm, state="RTNUN" if before == "UNACK" else "NORMAL")
                return [self._moved("RETURNED", alarm, before, wall, notify=not alarm.chattering)]
        self._alarms[alarm.id] = alarm
        return []

    def act(self, action: Action, wall: float) -> Transition:
        """Do what a person does: see it, silence it for a week at most, or end that, by the evidence.

        Raises InputError: no such alarm, or its state does not allow it.
        """
        done, states = DOINGS[action.kind]
        alarm, id = self._alarms.get(action.alarm_id), action.alarm_id
        if alarm is None:
            raise InputError(f"alarm {id} is over, or there was none", mend="look at the list anew")
        if alarm.state not in states:
            problem = f"alarm {id} cannot be {done.lower()}: it is {alarm.state}"
            raise InputError(problem, mend=f"that is for alarms that are {', '.join(states)}")
        who, until, state = readable(action.who), action.until or 0.0, alarm.state
        if action.kind == "unshelve":
            return self._back(alarm, who, action.note, wall)
        if action.kind == "acknowledge":
            state = "ACKED" if state == "UNACK" else "NORMAL"
            alarm = replace(alarm, acked_by=who, acked_wall=wall)
        elif 0.0 < until - wall <= LONGEST_SHELF_S:
            state = "SHELVED"
            alarm = replace(alarm, shelved_by=who, shelved_until=until)
        else:
            raise InputError("a shelf ends after now and within a week", mend="give another time")
        return self._acted(done, alarm, state, who, action.note, wall)

    def findings(self, axis: str) -> list[FaultFinding]:
        """What the last look at an axis still saw, the surest first; detected when its alarm was raised."""
        seen = [a for a in self.alarms(axis) if a.standing and a.seen >= a.time]
        seen.sort(key=lambda a: -(a.confidence or 0.0))
        return [FaultFinding.model_validate(a.body) for a in seen]

    def remove(self, axis: str, who: str, wall: float) -> list[Transition]:
        """End all alarms of an axis that is watched no longer."""
        out = []
        for alarm in self.alarms(axis):
            if alarm.state != "NORMAL":
                alarm = replace(alarm, standing=False, returned_time=alarm.time, returned_wall=wall)
                out.append(self._acted("REMOVED", alarm, "NORMAL", who, "its axis was removed", wall))
            del self._alarms[alarm.id]
        return out

    def tick(self, wall: float) -> list[Transition]:
        """End the shelves whose time (Unix seconds) has come."""
        due = [a for a in self.alarms() if a.state == "SHELVED" and (a.shelved_until or 0.0) <= wall]
        return [self._back(a, ITSELF, "its time is over", wall) for a in due]

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `Store.book` gave; keys of other versions are left out."""
        known = {f.name for f in fields(Alarm)}
        kept = [{k: v for k, v in a.items() if k in known} for a in state["alarms"]]
        for alarm in kept:
            if alarm["state"] not in STATES:  # of an earlier version: as a shelf whose time is over
                alarm |= {"state": "SHELVED", "shelved_until": 0.0}
        self._alarms = {a["id"]: Alarm(**{**a, "reraised": tuple(a["reraised"])}) for a in kept}
        self._next_id = state["next_id"]

    def _back(self, alarm: Alarm, who: str, note: str, wall: float) -> Transition:
        alarm = replace(alarm, shelved_by=None, shelved_until=None)
        return self._acted("UNSHELVED", alarm, "UNACK" if alarm.standing else "NORMAL", who, note, wall)

    def _acted(self, action: str, alarm: Alarm, state: State, who: str, note: str, wall: float) -> Transition:
        after = replace(alarm, state=state, note=readable(note))
        return self._moved(action, after, alarm.state, wall, who=readable(who), note=after.note)

    def _moved(self, action: str, alarm: Alarm, before: State, wall: float, **said: Any) -> Transition:
        self._alarms[alarm.id] = alarm
        return Transition(action=action, alarm=alarm, before=before, time=alarm.time, wall=wall, **said)


def severity_level(finding: FaultFinding) -> int:
    """How many of `LEVELS` the fault's severity surely passed: the lower end of its 80 % interval counts."""
    least = finding.severity_interval[0] if finding.severity_interval else finding.severity
    return UNSIZED_LEVEL if least is None else bisect_right(LEVELS, least)


def priority_of(finding: FaultFinding) -> Priority:
    """One of `PRIORITIES`. Faults that look alike count as the worst of them."""
    up = bool(AT_ONCE & {finding.fault, *finding.ambiguity})
    place = severity_level(finding) + up - (finding.confidence < DOUBTED)
    return PRIORITIES[min(max(place, 0), len(PRIORITIES) - 1)]


def _alarm_of(key: str, finding: FaultFinding, alarms: Iterable[Alarm]) -> Alarm | None:
    """The alarm that a finding speaks of: its own, or one that is not over of a fault that looks alike, as
    which of an ambiguity group leads may change from look to look."""

    def alike(alarm: Alarm) -> bool:
        same = alarm.family == finding.family and not (alarm.channel or finding.channel)
        grouped = finding.fault in alarm.body["ambiguity"] or alarm.fault in finding.ambiguity
        return alarm.state != "NORMAL" and same and grouped

    fitting = [a for a in alarms if a.key == key or alike(a)]
    return min(fitting, key=lambda a: (a.state == "NORMAL", a.key != key, a.id), default=None)


def _words(finding: FaultFinding, detected_s: float) -> dict[str, Any]:
    """What an alarm takes over of its last finding."""
    body = finding.model_dump(mode="json") | {"detected_s": detected_s}
    return {k: body[k] for k in ("fault", "channel", "severity", "confidence")} | {"body": body}


def _at(alarm: Alarm, time: float) -> Alarm:
    """The alarm at a new look. Where the clock was set back its times move along, so that all spans end."""
    back = min(time - alarm.time, 0.0)
    returned = None if alarm.returned_time is None else alarm.returned_time + back
    again = tuple(t + back for t in alarm.reraised if time - t - back < QUIET_S)
    return replace(
        alarm, time=time, seen=alarm.seen + back, raised_time=alarm.raised_time + back,
        returned_time=returned, reraised=again, chattering=alarm.chattering and bool(again),
    )  # fmt: skip


def readable(text: str) -> str:
    """What somebody wrote, without characters that no database or page takes, and not without end."""
    return "".join(c for c in text if c.isprintable() or c == "\n")[:LONGEST_NOTE]
