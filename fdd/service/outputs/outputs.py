"""The dispatcher: a thread for each target, so that one that is slow or away holds up no other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fdd.service import config
from fdd.service.alarms import STATES
from fdd.service.bus import Bus, Kind
from fdd.service.config_sources import read_secret
from fdd.service.outputs.delivery import DeliveryWorker, Undelivered
from fdd.service.outputs.foxglove import Foxglove
from fdd.service.outputs.json_lines import JsonLines
from fdd.service.outputs.mqtt import MqttPublisher
from fdd.service.outputs.recorder import Recorder
from fdd.service.outputs.webhook import Webhook
from fdd.service.store import OutboxMessage, Store

LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""


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
        self._live: dict[str, Recorder | Foxglove] = {}
        if settings.recording is not None:
            self._live["recording"] = Recorder(settings.recording, bus, profile_of)
        if settings.foxglove is not None:
            self._live["foxglove"] = Foxglove(settings.foxglove, bus)

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
        for name, target in self._targets.items():
            self._begin(name, self._carry, target, stop)
        for name, live in self._live.items():
            self._begin(name, live.run, stop)

    def _begin(self, name: str, work: Callable[..., None], *given: Any) -> None:
        thread = threading.Thread(target=work, args=given, name=f"output {name}", daemon=True)
        thread.start()
        self._threads.append(thread)

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
        return told | {name: live.status() for name, live in self._live.items()}

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
