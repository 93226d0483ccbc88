"""Fields of messages by path, and what a reader of an encoding does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from fdd.logs.wire.chunks import Batch
from fdd.samples import Column

Path = tuple[str | int, ...]
"""Keys and indices from the message down to a number."""


@dataclass(frozen=True)
class Field:
    """A number in a message, and the unit that its schema gives."""

    path: Path
    unit: str | None = None


class Decoder(Protocol):
    """Reads the messages of one channel."""

    def fields(self, first: Batch) -> list[Field]:
        """The numbers in the messages, by the schema and the first of them."""

    def columns(self, batch: Batch, paths: Sequence[Path]) -> list[Column]:
        """(n,) numbers of each path, NaN where a message lacks it.

        Raises
        ------
        ValueError : a message is damaged, or holds something else than numbers there.
        """


def written(path: Path) -> str:
    """A path as a channel map writes it.

    Examples
    --------
    >>> written(("joint", "position", 2)), written((0, "x"))
    ('joint.position[2]', '[0].x')
    """
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text
