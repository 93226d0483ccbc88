"""Which unit an axis is: by the configuration, by what its blocks say, or by its name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fdd.bounds import MOST_AXES
from fdd.errors import InputError
from fdd.unit import Unit, shipped_units


class Profiles:
    """Profiles of a folder, or of a mapping from axes.

    A name that a block brings is looked up among the folder's files and the shipped profiles: it is never a
    path.

    Parameters
    ----------
    units : folder, or axis to profile (a file or a shipped one). fallback : profile of axes that have none.

    Raises
    ------
    InputError : a profile that is named here cannot be used.
    """

    def __init__(self, units: Path | dict[str, str] | None = None, fallback: str | None = None) -> None:
        self._units, self._fallback = units, fallback
        named = set(units.values()) if isinstance(units, dict) else set()
        for name in named | ({fallback} if fallback is not None else set()):
            _load(name)  # a misspelt one is told at the start, not by each axis that comes

    def find(self, axis: str, said: str | None) -> Unit:
        """The profile of an axis.

        Parameters
        ----------
        said : name that its blocks bring.

        Raises
        ------
        InputError : there is none.
        """
        if isinstance(self._units, dict):
            if axis in self._units:
                return _load(self._units[axis])
        elif self._units is not None:
            files = {p.stem: p for p in sorted(self._units.glob("*.yaml"))[:MOST_AXES]}
            for name in (said, axis, axis.replace("/", "_")):
                if name in files:
                    return _load(str(files[name]))
        if said is not None and said in shipped_units():
            return _load(said)
        if self._fallback is not None:
            return _load(self._fallback)
        raise InputError(
            f"axis {axis}: no profile{f' {said!r}' if said else ''}",
            mend="put one named like the axis into the units folder, or name a fallback",
        )


@cache
def _load(source: str) -> Unit:
    """A profile, read once for all its axes, which share it."""
    return Unit.load(source)
