"""What the outputs need of the store, the bus and the fleet, and nothing more of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

from fdd.errors import InputError

Kind = Literal["finding", "alarm", "status", "quality", "axis"]
MOST_SECRET_BYTES = 4096


class Event(Protocol):
    """Of the bus; data are JSON-able, of an ``alarm`` as in the outbox, of a ``status`` an `AxisStatus`."""

    @property
    def kind(self) -> str:
        """Which sort."""

    @property
    def axis(self) -> str:
        """Name of the axis."""

    @property
    def time(self) -> float:
        """s of the stream's clock."""

    @property
    def data(self) -> Mapping[str, Any]:
        """What happened."""


class Subscription(Protocol):
    """A bounded queue of events; a slow reader loses the oldest, counted in `lost`."""

    @property
    def lost(self) -> int:
        """Events lost so far."""

    def get(self, timeout: float) -> Event | None:
        """The next event, or None after `timeout` s."""

    def close(self) -> None:
        """No more events."""


class Bus(Protocol):
    """Where live events come from."""

    def subscribe(self, kinds: Collection[Kind]) -> Subscription:
        """Events of these kinds from now on."""


class Parcel(Protocol):
    """A row of the outbox: what must arrive at a target.

    Of kind ``alarm`` the body is a transition as a dict: ``action``, ``alarm`` (a dict with ``id``, ``axis``,
    ``state`` and, as ``body``, the finding), ``wall`` and the like. Of kind ``finding`` it is the finding,
    with ``axis``.
    """

    @property
    def id(self) -> int:
        """Grows from row to row."""

    @property
    def kind(self) -> str:
        """``alarm`` or ``finding``."""

    @property
    def body(self) -> Mapping[str, Any]:
        """JSON-able."""

    @property
    def attempts(self) -> int:
        """That failed so far."""

    @property
    def next_wall(self) -> float:
        """Unix seconds, before which it is not tried again."""


class Store(Protocol):
    """The outbox and the alarms that stand."""

    def outbox(self, limit: int, target: str) -> Sequence[Parcel]:
        """The oldest rows of a target that are not done, in the order of id, due or not."""

    def delivered(self, id: int) -> None:
        """Mark a row as done."""

    def put_off(self, id: int, next_wall: float) -> None:
        """Count an attempt and set when the next one is due."""

    def give_up(self, id: int, note: str) -> None:
        """Mark a row as done and audit why it never arrived, in one transaction."""

    def alarms(self, states: Collection[str]) -> Sequence[Mapping[str, Any]]:
        """Alarms in these states."""


def read_secret(path: Path) -> str:
    """A password or key: the file's first line, without the blanks around it.

    Raises
    ------
    InputError : missing, empty, no text, or longer than 4096 bytes.

    Examples
    --------
    >>> read_secret(Path("mqtt.password"))  # doctest: +SKIP
    'open sesame'
    """
    try:
        with path.open(encoding="utf-8") as file:
            text = file.readline(MOST_SECRET_BYTES + 1).strip()
    except (OSError, UnicodeDecodeError) as error:
        told = getattr(error, "strerror", None) or "not text"
        raise InputError(f"cannot be read ({told})", where=path, mend="write the secret into it") from None
    if not text or len(text) > MOST_SECRET_BYTES:
        raise InputError(
            "empty, or longer than 4096 bytes", where=path, mend="write one line with the secret into it"
        )
    return text
