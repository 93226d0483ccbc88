"""What the HTTP service needs of the others: the fleet, the store and the bus, as small protocols."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from fdd.service.alarms import Action


class Fleet(Protocol):
    """The running axes. What it gives is read by attribute or key, see `fdd.service.http.answers`."""

    def axes(self) -> Sequence[Any]:
        """Every axis's `AxisStatus`."""
        ...

    def axis(self, name: str) -> Any:
        """One axis's `AxisDetail`.

        Raises
        ------
        KeyError : no such axis.
        """
        ...

    def act(self, action: Action) -> Any:
        """Do it; returns once it is stored.

        Raises
        ------
        InputError : the alarm's state does not allow it, or nobody could store it (the `trouble` of `web`).
        """
        ...


class Store(Protocol):
    """What is kept, read only. Rows come as mappings or objects."""

    def alarms(self, states: Sequence[str] | None = None, limit: int = 1000) -> Sequence[Any]:
        """Alarms, the newest first."""
        ...

    def alarm(self, id: int) -> Any:
        """One alarm, or None."""
        ...

    def axes(self) -> Sequence[Any]:
        """All axes, by name."""
        ...

    def meta(self, key: str) -> str | None:
        """A word about the store itself."""
        ...

    def rollups(self, axis: str, quantity: str, level: str, since: float) -> Sequence[Any]:
        """A quantity over minutes, hours or days, from a Unix time on."""
        ...

    def audit(self, alarm_id: int | None = None, *, limit: int = 1000) -> Sequence[Any]:
        """What was done, the newest first."""
        ...


class Subscription(Protocol):
    """One listener's queue."""

    def get(self, timeout: float) -> Any:
        """The next event (`kind`, `axis`, `time`, `data`), or None when the time is up."""
        ...

    def close(self) -> None:
        """Hear no more."""
        ...


class Bus(Protocol):
    """Publish and subscribe within the process."""

    def subscribe(self) -> Subscription:
        """A queue of what is published from now on."""
        ...
