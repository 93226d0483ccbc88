"""The alarm book against the rules of ISA-18.2 as written here, by random histories and by single cases."""

import json
import math
from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from fdd.diagnosis.findings import FaultFinding
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.service.alarms import Action, AlarmBook, Transition
from fdd.service.axis import AxisWatch
from fdd.service.status import status_of
from fdd.unit import Unit

# The diagram of the standard, arc by arc: what happens, from, to. Re-alarm of an acknowledged alarm is
# optional there. A shelf ends in an alarm or in normal, never in acknowledged. An escalation of an
# unacknowledged alarm is told and leaves the state.
N, U, A, R, S = "NORMAL", "UNACK", "ACKED", "RTNUN", "SHELVED"
DIAGRAM = {
    ("RAISED", N, U), ("RERAISED", N, U), ("RERAISED", R, U), ("ESCALATED", A, U), ("ESCALATED", U, U),
    ("RETURNED", U, R), ("RETURNED", A, N), ("ACKNOWLEDGED", U, A), ("ACKNOWLEDGED", R, N),
    *(("SHELVED", state, S) for state in (N, U, A, R)), ("UNSHELVED", S, N), ("UNSHELVED", S, U),
}  # fmt: skip
BY_PEOPLE = {"acknowledge": "ACKNOWLEDGED", "shelve": "SHELVED", "unshelve": "UNSHELVED"}
ORDER = ["low", "medium", "high", "urgent"]
LOOK = 5.0
WALL = 1.7e9


def finding(
    fault: str = "pump_wear", family: str = "leakage", low: float | None = 0.1, others: Any = (), **more: Any
) -> FaultFinding:
    """Of at least a severity; `others` are of its ambiguity group."""
    size = {} if low is None else {"severity": low + 0.1, "severity_interval": (low, low + 0.2)}
    usual = {"confidence": 0.9, "onset_s": 1.0, "detected_s": 2.0, **size}
    return FaultFinding(fault=fault, family=family, ambiguity=[fault, *others], **{**usual, **more})


KINDS: dict[str, dict[str, Any]] = {
    "leakage/pump_wear": {},
    "relief_valve/relief_valve_stuck_open": {"fault": "relief_valve_stuck_open", "family": "relief_valve"},
    "sensor/pressure_1": {"fault": "sensor_dropout", "family": "sensor", "channel": "pressure_1"},
    "sensor/pressure_2": {"fault": "sensor_dropout", "family": "sensor", "channel": "pressure_2"},
}


def of(*values: Any) -> st.SearchStrategy[Any]:
    return st.sampled_from(values)


Stands = dict[str, tuple[float | None, float]]
"""Lowest severity and confidence of what stands."""
AXES, KEYS = of("A1", "A2"), of(*sorted(KINDS))
LOWEST = st.none() | of(0.0, 0.24, 0.25, 0.5, 0.75, 1.2)
GAPS = of(LOOK, LOOK, 70.0, 700.0, 4000.0)
STANDS = st.dictionaries(KEYS, st.tuples(LOWEST, of(0.3, 0.9)))


def state_of(book: AlarmBook) -> dict[str, Any]:
    """All of a book, as `AlarmBook.restore` takes it."""
    return {"next_id": book._next_id, "alarms": [asdict(alarm) for alarm in book.alarms()]}


