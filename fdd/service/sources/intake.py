"""What all sources share: blocks handed on, counts and the last error kept, threads that end heard."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from fdd.errors import InputError
from fdd.service.blocks import Block, Decoder, nothing

Put = Callable[[Block], None]


class Intake:
    """Counts and hands on what one source receives; from any thread.

    Parameters
    ----------
    name : of the source. decoder : of its messages. unit : profile of blocks that name none.

    Examples
    --------
    >>> intake = Intake("rig")
    >>> intake.refuse(InputError("not a block"))
    >>> intake.status()["refused"], intake.status()["last_error"]
    (1, 'not a block')
    """

    def __init__(self, name: str, decoder: Decoder | None = None, unit: str | None = None) -> None:
        self.name, self.decoder, self._unit = name, decoder or Decoder(), unit
        self.put: Put = _nowhere
        self._lock = threading.Lock()
        self._counts = {"received": 0, "refused": 0, "reconnects": 0}
        self._state: dict[str, Any] = {"connected": False, "last_error": None}
        self._ignored: dict[str, None] = {}

    def start(self, put: Put, target: Callable[..., None], *args: Any) -> None:
        """Run the source's own thread, which hands blocks to `put`; with it the connection ends."""
        self.put = put
        self.spawn(target, *args, ended=lambda: self.set(connected=False))

    def spawn(self, target: Callable[..., None], *args: Any, ended: Callable[[], None] = nothing) -> None:
        """Run `target` in a thread; what it raises becomes the last error."""

        def run() -> None:
            try:
                target(*args)
            except InputError as error:
                self.told(error)
            except Exception as error:  # a fault of fdd; the other sources go on
                self.told(f"internal error: {type(error).__name__}: {error}")
            finally:
                ended()

        threading.Thread(target=run, daemon=True, name=f"fdd-{self.name}").start()

    def take(self, block: Block) -> None:
        """Hand a block on.

        Raises
        ------
        InputError : the service watches as many axes as it can.
        """
        if block.unit is None and self._unit is not None:
            block = replace(block, unit=self._unit)
        self.put(block)
        with self._lock:
            self._counts["received"] += 1
            for name in block.ignored:
                if len(self._ignored) < 8:
                    self._ignored[name[:40]] = None

    def refuse(self, error: InputError) -> None:
        """Count a message that cannot be used."""
        with self._lock:
            self._counts["refused"] += 1
        self.told(error)

    def told(self, error: object) -> None:
        """Keep an error, in one line."""
        self.set(last_error=" ".join(str(error).split())[:500])

    def count(self, name: str) -> None:
        """Count something of the source's own."""
        with self._lock:
            self._counts[name] = self._counts.get(name, 0) + 1

    def set(self, **state: Any) -> None:
        """Note how the source stands."""
        with self._lock:
            self._state.update(state)

    def status(self) -> dict[str, Any]:
        """All of it, as JSON-able values."""
        with self._lock:
            return {"name": self.name, **self._state, **self._counts, "ignored_columns": list(self._ignored)}


class Window:
    """How many blocks may be on their way: a source that can wait does, until the fleet has stored some.

    Examples
    --------
    >>> window, stop = Window(1), threading.Event()
    >>> window.wait(stop), window.waiting
    (True, 1)
    >>> window.accepted(); window.waiting
    0
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._changed = threading.Condition()
        self.waiting = 0

    def wait(self, stop: threading.Event) -> bool:
        """Wait until another block may go; False where `stop` was set."""
        with self._changed:
            while self.waiting >= self._most and not stop.is_set():
                self._changed.wait(0.2)
            if stop.is_set():
                return False
            self.waiting += 1
            return True

    def accepted(self) -> None:
        """A block was stored."""
        with self._changed:
            self.waiting -= 1
            self._changed.notify_all()

    def drained(self, stop: threading.Event) -> None:
        """Wait until all blocks were stored, or `stop` is set."""
        with self._changed:
            while self.waiting and not stop.is_set():
                self._changed.wait(0.2)


def _nowhere(block: Block) -> None:
    raise RuntimeError("the source was not started")
