"""The rig logs, where they are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of rig logs: FDD_SHARED, or ../shared beside the repository."""
    folder = Path(os.environ.get("FDD_SHARED", ROOT.parent / "shared"))
    if not (folder / "rig_logs").is_dir():
        pytest.skip(f"no rig logs at {folder}; set FDD_SHARED to the folder that holds rig_logs")
    return folder