class Plant(RuleBasedStateMachine):
    """Random looks and actions; a second book is restored from JSON again and again and must do the same."""

    def __init__(self) -> None:
        super().__init__()
        self.book, self.twin = AlarmBook(), AlarmBook()
        self.time, self.wall = {"A1": 0.0, "A2": 1e6}, WALL
        self.audit: list[Transition] = []
        self.worst: dict[int, int] = {}

    def told(self, transitions: list[Transition], twins: list[Transition]) -> list[Transition]:
        assert twins == transitions
        self.audit += transitions
        return transitions

    @rule(axis=AXES, stands=STANDS, looks=of(1, 1, 2, 11, 12, 13, 130), gap=GAPS)
    def look(self, axis: str, stands: Stands, looks: int, gap: float) -> None:
        for k in range(looks):
            self.see(axis, stands, gap if k == 0 else LOOK)

    @rule(axis=AXES, key=KEYS, times=st.integers(1, 8), gap=of(60.0, 65.0, 65.0, 595.0, 600.0, 605.0, 3000.0))
    def flutter(self, axis: str, key: str, times: int, gap: float) -> None:
        """It comes for one look and goes, again and again."""
        for _ in range(times):
            self.see(axis, {key: (0.1, 0.9)}, gap)
            for _ in range(12):
                self.see(axis, {}, LOOK)

    def see(self, axis: str, stands: Stands, passed: float) -> None:
        self.time[axis] += passed
        self.wall += LOOK
        found = [finding(**KINDS[key], low=low, confidence=c) for key, (low, c) in stands.items()]
        args = axis, self.time[axis], self.wall, found
        self.told(self.book.update(*args), self.twin.update(*args))
        seen = {a.key: a for a in self.book.alarms(axis) if a.standing and a.seen == self.time[axis]}
        assert seen.keys() == stands.keys() and {a.state for a in seen.values()} <= {U, A, S}

    @rule(data=st.data(), action=of(*sorted(BY_PEOPLE)), passed=of(0.0, 40.0, 4000.0))
    def act(self, data: st.DataObject, action: str, passed: float) -> None:
        self.wall += passed
        ids = sorted({a.id for a in self.book.alarms()} | {999})
        id = data.draw(of(*ids))
        done_by = Action(action, id, "ann", "a note", self.wall + 300.0)
        state = {a.id: a.state for a in self.book.alarms()}.get(id)
        if not any(a == BY_PEOPLE[action] and before == state for a, before, _ in DIAGRAM):
            before_it = json.dumps(state_of(self.book))
            for book in (self.book, self.twin):
                with pytest.raises(InputError):
                    book.act(done_by, self.wall)
            assert json.dumps(state_of(self.book)) == before_it
            return
        (done,) = self.told([self.book.act(done_by, self.wall)], [self.twin.act(done_by, self.wall)])
        told = BY_PEOPLE[action], "ann", "a note", self.wall, True
        assert (done.action, done.who, done.note, done.wall, done.notify) == told

    @rule(passed=of(1.0, 299.0, 300.0, 9000.0))
    def clock(self, passed: float) -> None:
        self.wall += passed
        due = {a.id for a in self.book.alarms() if a.state == S and (a.shelved_until or 0.0) <= self.wall}
        over = self.told(self.book.tick(self.wall), self.twin.tick(self.wall))
        assert {t.alarm.id for t in over} == due
        assert {t.action for t in over} <= {"UNSHELVED"}

    @rule()
    def restart(self) -> None:
        state = json.loads(json.dumps(state_of(self.twin)))
        self.twin = AlarmBook()
        self.twin.restore(state)

    @invariant()
    def every_transition_is_an_arc_and_on_record(self) -> None:
        states: dict[int, str] = {}
        for t in self.audit:
            assert (t.action, t.before, t.alarm.state) in DIAGRAM
            assert t.before == states.get(t.alarm.id, N)
            states[t.alarm.id] = t.alarm.state
        for alarm in self.book.alarms():
            assert states[alarm.id] == alarm.state
        gone = set(states) - {a.id for a in self.book.alarms()}
        assert {states[id] for id in gone} <= {N}

    @invariant()
    def priorities_never_fall(self) -> None:
        for alarm in self.book.alarms():
            place = ORDER.index(alarm.priority)
            assert place >= self.worst.get(alarm.id, 0)
            self.worst[alarm.id] = place


# A history is not shortened when it fails: that takes many minutes, and its last steps tell enough.
Plant.TestCase.settings = settings(
    max_examples=60, stateful_step_count=30, phases=[Phase.explicit, Phase.generate]
)
TestPlant = pytest.mark.slow(Plant.TestCase)


class Looks:
    """One axis, a look each five seconds."""

    def __init__(self) -> None:
        self.book, self.time = AlarmBook(), 0.0

    def __call__(self, *found: FaultFinding, seconds: float = LOOK) -> list[tuple[str, str]]:
        out = []
        for _ in range(round(seconds / LOOK)):
            self.time += LOOK
            out += self.book.update("A1", self.time, WALL + self.time, found)
        return [(t.action, t.alarm.fault) for t in out]


def test_a_whole_life():
    look = Looks()
    assert look(finding()) == [("RAISED", "pump_wear")]
    assert look.book.act(Action("acknowledge", 1, "ann", "on my way"), WALL).alarm.acked_by == "ann"
    assert look(seconds=55.0) == []
    assert look() == [("RETURNED", "pump_wear")]
    assert look.book.alarms()[0].state == N
    assert look(seconds=600.0) == [] and look.book.alarms() != []
    assert look() == [] == look.book.alarms()
    assert look(finding()) == [("RAISED", "pump_wear")]
    assert look.book.alarms()[0].id == 2


def test_a_second_fault_has_an_alarm_of_its_own_unless_it_is_of_the_firsts_ambiguity_group():
    look = Looks()
    look(finding())
    assert look(finding(), finding("aeration", "aeration")) == [("RAISED", "aeration")]
    assert look(finding(), finding("internal_leakage")) == [("RAISED", "internal_leakage")]
    look = Looks()
    look(finding(others=("internal_leakage",)))
    assert look(finding("internal_leakage", others=("pump_wear",))) == []
    (alarm,) = look.book.alarms()
    assert (alarm.key, alarm.fault) == ("leakage/pump_wear", "internal_leakage")
    # Both at once are two, and the one that was there keeps its own.
    both = finding("internal_leakage", others=("pump_wear",), confidence=0.99), finding()
    assert look(*both) == [("RAISED", "internal_leakage")]
    assert [(a.id, a.fault) for a in look.book.alarms()] == [(1, "pump_wear"), (2, "internal_leakage")]


