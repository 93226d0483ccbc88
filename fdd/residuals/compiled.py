"""The compiler of the balances: what it keeps on disk is made anew when a source beside it changes."""

from __future__ import annotations

from pathlib import Path

import estimators
from estimators.compiled import compiler

njit = compiler(Path(__file__).parent, Path(estimators.__file__).parent)
"""For the functions of this package, which call the estimators' small-matrix algebra."""
