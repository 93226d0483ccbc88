"""What stands beside a data set for people: its card, the hashes of its files; and tables in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fdd.campaign import dataset
from fdd.campaign.dataset import LABELS, MANIFEST, RECIPE, SUMS, Dataset
from fdd.campaign.labels import CLASSES, ROWS_LOST, SEVERAL, Entry, visibility_class
from fdd.faults import CATALOGUE
from fdd.files import sha256_of, write_text
from fdd.yaml_reading import yaml_of

_RULES = {"l": "---", "r": "---:"}
_TWINS = """- `unit_NNN/twin_NNN.{format}`: each faulty log once more without its faults. Draws and noise are
  the same: equal to the last bit before the onset, and different after it by what the faults do.
"""
_VISIBILITY = """Log less twin, rms over the whole log, in standard deviations of the channel's noise (white
noise, tones, rounding). The largest rms is that of the pressures and the motor's current; visible: it is at
least one. The last columns count logs by it. Rows lost: it is below 1, but the fault takes values out of the
log. Angle and position are left out: encoders count finely and travel adds up, so that any fault would be
visible there; the labels have each channel."""


def write_sums(directory: Path) -> None:
    """Write the SHA-256 of all files that belong to a data set, as ``sha256sum -c`` checks them.

    Manifest and card are left out: they are written after it. So is what others put there.
    """
    files = [directory / RECIPE, directory / LABELS, *(p for p in directory.glob("*/*") if p.is_file())]
    named = ((path, path.relative_to(directory)) for path in sorted(files))
    shown = [(p, name) for p, name in named if not any(part.startswith(".") for part in name.parts)]
    write_text(directory / SUMS, "".join(f"{sha256_of(p)}  {name.as_posix()}\n" for p, name in shown))


def write_card(directory: Path) -> None:
    """Write a data set's card (Markdown), unless somebody has written one."""
    if not (directory / dataset.CARD).is_file():
        write_text(directory / dataset.CARD, _card(Dataset.load(directory)))


def _card(data: Dataset) -> str:
    """The card's text: it depends on recipe and labels alone."""
    recipe, made = data.recipe, data.manifest
    tags = ["fault-detection", "electro-hydrostatic-actuator", "simulated"]
    licence = {"license": recipe.licence} if recipe.licence else {}
    head = {**licence, "pretty_name": made.name, "tags": tags}
    rates = sorted({s.rate for s in recipe.structures} or {recipe.recording.rate})
    # Machines that differ in kind have channels of their own.
    alike = data.logs and not recipe.structures
    channels = f", {', '.join(data.samples(data.logs[0]).channels)}" if alike else ""
    calibration = "with" if any(made.baselines.values()) else "without"
    structures = f"; {len(recipe.structures)} structures" if recipe.structures else ""
    split = dataset.split_of(data.units, made.seed)
    told = {name: ", ".join(u for u in data.units if split[u] == name) or "none" for name in dataset.SPLITS}
    twins = _TWINS.format(format=recipe.format) if recipe.twins else ""
    visible = _visible(data) if recipe.twins else ""
    spread = f"within {recipe.variation:.0%}"
    if recipe.population == "stated":
        spread = "by the distributions of `fdd.campaign.population`, each with its source"
    cite = f"{made.name}, simulated with fdd {made.version}, seed {made.seed}, SHA-256 {made.sha256}."
    return f"""---
{yaml_of(head)}---

# {made.name}

{recipe.description or "Simulated logs of electro-hydrostatic actuators with injected faults."}

{made.number} logs ({made.hours:g} h) of {made.units} units, {calibration} healthy calibration runs.
Everything is simulated, by one plant (`fdd.plant`).

## How it was made

`fdd generate {RECIPE} -o DIR` with fdd {made.version}. `{RECIPE}` is the recipe with all its defaults and
its seed, {made.seed}; each log's own seed stands in `{LABELS}`. The same recipe, version and libraries give
the same bytes.

## What is in it

- `unit_NNN/log_NNN.{recipe.format}`: {" or ".join(f"{r} Hz" for r in rates)}{channels}. SI units.
- `unit_NNN/truth_NNN.parquet`: true leakage, bulk modulus, friction, pressures, severities at 20 Hz.
{twins}- `{LABELS}`: faults with severity and onset, load, duty and oil temperature of each log.
- `unit_NNN/true_unit.yaml`: the profile that was simulated. A diagnosis must not read it.

## Faults

{_faults(data)}

{visible}## Units and splits

Bases {", ".join(recipe.bases)}, numbers drawn {spread}{structures}.
No unit is in two splits.

{chr(10).join(f"- {name}: {units}" for name, units in told.items())}

## Hashes

`{MANIFEST}` holds the SHA-256 of labels and recipe, {made.sha256};
`{SUMS}` holds those of all files (`sha256sum -c {SUMS}`). `fdd.load_dataset` checks them.

## Licence

{recipe.licence or "None is stated. Whoever publishes the data states one here (`licence` in the recipe)."}

## How to cite

{recipe.cite or cite}
"""


def _faults(data: Dataset) -> str:
    """How often each fault is there, and how severe: a table."""
    rows = []
    for name in CATALOGUE:
        mine = [f for e in data.logs for f in e.faults if f.fault == name]
        if mine:
            spans = ([f.severity for f in mine], [f.onset_s for f in mine])
            named = (Counter(f.law for f in mine if f.law), Counter(f.profile for f in mine))
            told = [f"{min(values):.3g} to {max(values):.3g}" for values in spans]
            told += [", ".join(f"{n} {k}" for n, k in count.most_common()) for count in named]
            rows.append([name, str(len(mine)), *told])
    rows.append(["healthy", str(sum(e.healthy for e in data.logs)), "", "", "", ""])
    return "\n".join(table(["fault", "logs", "severity", "onset, s", "laws", "courses"], rows)[:-1])


def _visible(data: Dataset) -> str:
    """How far each fault's logs are from their twins: a section."""
    seen: dict[str, list[Entry]] = {}
    for e in data.logs:
        if e.visibility is not None:
            seen.setdefault(e.faults[0].fault if len(e.faults) == 1 else SEVERAL, []).append(e)
    rows = []
    for name in (n for n in (*CATALOGUE, SEVERAL) if n in seen):
        rms = [e.largest_rms or 0.0 for e in seen[name]]
        classes = Counter(visibility_class(e.visibility or {}) for e in seen[name])
        counts = [str(classes[each]) for each in (*CLASSES, ROWS_LOST)]
        visible = sum(bool(e.visible) for e in seen[name])
        rows.append([name, f"{visible} of {len(rms)}", f"{np.median(rms):.3g}", *counts])
    head = ["fault", "visible", "median of the largest rms", *CLASSES, ROWS_LOST]
    return "\n".join(["## Visibility", "", _VISIBILITY, "", *table(head, rows, "lr"), ""])


def table(head: Sequence[str], rows: Iterable[Sequence[str]], sides: str = "l") -> list[str]:
    """Lines of a table, an empty one last.

    `sides` says where columns' cells stand, ``l`` or ``r`` (numbers); the last letter holds for the rest.

    Examples
    --------
    >>> table(["fault", "logs"], [["aeration", "12"]], "lr")
    ['| fault | logs |', '| --- | ---: |', '| aeration | 12 |', '']
    """
    rule = [_RULES[side] for side in sides.ljust(len(head), sides[-1])]
    return ["| " + " | ".join(line) + " |" for line in (head, rule, *rows)] + [""]
