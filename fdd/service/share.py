"""Which of the axes one of several processes watches."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass


@dataclass(frozen=True)
class Share:
    """Part `number` (from 0) of `of`, by a hash of the axis's name; all axes where nothing is said.

    Examples
    --------
    >>> [sum(Share(k, 2).has(f"A{n}") for n in range(100)) for k in range(2)]
    [51, 49]
    """

    number: int = 0
    of: int = 1

    def has(self, axis: str) -> bool:
        """Whether an axis is in it."""
        digest = hashlib.blake2b(axis.encode(), digest_size=8).digest()
        return int.from_bytes(digest) % self.of == self.number
