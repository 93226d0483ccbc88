"""Carries what must arrive from the store's outbox to its targets, each in a thread of its own."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fdd.service import config
from fdd.service.alarms import STANDING
from fdd.service.bus import Bus, Kind
from fdd.service.config_sources import read_secret
from fdd.service.outputs.recorder import Recorder
from fdd.service.outputs.targets import JsonLines, MqttPublisher, Undelivered, Webhook
from fdd.service.store import OutboxMessage, Store
from fdd.service.storing import Targets

MOST_TAKEN = 200
"""Messages looked at in one go."""
MOST_ATTEMPTS = 20
"""Of a message that the target refuses for now, some two hours; while the target is down none is counted."""
LONGEST_WAIT_S = 600.0
LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""


class DeliveryWorker:
    """One target's messages, in their order and each at least once: one that fails holds back the next.

    Parameters
    ----------
    target : name in the outbox. deliver : sends one message, or raises `Undelivered`.

    Attributes
    ----------
    kinds : of the messages that it is sent. note : takes an axis's live status; None where it wants none.
    tick : called now and then. about : more for `status`.
    delivered, failed, given_up, lost : messages, attempts and live events so far.
    pending : messages that wait, at most `MOST_TAKEN`. last_error : "" while all is well.
    """

    def __init__(self, target: str, store: Store, deliver: Callable[[OutboxMessage], None]) -> None:
        self.target, self._store, self._deliver = target, store, deliver
        self.kinds: Sequence[Kind] = KINDS
        self.note: Callable[[str, Mapping[str, Any]], None] | None = None
        self.tick: Callable[[], None] = lambda: None
        self.about: Callable[[], Mapping[str, Any]] = dict
        self._failures, self._rests_until = 0, 0.0
        self.delivered = self.failed = self.given_up = self.pending = self.lost = 0
        self.last_error = ""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        names = ("delivered", "failed", "given_up", "pending", "lost", "last_error")
        return {name: getattr(self, name) for name in names} | {**self.about()}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what waits, up to the first message that fails."""
        if time.monotonic() < self._rests_until:
            return
        messages = self._store.outbox(MOST_TAKEN, self.target)
        self.pending = len(messages)
        for message in messages:
            if stopped():
                return
            try:
                self._deliver(message)
            except Exception as error:  # one that no target can take must not stop all others for ever
                if not self._is_given_up(message, error):
                    return
            else:
                self._store.settle(message.id, done=True)
                self.delivered += 1
                self._failures = 0
            self.pending -= 1
        self.last_error = ""

    def _is_given_up(self, message: OutboxMessage, problem: Exception) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        told = f"{type(problem).__name__}: {problem}"
        error = problem if isinstance(problem, Undelivered) else Undelivered(told)
        self.failed += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            never = f"{message.kind} {message.id} never arrived at {self.target}"
            self._store.settle(message.id, done=True, why=f"{never} ({attempts} attempts: {error})")
            self.given_up += 1
            return True
        if not error.down:
            self._store.settle(message.id, done=False)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + max(wait, error.wait_s)
        return False

    def carry(self, bus: Bus, stop: threading.Event) -> None:
        """Deliver what comes, and note live states, until `stop` is set."""
        live: list[Kind] = ["status"] if self.note else []
        events = bus.subscribe([*self.kinds, *live])
        looked, failed = -LOOK_S, 0
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if self.note is not None and event is not None and event.kind == "status":
                    try:
                        self.note(event.axis, event.data)
                    except Undelivered as error:
                        self.last_error, failed = str(error), failed + 1
                self.lost = events.lost + failed
                told = event is not None and event.kind in self.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    self.tick()
                    self.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                self.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()


class Outputs:
    """Everything that tells the outside what the fleet found.

    Parameters
    ----------
    settings : `outputs` of the configuration. store : its outbox holds what must arrive.
    bus : of what may be lost. profile_of : an axis's unit profile (YAML) for its recordings, or None.

    Raises
    ------
    InputError : settings that cannot work: a secret file, a folder, a port.
    """

    def __init__(
        self, settings: config.Outputs, store: Store, bus: Bus, profile_of: Callable[[str], str | None]
    ) -> None:
        self._store, self._bus = store, bus
        self._targets: dict[str, DeliveryWorker] = {}
        self._threads: list[threading.Thread] = []
        self._mqtt: MqttPublisher | None = None
        if settings.mqtt is not None:
            self._mqtt = mqtt = MqttPublisher(settings.mqtt, lambda: store.alarms(STANDING))
            target = self._target("mqtt", mqtt.deliver)
            target.note, target.tick, target.about = mqtt.note, mqtt.tick, mqtt.status
        if settings.jsonl is not None:
            lines = JsonLines(settings.jsonl)
            self._target("jsonl", lines.deliver).note = lines.note
        for hook in settings.webhooks:
            secret = read_secret(hook.secret_file).encode() if hook.secret_file else None
            webhook = Webhook(hook.url, secret)
            self._target(webhook.name, webhook.deliver).kinds = hook.kinds
        kept = settings.recording
        self._recorder = None if kept is None else Recorder(kept, bus, profile_of)

    def _target(self, name: str, deliver: Callable[[OutboxMessage], None]) -> DeliveryWorker:
        return self._targets.setdefault(name, DeliveryWorker(name, self._store, deliver))

    @property
    def targets(self) -> Targets:
        """Whom an event is sent to; webhooks hear nothing of what a chattering alarm does."""
        known = self._targets.items()
        return {
            (kind, notify): [name for name, t in known if kind in t.kinds and (notify or t.note)]
            for kind in KINDS
            for notify in (True, False)
        }

    def start(self, stop: threading.Event) -> None:
        """Begin, in threads of their own that end soon after `stop`."""
        if self._mqtt is not None:
            self._mqtt.start()
        work = [partial(target.carry, self._bus, stop) for target in self._targets.values()]
        if self._recorder is not None:
            work.append(partial(self._recorder.run, stop))
        self._threads = [threading.Thread(target=run, daemon=True) for run in work]
        for thread in self._threads:
            thread.start()

    def join(self, timeout: float = 20.0) -> None:
        """Wait until all have ended, at most so many seconds; what was not delivered stays in the outbox."""
        until = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
        if self._mqtt is not None:
            self._mqtt.stop()

    def status(self) -> dict[str, dict[str, Any]]:
        """Of each target delivered, failed, given_up, pending, lost, last_error; of the recorder its own."""
        told = {name: target.status() for name, target in self._targets.items()}
        return told if self._recorder is None else told | {"recording": self._recorder.status()}
