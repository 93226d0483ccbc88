"""How long work tells a caller how far it is; the command line shows it, a library call is silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

Advance = Callable[[float], None]
"""Told how much is done in all."""


Progress = Callable[..., AbstractContextManager[Advance]]
"""Opens a stage of the work: its title, and the total that `Advance` counts to where there is one."""


@contextmanager
def unseen(title: str, total: float | None = None) -> Iterator[Advance]:
    """Progress that nobody watches."""
    yield lambda done: None
