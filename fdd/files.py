"""Files that are written: refused before the work, and whole or not at all. Their hashes."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fdd.errors import InputError

_NAME_KEPT = 50
"""Characters of the target's name in the temporary one: at most 200 of the 255 bytes that a name may have."""


def require_writable(path: Path, *, folder: bool = False) -> None:
    """Refuse an output before minutes are spent on it: a file, or a folder, which may be there already.
    The InputError names what is in the way."""
    with written(path):
        if folder and path.exists() and not path.is_dir():
            raise InputError("is a file, a folder is wanted", where=path, mend="name another one")
        if not folder and path.is_dir():
            raise InputError("is a folder, a file is wanted", where=path, mend="name a file in it")
        if not folder and path.exists() and not path.is_file():
            # Renaming onto a device would take its place in the system.
            raise InputError("is a device or pipe, a file is wanted", where=path, mend="name a file")
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
    """Tell what the system has against writing `path` (a full disk, and the like) as an InputError."""
    try:
        yield
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
        raise InputError(problem, where=path, mend="free space or name another file") from None


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """An empty file beside `path` that takes its name once it is whole.

    When the block ends, the file is on the disk and renamed; when it fails, the file is removed and `path` is
    as it was before. Each call has a file of its own, so that of writers at the same time the last one wins.
    An InputError where the folder is missing or not writable, the disk is full, or `path` is no file.
    """
    path = Path(path)
    require_writable(path)
    temporary = path.with_name(f".{path.name[:_NAME_KEPT]}-{secrets.token_hex(6)}.part")
    with written(path):
        # Not mkstemp, whose file only its owner may read whatever the umask.
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            yield temporary
            with temporary.open("rb+") as whole:
                os.fsync(whole.fileno())
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal; an InputError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise InputError("no such file", where=path, mend="check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file, see `whole_file`."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
