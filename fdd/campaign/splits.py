"""Which units a learner sees, tunes by and is judged on: no unit in two."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Literal

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
SHARE = 0.2
"""Of the units, for validation, and again for test."""


def split_of(units: Sequence[str], seed: int = 0) -> dict[str, Split]:
    """Divide units at random, the same way each time.

    Returns
    -------
    Unit to its split: a fifth each for validation and test (at least one of three units or more; of two, one
    is for test), the rest for training.

    Examples
    --------
    >>> from collections import Counter
    >>> sorted(Counter(split_of([f"unit_{k:03d}" for k in range(10)]).values()).items())
    [('test', 2), ('train', 6), ('validation', 2)]
    >>> sorted(split_of(["a", "b"]).values())
    ['test', 'train']
    """
    order = sorted(units, key=lambda unit: hashlib.sha256(f"{seed}/{unit}".encode()).hexdigest())
    held = max(round(SHARE * len(order)), 1)
    tested = held if len(order) > 1 else 0
    tuned = held if len(order) > 2 else 0
    found: dict[str, Split] = {}
    for place, unit in enumerate(order):
        found[unit] = "test" if place < tested else "validation" if place < tested + tuned else "train"
    return {unit: found[unit] for unit in units}
