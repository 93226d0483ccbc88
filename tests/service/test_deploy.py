"""The service's unit and its container file ask for as little of the machine as they say."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_the_unit_is_hardened() -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine")
    unit = ROOT / "deploy" / "fdd.service"
    asked = ["systemd-analyze", "security", "--offline=true"]
    if subprocess.run([*asked, "--help"], capture_output=True).returncode:
        pytest.skip("this systemd-analyze judges running services alone")
    # Ten times the exposure, from 0 (safe) to 100; a service of no settings has 96.
    judged = subprocess.run([*asked, "--threshold=15", unit], capture_output=True, text=True)
    assert judged.returncode == 0, judged.stdout[-300:] + judged.stderr


def test_the_container_takes_files_that_there_are_and_runs_without_root() -> None:
    text = (ROOT / "deploy" / "Containerfile").read_text()
    for names in re.findall(r"^COPY (?!--from)(.+) \S+$", text, re.M):
        assert all((ROOT / name).exists() for name in names.split())
    users = re.findall(r"^USER (\d+)", text, re.M)
    assert users and int(users[-1]) >= 1000
    assert text.index("\nUSER ") < text.index("\nENTRYPOINT ")
