"""The plant's compiler: what it keeps on disk is made anew when any of the plant's sources changes."""

from __future__ import annotations

from pathlib import Path

from estimators.compiled import compiler

njit = compiler(Path(__file__).parent)
