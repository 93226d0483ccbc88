"""The one kind of error that a user's input can cause."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Unusable input: one line that names the place, the problem and the mend.

    The commands print it on standard error and exit with status 2; a library
    caller catches it as a ``ValueError``.

    Parameters
    ----------
    problem : what is wrong, with figures.
    where : the file (and the place in it) or the channel that it is wrong in.
    mend : what the user can do about it.

    Examples
    --------
    >>> str(InputError("no message on topic /daq", where="a.mcap", mend="give --map"))
    'a.mcap: no message on topic /daq; give --map'
    """

    def __init__(self, problem: str, *, where: str | Path | None = None, mend: str | None = None) -> None:
        self.problem = problem
        self.where = None if where is None else str(where)
        self.mend = mend
        text = problem if self.where is None else f"{self.where}: {problem}"
        super().__init__(" ".join((text if mend is None else f"{text}; {mend}").split()))

    def at(self, where: str | Path) -> InputError:
        """The same error, told with the file that it came from."""
        inner = self.problem if self.where is None else f"{self.where}: {self.problem}"
        return InputError(inner, where=where, mend=self.mend)
