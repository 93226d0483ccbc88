"""An axis's whole state, from which it goes on after a restart."""

from __future__ import annotations

import hashlib
import zlib
from dataclasses import dataclass

from fdd.errors import InputError

_LEVEL = 1
"""Of zlib: states halve, further levels gain a hundredth for twice the time."""


@dataclass(frozen=True)
class Checkpoint:
    """The state of an axis.

    Attributes
    ----------
    time : s of the stream's clock. wall : Unix seconds.
    sequence : id of the last journal row whose block is in the state.
    version : of the state's form. body : the state, packed by whom it belongs to.
    """

    axis: str
    time: float
    wall: float
    sequence: int
    profile_sha256: str
    model_sha256: str
    version: str
    body: bytes


def packed(body: bytes) -> tuple[bytes, str]:
    """What is stored of a state, and its SHA-256.

    Examples
    --------
    >>> unpacked(*packed(b"state"), where="fdd.db")
    b'state'
    """
    small = zlib.compress(body, _LEVEL)
    return small, hashlib.sha256(small).hexdigest()


def unpacked(small: bytes, sha256: str, where: str) -> bytes:
    """The state of what `packed` gave.

    Raises
    ------
    InputError : it is not what was stored.
    """
    if hashlib.sha256(small).hexdigest() != sha256:
        raise InputError("a checkpoint is damaged", where=where, mend="the axis must start anew")
    return zlib.decompress(small)
