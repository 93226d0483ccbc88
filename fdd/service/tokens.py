"""Who is calling and what they may do: tokens and roles."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from fdd.bounds import MAX_TOKENS_BYTES
from fdd.errors import InputError

Role = Literal["view", "acknowledge", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)
"""Each may what those before it may."""
_NAME = re.compile(r"[A-Za-z0-9_.@-]{1,64}")
_SHA256 = re.compile(r"[0-9a-fA-F]{64}")


@dataclass(frozen=True)
class Caller:
    """A person or program with a role."""

    name: str
    role: Role

    def may(self, role: Role) -> bool:
        """Whether the caller's role includes `role`."""
        return ROLES.index(self.role) >= ROLES.index(role)


LOCAL = Caller("local", "admin")
"""Whoever sits at the machine, where no tokens are set."""


def new_token(name: str, role: str) -> tuple[str, str]:
    """A token, to be told to its owner once, and its line for the file of tokens."""
    token = secrets.token_urlsafe(32)
    return token, f"{name} {role} {hashlib.sha256(token.encode()).hexdigest()}"


class Tokens:
    """The known tokens, of which only hashes are kept."""

    def __init__(self, known: Sequence[tuple[bytes, Caller]]) -> None:
        self._known = known

    @classmethod
    def load(cls, path: Path) -> Tokens:
        """Read a file of ``name role sha256(token)`` lines; ``#`` begins a comment.

        Raises InputError: it cannot be read, or a line is not of that form.
        """
        try:
            if path.stat().st_size > MAX_TOKENS_BYTES:
                raise InputError(f"larger than {MAX_TOKENS_BYTES} bytes", where=path)
            return cls.parse(path.read_text("utf-8", "replace"), str(path))
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", where=path) from None

    @classmethod
    def parse(cls, text: str, where: str = "tokens") -> Tokens:
        """The same from text. Raises InputError: a line is not of that form, or there is none."""
        known = []
        for number, line in enumerate(text.splitlines(), 1):
            parts = line.split("#", 1)[0].split()
            if not parts:
                continue
            if len(parts) != 3 or not _NAME.fullmatch(parts[0]) or not _SHA256.fullmatch(parts[2]):
                # The line itself is not repeated: it may hold a token that was pasted by mistake.
                raise InputError("not: name role sha256", where=f"{where}:{number}", mend="one token a line")
            role = next((r for r in ROLES if r == parts[1]), None)
            if role is None:
                raise InputError("unknown role", where=f"{where}:{number}", mend=f"one of {', '.join(ROLES)}")
            known.append((bytes.fromhex(parts[2]), Caller(parts[0], role)))
        if not known:
            raise InputError("no token in it", where=where, mend="one line a token: name role sha256")
        return cls(known)

    def caller(self, token: str) -> Caller | None:
        """Whose token it is; every known hash is compared, whichever fits, in constant time each."""
        digest = hashlib.sha256(token.encode("utf-8", "replace")).digest()
        found = [caller for known, caller in self._known if hmac.compare_digest(digest, known)]
        return found[-1] if found else None
