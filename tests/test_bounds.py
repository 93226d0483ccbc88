"""The page of bounds has the numbers of the module; and what a user raises is raised."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd import bounds
from fdd.errors import InputError
from fdd.logs.formats import open_log

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "bounds.md"


BOUNDS = {name: value for name, value in vars(bounds).items() if name.isupper() and name != "RAISABLE"}


def test_the_page_says_what_the_module_says() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([\d,]+) \|", PAGE.read_text(encoding="utf-8"), flags=re.M)
    assert {name: int(value.replace(",", "")) for name, value in rows} == bounds.RAISABLE | BOUNDS


def test_every_bound_is_used() -> None:
    sources = [p.read_text(encoding="utf-8") for p in (ROOT / "fdd").rglob("*.py") if p.name != "bounds.py"]
    used = set(re.findall(r"[A-Z0-9_]+", "\n".join(sources)))
    assert {*bounds.RAISABLE, *BOUNDS} <= used


def log_of(path: Path, rows: int) -> Path:
    pd.DataFrame({"time": np.arange(rows) * 1e-3, "position": 0.1}).to_parquet(path)
    return path


def test_numbers_beyond_the_bound_are_refused_and_can_be_let_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = log_of(tmp_path / "a.parquet", 500)
    monkeypatch.setenv("FDD_MAX_VALUES", "999")
    with pytest.raises(InputError) as caught:
        open_log(path)
    assert "500 rows and 2 columns, at most 999" in str(caught.value)
    assert "set FDD_MAX_VALUES=1000" in str(caught.value)
    monkeypatch.setenv("FDD_MAX_VALUES", "1000")
    assert open_log(path).read(["time"])["time"].size == 500


@pytest.mark.parametrize("packed", [False, True])
def test_bytes_beyond_the_bound_are_refused_and_can_be_let_in(
    packed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = ("time,position\n" + "".join(f"{k * 1e-3},0.1\n" for k in range(500))).encode()
    path = tmp_path / "a.csv"
    path.write_bytes(gzip.compress(text) if packed else text)
    monkeypatch.setenv("FDD_MAX_LOG_BYTES", str(len(text) - 1))
    with pytest.raises(InputError, match="or, where memory allows, set FDD_MAX_LOG_BYTES="):
        open_log(path).read(["time"])
    monkeypatch.setenv("FDD_MAX_LOG_BYTES", str(len(text)))
    assert open_log(path).read(["time"])["time"].size == 500


@pytest.mark.parametrize("text", ["0", "-1", "1e9", "x", "9" * 30, "٣"])
def test_a_bound_that_is_no_number_is_told(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FDD_MAX_VALUES", text)
    with pytest.raises(InputError, match=r"FDD_MAX_VALUES: .* is no whole number above 0"):
        open_log(log_of(tmp_path / "a.parquet", 5))
