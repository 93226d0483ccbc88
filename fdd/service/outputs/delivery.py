"""Carries what must arrive from the store's outbox to its targets, each in a thread of its own."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fdd.service import config
from fdd.service.alarms import STATES
from fdd.service.bus import Bus, Kind
from fdd.service.config_sources import read_secret
from fdd.service.outputs.mqtt import MqttPublisher
from fdd.service.outputs.recorder import Recorder
from fdd.service.outputs.targets import JsonLines, Undelivered, Webhook
from fdd.service.store import OutboxMessage, Store

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
    delivered, failed, given_up : messages and attempts so far. pending : messages that wait, at most
        `MOST_TAKEN`. last_error : "" while all is well.
    """

    def __init__(self, target: str, store: Store, deliver: Callable[[OutboxMessage], None]) -> None:
        self.target, self._store, self._deliver = target, store, deliver
        self._failures, self._rests_until = 0, 0.0
        self.delivered = self.failed = self.given_up = self.pending = 0
        self.last_error = ""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        names = ("delivered", "failed", "given_up", "pending", "last_error")
        return {name: getattr(self, name) for name in names}

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
            except Undelivered as error:
                if not self._is_given_up(message, error):
                    return
            except Exception as error:  # one that no target can take must not stop all others for ever
                if not self._is_given_up(message, Undelivered(f"{type(error).__name__}: {error}")):
                    return
            else:
                self._store.delivered(message.id)
                self.delivered += 1
                self._failures = 0
            self.pending -= 1
        self.last_error = ""

    def _is_given_up(self, message: OutboxMessage, error: Undelivered) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        self.failed += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            self._store.give_up(
                message.id,
                f"{message.kind} {message.id} never arrived at {self.target} ({attempts} attempts: {error})",
            )
            self.given_up += 1
            return True
        if not error.down:
            self._store.put_off(message.id)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + max(wait, error.wait_s)
        return False


@dataclass
class _Target:
    """A target: its worker, and what it does with live states."""

    worker: DeliveryWorker
    kinds: Sequence[Kind] = KINDS
    note: Callable[[str, Mapping[str, Any]], None] | None = None
    tick: Callable[[], None] = lambda: None
    about: Callable[[], Mapping[str, Any]] = dict
    lost: int = 0


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
        self._targets: dict[str, _Target] = {}
        self._threads: list[threading.Thread] = []
        self._mqtt: MqttPublisher | None = None
        if settings.mqtt is not None:
            self._mqtt = mqtt = MqttPublisher(settings.mqtt, lambda: store.alarms(STATES[1:]))
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

    def _target(self, name: str, deliver: Callable[[OutboxMessage], None]) -> _Target:
        return self._targets.setdefault(name, _Target(DeliveryWorker(name, self._store, deliver)))

    def targets(self, kind: str, notify: bool = True) -> list[str]:
        """Whom an event of a kind is sent to: the fleet puts a message for each into the outbox.

        Parameters
        ----------
        notify : whether people are told; webhooks hear nothing of what a chattering alarm does.
        """
        return [name for name, t in self._targets.items() if kind in t.kinds and (notify or t.note)]

    def start(self, stop: threading.Event) -> None:
        """Begin, in threads of their own that end soon after `stop`."""
        if self._mqtt is not None:
            self._mqtt.start()
        for target in self._targets.values():
            self._threads.append(threading.Thread(target=self._carry, args=(target, stop), daemon=True))
        if self._recorder is not None:
            self._threads.append(threading.Thread(target=self._recorder.run, args=(stop,), daemon=True))
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
        told = {n: {**t.worker.status(), "lost": t.lost, **t.about()} for n, t in self._targets.items()}
        return told if self._recorder is None else told | {"recording": self._recorder.status()}

    def _carry(self, target: _Target, stop: threading.Event) -> None:
        live: list[Kind] = ["status"] if target.note else []
        events = self._bus.subscribe([*target.kinds, *live])
        looked, failed = -LOOK_S, 0
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if event is not None and event.kind == "status" and target.note:
                    try:
                        target.note(event.axis, event.data)
                    except Undelivered as error:
                        failed, target.worker.last_error = failed + 1, str(error)
                target.lost = events.lost + failed
                told = event is not None and event.kind in target.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    target.tick()
                    target.worker.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                target.worker.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()
