"""A page as a browser would read it."""

from __future__ import annotations

import base64
import gzip
import json
from html.parser import HTMLParser
from typing import Any

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


def unpacked(text: str) -> bytes:
    return gzip.decompress(base64.b64decode(text))
