"""Whether a diagnosis refuses, or warns of, logs in wrong units of measure, and lets sound ones pass."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

import numpy as np

from fdd.campaign.dataset import Dataset
from fdd.campaign.scores import wilson
from fdd.campaign.train import identified_unit
from fdd.campaign.units import How, over_units
from fdd.errors import InputError
from fdd.identification.log_scales import check_scales
from fdd.identification.own_scales import difference_is_made
from fdd.markdown import table as markdown
from fdd.samples import PRESSURES, Samples

CHAMBERS = ("pressure_1", "pressure_2")
SLIPS: dict[str, tuple[float, tuple[str, ...]]] = {
    "bar read as psi": (0.0689476, PRESSURES),
    "bar read as MPa": (10.0, PRESSURES),
    "bar read as kPa": (0.01, PRESSURES),
    "one chamber in MPa read as bar": (0.1, CHAMBERS[:1]),
    "mm read as inches": (25.4, ("position",)),
    "mm read as cm": (10.0, ("position",)),
    "rpm read as rad/s": (30.0 / np.pi, ("pump_speed",)),
    "degrees read as rad": (180.0 / np.pi, ("pump_angle",)),
    "ms read as s": (1e3, ("time",)),
}
SWAPPED, SOUND = "chambers swapped", "as it is"


def scales(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[tuple[str, str]]:
    """Slip and what is said of it (passed, warned, refused), for each healthy log and slip it can have."""
    return over_units(_said, [directory], **how)


def _said(data: Dataset, unit: str) -> list[tuple[str, str]]:
    profile, out = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        log = data.samples(entry) if entry.healthy else data.twin(entry)
        if log is None:
            continue
        for slip, wrong in (*slipped(log).items(), (SOUND, log)):
            try:
                notes = check_scales(wrong, profile, entry.file)
            except InputError:
                out.append((slip, "refused"))
            else:
                out.append((slip, "warned" if notes else "passed"))
    return out


def slipped(log: Samples) -> dict[str, Samples]:
    """A log under each slip that its channels can have."""
    out = {}
    for slip, (factor, channels) in SLIPS.items():
        mine = {c: factor * log[c] for c in channels if c in log}
        if channels == ("time",):
            out[slip] = Samples(factor * log.time, log.columns)
        elif mine:
            out[slip] = log.with_columns(mine)
            if difference_is_made(log) and channels == CHAMBERS[:1]:  # a reader makes it of what it reads
                wrong = mine[CHAMBERS[0]] - log[CHAMBERS[1]]
                out[slip] = out[slip].with_columns({"pressure_difference": wrong})
    if all(c in log for c in CHAMBERS):
        out[SWAPPED] = log.with_columns(
            dict(zip(CHAMBERS, (log[c] for c in reversed(CHAMBERS)), strict=True))
        )
    return out


def table(found: list[tuple[str, str]]) -> str:
    """The report (Markdown)."""
    rows = []
    for slip in (*SLIPS, SWAPPED, SOUND):
        said = [what for name, what in found if name == slip]
        rows.append(
            [slip, str(len(said)), *(wilson(said.count(x), len(said)) for x in ("refused", "warned"))]
        )
    return "\n".join(markdown(["log", "logs", "refused", "warned of"], rows)) + "\n"
