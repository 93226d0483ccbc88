"""Files that a command writes: refused before the work, written whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fdd.errors import InputError


def require_writable(path: Path, *, folder: bool = False) -> None:
    """Refuse an output before minutes are spent on it.

    Parameters
    ----------
    path : the file (or folder) to be made.
    folder : whether it is a folder; one that is there already is fine.

    Raises
    ------
    InputError : names what is in the way.

    Examples
    --------
    >>> require_writable(Path("run.mcap"))
    """
    if folder and path.exists() and not path.is_dir():
        raise InputError("is a file, a folder is wanted", where=path, mend="name another one")
    if not folder and path.is_dir():
        raise InputError("is a folder, a file is wanted", where=path, mend="name a file in it")
    parent = path if folder and path.is_dir() else path.absolute().parent
    if folder:
        while not parent.exists() and parent != parent.parent:
            parent = parent.parent
    if not parent.is_dir():
        raise InputError("cannot be written, no such folder", where=path, mend=f"make {parent} first")
    if not os.access(parent, os.W_OK):
        raise InputError("cannot be written, permission denied", where=path, mend="name another folder")


@contextmanager
def written(path: Path) -> Iterator[None]:
    """Tell what the system has against writing `path` in one line.

    Raises
    ------
    InputError : the disk is full, the folder went away, and the like.
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror or error})",
            where=path,
            mend="free space or name another file",
        ) from None


def write_text(path: Path, text: str) -> None:
    """Write a text file under a temporary name, then rename it.

    Raises
    ------
    InputError : it cannot be written.
    """
    require_writable(path)
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.part")
    with written(path):
        try:
            with temporary.open("x", encoding="utf-8") as out:
                out.write(text)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
