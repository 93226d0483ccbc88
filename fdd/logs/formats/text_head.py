"""The beginning of a text file: unpacked, and in the encoding that it is in."""

from __future__ import annotations

from pathlib import Path

from fdd.bounds import SNIFFED_BYTES
from fdd.errors import InputError
from fdd.logs.formats.signals import damaged


def head_of(path: Path) -> tuple[bytes, bool, bool]:
    """The first bytes, unpacked; whether the file is packed; whether these are all."""
    import gzip
    import zlib

    with path.open("rb") as source:
        head = source.read(SNIFFED_BYTES + 1)
    if not head.startswith(b"\x1f\x8b"):
        return head[:SNIFFED_BYTES], False, len(head) <= SNIFFED_BYTES
    try:
        with gzip.open(path, "rb") as packed:
            head = packed.read(SNIFFED_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise damaged("damaged gzip file", path, error) from None
    return head[:SNIFFED_BYTES], True, len(head) <= SNIFFED_BYTES


def decoded(head: bytes, where: Path, whole: bool) -> tuple[str, str]:
    """The text and its encoding: UTF-16 by its mark, UTF-8 where it is that, else Windows-1252.

    Raises
    ------
    InputError : no text.
    """
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return head.decode("utf-16", errors="replace").lstrip("\ufeff"), "utf-16"
    if b"\0" in head:
        raise InputError(
            "of no known format, and no text",
            where=where,
            mend="give a log of a format that the README lists",
        )
    try:
        return (head.decode("utf-8-sig") if whole else _utf8(head)), "utf-8"
    except UnicodeDecodeError:
        pass
    try:
        return head.decode("cp1252"), "cp1252"
    except UnicodeDecodeError:
        return head.decode("latin-1"), "latin-1"


def _utf8(head: bytes) -> str:
    """Text whose last character may be cut."""
    for cut in range(4):
        try:
            return head[: len(head) - cut].decode("utf-8-sig")
        except UnicodeDecodeError:
            if cut == 3:
                raise
    return ""
