"""What installed packages add to fdd, by entry points (docs/extending.md).

What cannot be used is told in one line that names the package, and fdd goes on without it: a package that
somebody installed for one rig must not keep all others from being diagnosed.
"""

from __future__ import annotations

import multiprocessing
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from fdd.errors import InputError

FAULTS, LOG_FORMATS, TRACKERS = "fdd.faults", "fdd.log_formats", "fdd.trackers"
CLASSIFIERS = "fdd.classifiers"
"""Has fdd's own among them."""


@dataclass(frozen=True)
class Addition:
    """One entry point; `package` is the name and version of its package, as people read it."""

    name: str
    package: str
    point: EntryPoint

    def load(self) -> Any:
        """What the entry point names; an InputError where it cannot be imported, whatever the reason."""
        try:
            return self.point.load()
        except Exception as error:  # a package may do anything while it is imported
            brief = f"{type(error).__name__}: {error}"[:200]
            raise self.wrong(f"{self.point.value} cannot be loaded ({brief})") from None

    def wrong(self, problem: str) -> InputError:
        """That it cannot be used, and why."""
        told = f"{self.point.group} {self.name!r}: {problem}"
        return InputError(told, where=f"package {self.package}", mend="mend the package, or uninstall it")


def additions(group: str) -> list[Addition]:
    """What the installed packages add to a group, by name; the packages' code is not yet loaded."""
    return list(_added().get(group, ()))


@cache
def _added() -> dict[str, list[Addition]]:
    """All entry points of ours: reading the files of every package takes milliseconds, so once."""
    found = entry_points()
    return {
        group: [
            Addition(p.name, f"{p.dist.name} {p.dist.version}" if p.dist else "without a name", p)
            for p in sorted(found.select(group=group), key=str)
        ]
        for group in (FAULTS, LOG_FORMATS, TRACKERS, CLASSIFIERS)
    }


def left_out(error: InputError) -> None:
    """Tell on standard error, once for all processes of a command, what fdd goes on without."""
    if multiprocessing.parent_process() is None:
        print(f"fdd: warning: {error}; fdd goes on without it", file=sys.stderr)
