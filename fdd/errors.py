"""The one kind of error that a user's input can cause, and how its line is worded."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

LONGEST_WORD, LONGEST_TEXT = 300, 2000
"""Characters: what a damaged file says in place of a name is not repeated in full."""
MAX_LISTED = 40


class InputError(ValueError):
    """Unusable input: one line that names the problem, the file or channel (and place) `where` it is, and
    what the user can do to `mend` it.

    The commands print it on standard error and exit with status 2; callers catch it as a ``ValueError``.
    """

    def __init__(self, problem: str, *, where: str | Path | None = None, mend: str | None = None) -> None:
        self.problem = _shortened(problem)
        self.where = None if where is None else str(where)
        self.mend = None if mend is None else _shortened(mend)
        text = self.problem if self.where is None else f"{self.where}: {self.problem}"
        super().__init__(" ".join((text if mend is None else f"{text}; {self.mend}").split()))

    def at(self, where: str | Path) -> InputError:
        """The same error, told with the file that it came from."""
        inner = self.problem if self.where is None else f"{self.where}: {self.problem}"
        return InputError(inner, where=where, mend=self.mend)


def _shortened(text: str) -> str:
    words = (w if len(w) <= LONGEST_WORD else f"{w[:LONGEST_WORD]}…" for w in text.split())
    joined = " ".join(words)
    return joined if len(joined) <= LONGEST_TEXT else f"{joined[:LONGEST_TEXT]}…"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``" (did you mean 'x'?)"``, or nothing where no known name is near."""
    names = list(known)
    by_folded = {n.casefold(): n for n in names}
    near = difflib.get_close_matches(name.casefold(), by_folded, n=1, cutoff=0.6)
    return f" (did you mean {by_folded[near[0]]!r}?)" if near else ""


def listed(names: Iterable[str]) -> str:
    """The names with commas, cut after `MAX_LISTED`."""
    every = list(names)
    more = f" and {len(every) - MAX_LISTED} more" if len(every) > MAX_LISTED else ""
    return ", ".join(every[:MAX_LISTED]) + more


def input_error(error: ValidationError, where: str | Path, mend: str | None) -> InputError:
    """The first thing that pydantic finds wrong; an unknown key goes before the one that is missing for it.
    `where` is the file, `mend` what helps, where the error itself does not say."""
    found = error.errors(include_url=False)
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    place, cause = [str(part) for part in first["loc"]], first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        place, problem, mend = [*place, cause.where or ""], cause.problem, cause.mend or mend
    elif first["type"] == "extra_forbidden":
        absent = [str(e["loc"][-1]) for e in found if e["type"] == "missing"]
        problem = f"unknown key{did_you_mean(place[-1], absent)}"
    else:
        problem = str(first["msg"]).removeprefix("Value error, ")
    told = ".".join(filter(None, place))
    return InputError(f"{told}: {problem}" if told else problem, where=where, mend=mend)
