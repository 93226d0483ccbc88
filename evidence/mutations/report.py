"""What tests noticed of the slips, as a table and a list."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from evidence.mutations.slips import Slip
from evidence.mutations.trying import MOST_TESTS_S, UNNOTICED

KNOWN = Path(__file__).with_name("survivors.json")
"""Of slips that no test can or need notice the reason; and how many there were before tests were written."""
HEAD = """# Slips that tests notice

Made by `python -m evidence mutations --each {each} --seed {seed}`. One operator, figure, condition or
statement of the product's Python code is changed at a time, never words or types, and tests run until one
fails. {each} slips a module are drawn at random, twice as many of the modules that decide, and two of those
that Numba compiles. Tests marked slow are left out, and the slower ones beyond {most:.0f} s of processor
time.

| room | slips | noticed | not noticed | not noticed at first |
| --- | --- | --- | --- | --- |
"""


def report_text(tried: Sequence[tuple[Slip, str]], *, seed: int, each: int) -> str:
    """The report (Markdown)."""
    known = json.loads(KNOWN.read_text(encoding="utf-8"))
    text = HEAD.format(seed=seed, each=each, most=MOST_TESTS_S)
    for room in dict.fromkeys(s.module.split(".")[1] for s, _ in tried):
        mine = [by for s, by in tried if s.module.split(".")[1] == room]
        lost = sum(by in UNNOTICED for by in mine)
        text += f"| {room} | {len(mine)} | {len(mine) - lost} | {lost} | {known['at first'][room]} |\n"
    text += "\n## Not noticed\n\n"
    for slip, by in sorted(tried):
        if by in UNNOTICED:
            why = known["why"].get(f"{slip.module} {slip.change}", "not looked into yet")
            run = " (never run)" if by == UNNOTICED[1] else ""
            text += f"- {slip.module} line {slip.line}{run}, {slip.change}: {why}\n"
    return text
