"""A page as a browser would read it."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any

import numpy as np

Make = Callable[..., Any]
"""The factory of made-up reports, `case`."""
EVIL = """<script>alert('x')</script><img src=x onerror=alert(1)>" onload="y' & </title></style>{{ 7*7 }}"""


class Page(HTMLParser):
    """Tags, attributes, scripts and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag if tag in ("script", "style") else ""
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text += data

    def attributes(self, *names: str) -> list[str]:
        return [v or "" for _, attrs in self.tags for k, v in attrs.items() if k in names]

    @property
    def figures(self) -> dict[str, Any]:
        return {f["id"]: f for f in json.loads(unpacked(self.scripts[0]))}

    def script_policy(self) -> str:
        """The scripts that the page's policy lets run."""
        policy = next(c for c in self.attributes("content") if "default-src" in c)
        assert "default-src 'none'" in policy
        return policy.split("script-src ")[1].split(";")[0]


def unpacked(text: str) -> bytes:
    return gzip.decompress(base64.b64decode(text))


def hash_source(script: bytes) -> str:
    """How a policy names a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode()}'"


def decoded(array: dict[str, str]) -> np.ndarray:
    """The numbers of a trace."""
    values = np.frombuffer(base64.b64decode(array["bdata"]), dtype="<" + array["dtype"]).astype(float)
    return values.reshape([int(n) for n in array["shape"].split(",")]) if "shape" in array else values
