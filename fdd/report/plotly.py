"""plotly.js, as it is shipped beside this module: what draws the figures of a page.

The bundle is the package plotly.js-cartesian-dist-min as it was published, gzipped. The basic one, smaller
by a fifth, would draw all figures, too.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
from functools import lru_cache
from importlib import resources
from pathlib import Path

from fdd.files import whole_file

VERSION = "4.1.1"
FILE = "plotly.min.js"
"""What pages look for beside them that do not hold it."""


def packed(data: bytes) -> str:
    """Base64 of gzip, which the page's script unpacks."""
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii")


@lru_cache(maxsize=1)
def bundle() -> tuple[str, str]:
    """The bundle for a page that stands alone: base64 of gzip, and what a policy calls its script."""
    zipped = (resources.files("fdd.report") / f"{FILE}.gz").read_bytes()
    return base64.b64encode(zipped).decode("ascii"), source_hash(gzip.decompress(zipped))


def write_bundle(folder: Path) -> None:
    """Put the bundle into a folder of pages that share it; an InputError where it cannot be written."""
    with whole_file(folder / FILE) as temporary:
        temporary.write_bytes(gzip.decompress(base64.b64decode(bundle()[0])))


def source_hash(script: bytes) -> str:
    """A script as a Content-Security-Policy names it.

    Examples
    --------
    >>> source_hash(b"")
    "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='"
    """
    return f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode('ascii')}'"