@pytest.mark.parametrize(
    ("found", "priority"),
    [
        (finding(low=0.24), "low"),
        (finding(low=0.25), "medium"),
        (finding(low=0.5), "high"),
        (finding(low=0.75), "urgent"),
        (finding(low=0.5, confidence=0.49), "medium"),
        (finding("external_leakage", low=0.1), "medium"),
        (finding(low=0.1, others=("external_leakage",)), "medium"),
        (finding("check_valve_clogged", "check_valve", low=0.9), "urgent"),
        (finding("sensor_dropout", "sensor", low=None), "medium"),
        (finding(low=0.0, confidence=0.3), "low"),
    ],
)
def test_priority(found, priority):
    look = Looks()
    look(found)
    assert look.book.alarms()[0].priority == priority


def test_a_growing_fault_asks_for_attention_again_once_a_level():
    look = Looks()
    look(finding(low=0.2))
    look.book.act(Action("acknowledge", 1, "ann"), WALL)
    assert look(finding(low=0.3), seconds=60.0) == [("ESCALATED", "pump_wear")]
    assert look.book.alarms()[0].state == U
    # Wavering about the limit is not told again.
    assert [look(finding(low=low)) for low in (0.2, 0.3, 0.24, 0.26)] == [[], [], [], []]
    assert look(finding(low=0.8)) == [("ESCALATED", "pump_wear")]
    assert look.book.alarms()[0].priority == "urgent"


def test_a_clock_that_is_set_back_neither_ends_an_alarm_nor_holds_it_for_ever():
    book = AlarmBook()
    book.update("A1", 1e6, WALL, [finding()])
    book.update("A1", 1e6 + 50.0, WALL + 50.0, [])
    assert book.update("A1", 0.0, WALL + 51.0, []) == []
    assert [t.action for t in book.update("A1", 10.0, WALL + 61.0, [])] == ["RETURNED"]


def test_a_shelf_ends_within_a_week_and_what_people_write_is_kept_as_text_and_no_more():
    look = Looks()
    look(finding())
    for ahead in (0.0, -1.0, 7 * 86400.0 + 1.0, math.inf, math.nan):
        with pytest.raises(InputError, match="within a week"):
            look.book.act(Action("shelve", 1, "ann", until=WALL + ahead), WALL)
    assert look.book.alarms()[0].state == U
    note = "naïve 油\nsecond line\x1b[31m" + "x" * 3000
    said = look.book.act(Action("acknowledge", 1, "ann\x00\ud800", note), WALL)
    assert said.who == "ann" and len(said.note) == 2000
    assert said.note.startswith("naïve 油\nsecond line[31mxx")


def test_state_of_another_version_is_read_as_far_as_it_is_known():
    look, book = Looks(), AlarmBook()
    look(finding())
    state = state_of(look.book)
    state["alarms"][0]["colour"] = "red"
    book.restore(state)
    assert book.alarms() == look.book.alarms()
    # A store of before has alarms that were out of service: they are told again, or over.
    state["alarms"][0]["state"] = "OUT_OF_SERVICE"
    book.restore(state)
    assert [(t.alarm.id, t.action, t.alarm.state) for t in book.tick(WALL)] == [(1, "UNSHELVED", "UNACK")]


def test_a_chattering_alarm_stays_one_alarm_and_is_silent_until_it_was_quiet_for_an_hour():
    book, time, told = AlarmBook(), 0.0, []
    for found in ([finding()], *[[]] * 13) * 9:  # for one look, and 65 s not
        time += LOOK
        told += [(t.action, t.notify) for t in book.update("A1", time, WALL, found)]
    assert [action for action, _ in told] == ["RAISED", "RETURNED", *["RERAISED", "RETURNED"] * 8]
    # The sixth re-raise is told still, and that it chatters with it; nothing is from there on.
    assert [notify for _, notify in told] == [True] * 13 + [False] * 5
    (alarm,) = book.alarms()
    assert (alarm.count, alarm.chattering) == (9, True)
    # Raised again after more than the usual ten minutes: the same alarm, as it was not quiet for an hour.
    assert [t.notify for t in book.update("A1", time + 3000.0, WALL, [finding()])] == [False]
    book.update("A1", time + 6599.0, WALL, [finding()])
    assert book.alarms()[0].chattering
    book.update("A1", time + 6600.0, WALL, [finding()])
    assert not book.alarms()[0].chattering
    assert [t.notify for t in book.update("A1", time + 6660.0, WALL, [])] == [True]


def test_the_headline_is_what_the_last_look_still_sees():
    """A weak valve alarm was a leak's first sign: more urgent by its kind, but no look sees it any more."""
    look, watch = Looks(), AxisWatch("A1", Unit.load("axis_a"), Model.load())
    valve = finding("relief_valve_stuck_open", "relief_valve", low=None, severity=0.1, confidence=0.6)
    leak = finding("internal_leakage", low=None, severity=0.2, confidence=0.9999)
    for found, words in (([valve], "Relief"), ([valve, leak], "Relief"), ([leak], "Internal leakage")):
        look(*found)
        headline = status_of(watch, look.book.alarms("A1"), {}, look.time).headline
        assert headline.startswith(words)
    assert ", over 99 % sure, since" in headline
