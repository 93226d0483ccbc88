"""The docstrings' sections as mkdocstrings expects them.

They say ``name : what it is``, for types stand in the signature; numpydoc has the type in that place.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

SECTIONS = re.compile(r"^(Attributes|Parameters|Raises)\n-+\n((?:.*\S.*\n?)+)", flags=re.M)
ENTRY = re.compile(r"^(\S[^:\n]*?) : ", flags=re.M)


class NamesAndWords(griffe.Extension):
    """Puts what an entry says on the line below its name."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Change an object's docstring when it has been read."""
        if obj.docstring is not None:
            obj.docstring.value = SECTIONS.sub(_with_words_below, obj.docstring.value)


def _with_words_below(match: re.Match[str]) -> str:
    title, body = match.groups()
    return f"{title}\n{'-' * len(title)}\n" + ENTRY.sub(r"\1\n    ", body)
