"""What the shell offers, and how the help is grouped."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from fdd.cli import completion
from fdd.faults import CATALOGUE
from fdd.plant import duty, load
from fdd.plant.scenario import Control


def offered(line: str) -> list[str]:
    """What bash would show after this line; the last word is being typed."""
    environment = {
        **os.environ, "_FDD_COMPLETE": "complete_bash", "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", "from fdd.cli import main; main()"], env=environment, capture_output=True,
        text=True, timeout=60,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("fdd d", ["diagnose", "demo"]),
        ("fdd simulate --fault pump", ["pump_wear"]),
        ("fdd simulate --profile st", ["standstill", "steps", "strokes"]),
        ("fdd simulate --load g", ["gust"]),
        ("fdd diagnose run.mcap --unit ", ["axis_a", "axis_b"]),
        ("fdd identify --base rig", []),
    ],
)
def test_the_shell_offers(line: str, expected: list[str]) -> None:
    assert offered(line) == expected


def test_what_is_offered_is_all_there_is() -> None:
    assert set(completion.DUTIES) == set(duty.DUTIES)
    assert set(completion.LOADS) == set(load.LOADS)
    assert [name for name, _ in completion.faults("")] == list(CATALOGUE)
    for mode in completion.CONTROLS:
        Control(mode=mode)  # type: ignore[arg-type]


def test_help_is_grouped(run) -> None:
    shown = run("--help").stdout
    places = [shown.index(f" {title} ─") for title in ("Use", "Rigs", "Research")]
    use, rigs, research = places
    assert places == sorted(places)
    for command, (start, stop) in {
        "diagnose": (use, rigs), "identify": (rigs, research), "profile": (rigs, research),
        "simulate": (research, len(shown)),
    }.items():  # fmt: skip
        assert start < shown.index(f"│ {command} ") < stop
    assert "--install-completion" in shown
