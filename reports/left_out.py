"""What is said of a fault that no catalogue has: each log once more, without its own fault's signatures."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Unpack

from fdd.campaign.dataset import Dataset
from fdd.campaign.scores import wilson
from fdd.campaign.train import identified_unit
from fdd.campaign.units import How, over_units
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import CATALOGUE
from fdd.markdown import table as markdown

SAID = ("nothing", "unknown", "a neighbour", "another")


def left_out(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[tuple[str, str]]:
    """Fault and what was said without it (of `SAID`), for each log with one fault that balances tell of.

    A neighbour is one that the whole catalogue's answer names as well, as the same log's ambiguity group.
    """
    return over_units(_said, [directory], Model.load(model), **how)


def _said(data: Dataset, unit: str, model: Model) -> list[tuple[str, str]]:
    profile, out = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        if len(entry.faults) != 1 or not CATALOGUE[entry.faults[0].fault].signatures:
            continue
        true = entry.faults[0].fault
        log = data.samples(entry)
        named = []
        for without in ((), (true,)):
            pipeline = Pipeline(profile, model, keep_trajectories=False, without=without)
            pipeline.push(log)
            named.append(pipeline.finish().faults[:1])
        whole, rest = named
        group = {g for f in whole for g in f.ambiguity}
        if not rest:
            out.append((true, "nothing"))
        elif rest[0].fault == "unknown":
            out.append((true, "unknown"))
        else:
            out.append((true, "a neighbour" if group & {*rest[0].ambiguity} else "another"))
    return out


def table(said: list[tuple[str, str]]) -> str:
    """The section of a report (Markdown)."""
    count = Counter(said)
    lines = [
        "\n## Kinds that the catalogue does not have\n\nEach log with one fault, diagnosed without that "
        "fault's signatures.\n",
        *markdown(
            ["left out", *SAID],
            [
                [kind.replace("_", " "), *(str(count[kind, s]) for s in SAID)]
                for kind in sorted({k for k, _ in said})
            ],
        ),
    ]
    answered = [s for _, s in said if s != "nothing"]
    right = sum(s != "another" for s in answered)
    lines.append(f"Unknown or a neighbour, of those with a finding: {wilson(right, len(answered))}")
    return "\n".join(lines) + "\n"
