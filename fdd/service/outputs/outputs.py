"""The dispatcher: a thread for each target, so that one that is slow or away holds up no other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from fdd.samples import Samples
from fdd.service.outputs.courier import Courier, Undelivered
from fdd.service.outputs.doors import Bus, Kind, Parcel, Store, read_secret
from fdd.service.outputs.foxglove import Foxglove, FoxgloveSettings
from fdd.service.outputs.json_lines import JsonLines
from fdd.service.outputs.metrics import ALARM_STATES
from fdd.service.outputs.mqtt import MqttPublisher, MqttSettings
from fdd.service.outputs.recorder import Recorder, RecordingSettings
from fdd.service.outputs.webhook import Webhook

LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""


class WebhookSettings(Protocol):
    """Of the configuration, one of `outputs: webhooks`; `kinds` out of alarm and finding."""

    @property
    def url(self) -> str: ...
    @property
    def secret_file(self) -> Path | None: ...
    @property
    def kinds(self) -> Sequence[Kind]: ...


class Settings(Protocol):
    """Of the configuration, `outputs`; None where an output is not wanted."""

    @property
    def mqtt(self) -> MqttSettings | None: ...
    @property
    def webhooks(self) -> Sequence[WebhookSettings]: ...
    @property
    def jsonl(self) -> Path | None: ...
    @property
    def recording(self) -> RecordingSettings | None: ...
    @property
    def foxglove(self) -> FoxgloveSettings | None: ...


@dataclass
class _Line:
    """A target: its courier, and what it does with live states."""

    courier: Courier
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

    Attributes
    ----------
    recorder, foxglove : take the samples, by `push`; None where they are not wanted.

    Raises
    ------
    InputError : settings that cannot work: a URL, a secret file, a folder.

    Examples
    --------
    >>> outputs = Outputs(config.outputs, store, bus)  # doctest: +SKIP
    >>> outputs.start(stop)  # doctest: +SKIP
    >>> for target in outputs.targets("alarm"):  # doctest: +SKIP
    ...     t.send("alarm", body, target)
    """

    def __init__(
        self,
        settings: Settings,
        store: Store,
        bus: Bus,
        profile_of: Callable[[str], str | None] = lambda axis: None,
    ) -> None:
        self._store, self._bus = store, bus
        self._lines: dict[str, _Line] = {}
        self._threads: list[threading.Thread] = []
        self._mqtt: MqttPublisher | None = None
        if settings.mqtt is not None:
            self._mqtt = mqtt = MqttPublisher(settings.mqtt, lambda: store.alarms(ALARM_STATES))
            line = self._line("mqtt", mqtt.deliver)
            line.note, line.tick, line.about = mqtt.note, mqtt.tick, mqtt.status
        if settings.jsonl is not None:
            lines = JsonLines(settings.jsonl)
            self._line("jsonl", lines.deliver).note = lines.note
        for hook in settings.webhooks:
            secret = read_secret(hook.secret_file).encode() if hook.secret_file else None
            webhook = Webhook(hook.url, secret)
            self._line(webhook.name, webhook.deliver).kinds = tuple(hook.kinds)
        self.recorder = Recorder(settings.recording, bus, profile_of) if settings.recording else None
        self.foxglove = Foxglove(settings.foxglove, bus) if settings.foxglove else None
        self._live = {"recording": self.recorder, "foxglove": self.foxglove}

    def _line(self, target: str, deliver: Callable[[Parcel], None]) -> _Line:
        return self._lines.setdefault(target, _Line(Courier(target, self._store, deliver)))

    def push(self, axis: str, samples: Samples) -> None:
        """Hand over an axis's next samples, in the order of time (any thread; costs next to nothing)."""
        for live in self._live.values():
            if live is not None:
                live.push(axis, samples)

    def targets(self, kind: str, notify: bool = True) -> list[str]:
        """Whom an event of a kind is sent to: the fleet puts a row for each into the outbox.

        Parameters
        ----------
        notify : whether people are told; webhooks hear nothing of what a chattering alarm does.
        """
        lines = self._lines.items()
        return [name for name, line in lines if kind in line.kinds and (notify or line.note)]

    def start(self, stop: threading.Event) -> None:
        """Begin, in threads of their own that end soon after `stop`."""
        if self._mqtt is not None:
            self._mqtt.start()
        works: dict[str, Callable[[], None]] = {
            target: lambda line=line: self._carry(line, stop)  # type: ignore[misc]
            for target, line in self._lines.items()
        }
        for name, live in self._live.items():
            if live is not None:
                works[name] = partial(live.run, stop)
        for target, work in works.items():
            thread = threading.Thread(target=work, name=f"output {target}", daemon=True)
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
        told = {
            target: {**line.courier.status(), "lost": line.lost, **line.about()}
            for target, line in self._lines.items()
        }
        return told | {name: live.status() for name, live in self._live.items() if live is not None}

    def _carry(self, line: _Line, stop: threading.Event) -> None:
        live: list[Kind] = ["status"] if line.note else []
        events = self._bus.subscribe([*line.kinds, *live])
        looked = -LOOK_S
        failed = 0
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if event is not None and event.kind == "status" and line.note:
                    try:
                        line.note(event.axis, event.data)
                    except Undelivered as error:
                        failed, line.courier.last_error = failed + 1, str(error)
                line.lost = events.lost + failed
                told = event is not None and event.kind in line.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    line.tick()
                    line.courier.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                line.courier.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()
