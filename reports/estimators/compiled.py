"""The benchmark's compiler: its functions hold the estimators' model and kernels too."""

from __future__ import annotations

from pathlib import Path

import estimators
from estimators.compiled import compiler

njit = compiler(Path(__file__).parent, Path(estimators.__file__).parent)
