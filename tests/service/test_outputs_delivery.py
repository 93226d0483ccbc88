"""What must arrive does, in its order, however often the target fails."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import pytest
from outputs_fakes import sent, transition

from fdd.service.outputs import delivery
from fdd.service.outputs.delivery import LONGEST_WAIT_S, MOST_ATTEMPTS, DeliveryWorker, Undelivered
from fdd.service.store import OutboxMessage, Store


class Clock:
    now = 1000.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(delivery, "time", SimpleNamespace(monotonic=lambda: made.now))
    monkeypatch.setattr(delivery, "random", SimpleNamespace(uniform=lambda low, high: high))
    return made


class Target:
    """Takes messages, or fails as it is told to, by the message's id."""

    def __init__(self, failures: dict[int, list[Undelivered]]) -> None:
        self.failures, self.taken, self.tried = failures, list[int](), list[int]()

    def __call__(self, message: OutboxMessage) -> None:
        self.tried.append(message.id)
        if waiting := self.failures.get(message.id):
            raise waiting.pop(0)
        self.taken.append(message.id)


def given_up(store: Store) -> list[str]:
    return [r["note"] for r in store.audit() if r["action"] == "GIVEN_UP"]


def test_a_failure_holds_back_what_comes_after_it(store: Store, clock: Clock) -> None:
    first, second = (sent(store, "alarm", transition(id=id), "t") for id in (1, 2))
    sent(store, "alarm", transition(), "another target")
    target = Target({second: [Undelivered("500")]})
    worker = DeliveryWorker("t", store, target)
    worker.once()
    assert target.taken == [first]
    assert (worker.failed, worker.delivered, worker.pending, worker.last_error) == (1, 1, 1, "500")
    worker.once()
    assert target.tried == [first, second], "nothing is tried before its time"
    clock.now += 2.1
    worker.once()
    assert target.taken == [first, second] and worker.pending == 0 and not worker.last_error
    assert store.outbox(9, "t") == [] and len(store.outbox(9, "another target")) == 1


def attempts(store: Store, clock: Clock, worker: DeliveryWorker, most: int) -> list[float]:
    """Times of the attempts."""
    times: list[float] = []
    while store.outbox(1, "t") and len(times) < most:
        failed = worker.failed
        worker.once()
        times += [clock.now] * (worker.failed > failed)
        clock.now += 0.5 if len(times) < 6 else 50.0
    return times


def test_waits_double_up_to_a_bound_and_an_end_that_is_audited(store: Store, clock: Clock) -> None:
    id = sent(store, "finding", {"axis": "A1"}, "t")
    worker = DeliveryWorker("t", store, Target({id: [Undelivered("500 no")] * MOST_ATTEMPTS}))
    times = attempts(store, clock, worker, 10 * MOST_ATTEMPTS)
    waits = [b - a for a, b in pairwise(times)]
    for k, wait in enumerate(waits, 1):
        wanted = min(2.0**k, LONGEST_WAIT_S)
        assert wanted <= wait <= wanted + 50.0 * (k > 5), "a step of the clock later at most"
    assert worker.given_up == 1
    assert given_up(store) == [f"finding {id} never arrived at t ({MOST_ATTEMPTS} attempts: 500 no)"]


def test_while_the_target_is_down_nothing_is_given_up(store: Store, clock: Clock) -> None:
    id = sent(store, "finding", {"axis": "A1"}, "t")
    down = [Undelivered("refused", down=True) for _ in range(3 * MOST_ATTEMPTS)]
    worker = DeliveryWorker("t", store, Target({id: down}))
    assert len(attempts(store, clock, worker, 3 * MOST_ATTEMPTS)) == 3 * MOST_ATTEMPTS
    assert worker.given_up == 0 and store.outbox(1, "t")[0].attempts == 0
    clock.now += LONGEST_WAIT_S
    worker.once()
    assert store.outbox(1, "t") == [] and worker.delivered == 1


def test_attempts_are_counted_over_a_restart(store: Store, clock: Clock) -> None:
    id = sent(store, "finding", {"axis": "A1"}, "t")
    for _ in range(MOST_ATTEMPTS):
        DeliveryWorker("t", store, Target({id: [Undelivered("500")]})).once()
    assert len(given_up(store)) == 1


@pytest.mark.parametrize("final", [True, False])
def test_what_will_never_arrive_is_given_up_and_the_next_goes_on(
    store: Store, clock: Clock, monkeypatch: pytest.MonkeyPatch, final: bool
) -> None:
    monkeypatch.setattr(delivery, "MOST_ATTEMPTS", 1)
    first, second = (sent(store, "alarm", transition(a), "t") for a in ("RAISED", "RETURNED"))
    error = Undelivered("400 not like this", final=True) if final else KeyError("axis")
    target = Target({first: [error]})  # type: ignore[list-item]
    DeliveryWorker("t", store, target).once()
    assert target.taken == [second]
    assert ("400 not like this" if final else "KeyError: 'axis'") in given_up(store)[0]
