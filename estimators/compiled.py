"""Numba's ``njit``, whose compiled code is kept on disk until any source that may be part of it changes; and
records of named numbers, as such code reads and writes them.

Numba dates what it keeps by the function's own file, and goes on with old copies of the functions and
constants that it imports when their files change. Here a hash of all its package's sources dates each result.
Where it is kept is left to Numba: beside the sources; where they cannot be written, below the user's cache
folder; or in ``NUMBA_CACHE_DIR``. A new result replaces the old one, so edits do not fill the folder.
"""

from __future__ import annotations

import hashlib
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import numba
import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime.nrt import rtsys
from numpy.typing import NDArray

Two = Annotated[NDArray[np.float64], 2]


def sources_key(*folders: Path) -> str | None:
    """Hash of all Python sources below some packages' folders, named relative to these, and of what compiles
    them; None where there are no sources to be read (a zipped or frozen program)."""
    found = [(path, path.relative_to(folder)) for folder in folders for path in sorted(folder.rglob("*.py"))]
    total = hashlib.sha256(f"{sys.version} {numba.__version__} {np.__version__}".encode())
    for path, name in found:
        total.update(f"{name.as_posix()} ".encode())
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest() if found else None


def compiler(*folders: Path) -> Callable[..., Any]:
    """A decorator like ``numba.njit(cache=True)``, which takes the other options of ``numba.njit``.

    `folders` of the packages whose functions and constants end up in the compiled code, with what is below.
    """
    key = sources_key(*folders)

    def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
        """``numba.njit`` with these options, kept on disk."""

        def decorated(function: Callable[..., Any]) -> Any:
            compiled = numba.njit(**options)(function)
            if key is not None and not numba.config.DISABLE_JIT:
                try:
                    compiled._cache = _Kept(function, key)
                except RuntimeError:  # Numba's, where it finds no folder that can be written.
                    warnings.warn(
                        "compiled code cannot be kept and each start compiles anew: "
                        "set NUMBA_CACHE_DIR to a folder that can be written",
                        stacklevel=1,
                    )
            return compiled

        return decorated

    return njit


class _Kept(FunctionCache):
    """Numba's cache of one function, dated by a hash of all sources instead of its own file's time."""

    def __init__(self, function: Callable[..., Any], key: str) -> None:
        super().__init__(function)
        name = self._impl.filename_base
        if "<" not in function.__qualname__:  # Local functions may share a name, those of a module do not.
            # Numba's name has the function's line, which would leave a file behind whenever lines shift.
            name = re.sub(r"-\d+(?=\.py\d+)", "", name)
        self._cache_file = IndexDataCacheFile(self._cache_path, name, key)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The code kept for a signature, or None.

        Numba would first import all that compiling needs, scipy.linalg included, which takes longer than to
        load all the code of a diagnosis. Kept code needs the runtime alone; compiling looks after itself.
        """
        rtsys.initialize(target_context)
        result = None
        try:
            with self._guard_against_spurious_io_errors():
                result = self._load_overload(signature, target_context)
        except (AttributeError, ImportError):  # the list of what is kept names a type that is gone
            self.flush()
        # Two processes that first keep different signatures at once may take the same file for them.
        return result if result is not None and result.signature.args == signature else None


njit = compiler(Path(__file__).parent)
"""For the functions of this package, which need nothing from others."""


def record_of(described: type) -> np.dtype[np.void]:
    """The NumPy record type with a class's annotated fields, each a float64 or, where `Annotated`, so many.

    A field is an attribute both in Python and in compiled code, and a record is passed on by reference.

    Examples
    --------
    >>> class Chamber:
    ...     area: float
    ...     pressures: Two
    >>> chamber = np.zeros(1, record_of(Chamber))[0]
    >>> chamber.pressures[1] = 3.0
    >>> chamber.area, chamber.pressures
    (np.float64(0.0), array([0., 3.]))
    """
    hints = get_type_hints(described, include_extras=True)
    fields = [(name, "f8", get_args(hint)[1:]) for name, hint in hints.items()]
    return np.dtype((np.record, fields))
