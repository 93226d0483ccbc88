"""The one kind of error that a user's input can cause."""

from __future__ import annotations

from pathlib import Path

LONGEST_WORD, LONGEST_TEXT = 300, 2000
"""Characters: what a damaged file says in place of a name is not repeated in full."""


class InputError(ValueError):
    """Unusable input: one line that names the problem, the file or channel (and place) `where` it is, and
    what the user can do to `mend` it.

    The commands print it on standard error and exit with status 2; a library
    caller catches it as a ``ValueError``.

    Examples
    --------
    >>> str(InputError("no message on topic /daq", where="a.mcap", mend="give --map"))
    'a.mcap: no message on topic /daq; give --map'
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
