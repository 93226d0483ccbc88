"""What must arrive does, in the order of each alarm, however often the target fails."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from outputs_fakes import FakeParcel, FakeStore, transition

from fdd.service.outputs.courier import LONGEST_WAIT_S, MOST_ATTEMPTS, Courier, Undelivered
from fdd.service.outputs.doors import Parcel


class Clock:
    now = 1.7e9

    def __call__(self) -> float:
        return self.now


class Target:
    """Takes parcels, or fails as it is told to, by the parcel's id."""

    def __init__(self, failures: dict[int, list[Undelivered]]) -> None:
        self.failures, self.taken, self.tried = failures, [], []

    def __call__(self, parcel: Parcel) -> None:
        self.tried.append(parcel.id)
        if waiting := self.failures.get(parcel.id):
            raise waiting.pop(0)
        self.taken.append(parcel)


def courier(store: FakeStore, target: Target, clock: Clock, chance: float = 1.0) -> Courier:
    return Courier("t", store, target, wall=clock, chance=lambda: chance)


def test_a_failure_holds_back_its_own_alarm_and_no_other() -> None:
    store, clock = FakeStore(), Clock()
    first, other, second = (
        store.send("alarm", transition(action, id=id), "t")
        for action, id in (("RAISED", 1), ("RAISED", 2), ("RETURNED", 1))
    )
    target = Target({first: [Undelivered("500")]})
    carrier = courier(store, target, clock)
    carrier.once()
    assert [p.id for p in target.taken] == [other]
    assert (carrier.failed, carrier.delivered, carrier.pending) == (1, 1, 2)
    carrier.once()
    assert target.tried == [first, other], "nothing is tried before its time"
    clock.now += 3.0
    carrier.once()
    assert [p.id for p in target.taken] == [other, first, second]
    assert carrier.pending == 0 and not carrier.last_error


def test_a_target_that_is_down_is_left_alone_for_as_long_as_it_asks() -> None:
    store, clock = FakeStore(), Clock()
    ids = [store.send("alarm", transition(id=k), "t") for k in (1, 2)]
    target = Target({ids[0]: [Undelivered("503", wait_s=100.0, down=True)]})
    carrier = courier(store, target, clock)
    for seconds in (0.0, 50.0, 49.0):
        clock.now += seconds
        carrier.once()
        assert target.tried == ids[:1]
    clock.now += 1.5
    carrier.once()
    assert [p.id for p in target.taken] == ids


@pytest.mark.parametrize(("chance", "share"), [(0.0, 0.5), (1.0, 1.0)])
def test_waits_double_up_to_a_bound_and_an_end_that_is_audited(chance: float, share: float) -> None:
    store, clock = FakeStore(), Clock()
    id = store.send("finding", {"axis": "A1"}, "t")
    carrier = courier(store, Target({id: [Undelivered("500 no")] * MOST_ATTEMPTS}), clock, chance)
    begun, times = clock.now, []
    for _ in range(MOST_ATTEMPTS):
        times.append(clock.now)
        carrier.once()
        clock.now = store.rows[id].next_wall if id in store.rows else clock.now
    waits = [b - a for a, b in pairwise(times)]
    assert waits[:9] == pytest.approx([share * min(2.0**k, LONGEST_WAIT_S) for k in range(1, 10)], abs=1e-3)
    assert max(waits) <= LONGEST_WAIT_S + 1e-3
    assert 0.5 < (clock.now - begun) / 86400 < 1.5
    assert not store.rows and carrier.given_up == 1
    assert store.audited == [f"finding {id} never arrived at t ({MOST_ATTEMPTS} attempts: 500 no)"]


def test_what_will_never_arrive_is_given_up_at_once_and_the_next_goes_on() -> None:
    store = FakeStore()
    first, second = (store.send("alarm", transition(a), "t") for a in ("RAISED", "RETURNED"))
    target = Target({first: [Undelivered("400 not like this", final=True)]})
    courier(store, target, Clock()).once()
    assert [p.id for p in target.taken] == [second]
    assert "400 not like this" in store.audited[0]


def test_one_that_no_target_can_take_stops_no_other() -> None:
    store = FakeStore()
    first, second = (store.send("finding", {"axis": "A1"}, "t") for _ in range(2))
    target = Target({first: [KeyError("axis")]})  # type: ignore[list-item]
    carrier = courier(store, target, Clock())
    carrier.once()
    assert [p.id for p in target.taken] == [second]
    assert store.rows[first].attempts == 1 and carrier.last_error == "KeyError: 'axis'"


def test_a_clock_that_is_set_back_delays_nothing_for_years() -> None:
    store, clock = FakeStore(), Clock()
    store.rows[1] = FakeParcel(1, "alarm", transition(), "t", 1, clock.now + 3e7)
    target = Target({})
    courier(store, target, clock).once()
    assert [p.id for p in target.taken] == [1]


@given(
    st.lists(st.integers(1, 4), min_size=1, max_size=12),
    st.dictionaries(st.integers(1, 12), st.lists(st.booleans(), max_size=4), max_size=6),
)
def test_all_arrive_and_each_alarm_in_order(alarms: list[int], failing: dict[int, list[bool]]) -> None:
    store, clock = FakeStore(), Clock()
    for alarm in alarms:
        store.send("alarm", transition(id=alarm), "t")
    target = Target({id: [Undelivered("x", down=down) for down in downs] for id, downs in failing.items()})
    carrier = courier(store, target, clock)
    for _ in range(200):
        carrier.once()
        clock.now += 5.0
    assert not store.rows
    for alarm in set(alarms):
        ids = [p.id for p in target.taken if p.body["alarm"]["id"] == alarm]
        assert ids == [k for k, of in enumerate(alarms, 1) if of == alarm]
