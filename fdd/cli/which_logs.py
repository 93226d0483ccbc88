"""Which logs are meant: files, folders, patterns and lists."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, count
from pathlib import Path

from fdd.errors import InputError
from fdd.logs.formats import suffixes


def find_logs(given: Sequence[Path], leave_out: Path | None = None) -> list[Path]:
    """The logs that a command line means, each once.

    Parameters
    ----------
    given : files; folders, for all logs below them in order of their names, hidden ones left out; patterns
        such as ``runs/*.csv`` or ``runs/**/*.mcap``; and ``@list.txt``, a text file with one of these a line
        (blank lines and those that begin with # are skipped). A file is taken whether it is there or not.
    leave_out : a folder to skip in folders: that of the answers.
    """
    found: dict[str, Path] = {}
    for argument in given:
        for path in _listed(argument) if str(argument).startswith("@") else [argument]:
            for log in _logs_of(path, leave_out):
                found.setdefault(os.path.realpath(log), log)
    return list(found.values())


def names_of(logs: Sequence[Path]) -> list[str]:
    """What each log is called: its file name; with folders where two would have the same."""
    times = Counter(log.name for log in logs)
    twins = [log.absolute().parent for log in logs if times[log.name] > 1]
    common = os.path.commonpath(twins) if twins else ""
    return [
        Path(os.path.relpath(log, common)).as_posix() if times[log.name] > 1 else log.name for log in logs
    ]


def file_names(names: Sequence[str]) -> list[str]:
    """A name for a file of each log, without folders, no two alike (nor on systems that ignore case)."""
    taken: set[str] = set()
    out = []
    for name in names:
        base = re.sub(r'[/\\:*?"<>|\x00-\x1f]', "-", name)
        tries = chain([base], (f"{base}-{number}" for number in count(2)))
        out.append(next(plain for plain in tries if plain.lower() not in taken))
        taken.add(out[-1].lower())
    return out


def _listed(argument: Path) -> Iterator[Path]:
    path = Path(str(argument)[1:])
    try:
        text = path.read_text(encoding="utf-8-sig", errors="surrogateescape")
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(problem, where=path, mend="give a text file, one log a line") from None
    lines = [line.strip() for line in text.splitlines()]
    wanted = [Path(line) for line in lines if line and not line.startswith("#")]
    if not wanted:
        raise InputError("names no log", where=path, mend="write one log a line")
    yield from wanted


def _logs_of(path: Path, leave_out: Path | None) -> list[Path]:
    if path.is_dir():
        if logs := _below(path, leave_out):
            return logs
        mend = f"logs are taken by their suffix: {' '.join(suffixes())}"
        raise InputError("no log below this folder", where=path, mend=mend)
    if path.exists() or not glob.has_magic(str(path)):
        return [path]
    matching = [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]  # noqa: PTH207
    if not matching:
        raise InputError("no file has such a name", where=path, mend="correct the pattern, or name a folder")
    return [log for match in matching for log in (_below(match, leave_out) if match.is_dir() else [match])]


def _below(folder: Path, leave_out: Path | None) -> list[Path]:
    skipped = None if leave_out is None else os.path.realpath(leave_out)
    found = []
    for here, folders, files in os.walk(folder):
        folders[:] = sorted(
            f for f in folders if not f.startswith(".") and os.path.realpath(Path(here, f)) != skipped
        )
        found += [Path(here, f) for f in files if not f.startswith(".") and f.lower().endswith(suffixes())]
    return sorted(found, key=lambda path: path.parts)
