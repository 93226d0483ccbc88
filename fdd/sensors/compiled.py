"""The compiler of the sensors' judgement: what it keeps is made anew when a source beside it changes."""

from __future__ import annotations

from pathlib import Path

from estimators.compiled import compiler

njit = compiler(Path(__file__).parent)
