"""Hints for names that are not there: the nearest one, and what there is."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_LISTED = 40


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``" (did you mean 'x'?)"``, or nothing where no known name is near.

    Examples
    --------
    >>> did_you_mean("positon", ["position", "time"])
    " (did you mean 'position'?)"
    """
    names = list(known)
    by_folded = {n.casefold(): n for n in names}
    near = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return f" (did you mean {by_folded[near[0]]!r}?)" if near else ""


def listed(names: Iterable[str]) -> str:
    """The names with commas, cut after `MAX_LISTED`."""
    every = list(names)
    more = f" and {len(every) - MAX_LISTED} more" if len(every) > MAX_LISTED else ""
    return ", ".join(every[:MAX_LISTED]) + more
