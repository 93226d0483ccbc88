"""Names as rigs have them, by language and trade: none of them is of a rig that we know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from fdd import Scenario, simulate
from fdd.logs.formats import open_log
from fdd.logs.mapping.proposal import propose
from fdd.measures import find_measure
from fdd.samples import CHANNELS, Samples

RIGS = yaml.safe_load(Path(__file__).with_name("rig_names.yaml").read_text("utf-8"))
OTHERS = {"winding": (45.0, 0.1), "case": (1.5, 0.0), "ambient": (21.0, 0.0)}
"""What rigs record besides: level and drift a second, in the units of the table."""


@pytest.fixture(scope="module")
def samples() -> Samples:
    """Half a minute of steps against a spring, at 250 Hz."""
    duty = {"duty": {"name": "steps"}, "load": {"name": "spring"}}
    log = simulate("axis_a", Scenario(duration=30.0, seed=3, **duty)).samples
    return Samples(log.time[::4], {name: column[::4] for name, column in log.columns.items()})


def written(samples: Samples, rig: str, path: Path) -> dict[str, str]:
    """The log as the rig writes it; channel to column."""
    columns, names = {}, {}
    for name, (what, unit) in RIGS[rig]["signals"].items():
        column = RIGS[rig]["form"].format(name, unit)
        if what in OTHERS:
            level, drift = OTHERS[what]
            columns[column] = level + drift * samples.time
            continue
        measure = find_measure(unit, CHANNELS[what].dimension)
        assert measure is not None, unit
        values = samples.time if what == "time" else samples[what]
        columns[column] = (values - measure.offset) / measure.factor
        names[what] = column
    pd.DataFrame(columns).to_csv(path, index=False, sep=";", float_format="%.7g")
    return names


@pytest.mark.parametrize("rig", RIGS)
def test_every_channel_is_found_and_nothing_else(rig: str, samples: Samples, tmp_path: Path) -> None:
    names = written(samples, rig, tmp_path / "log.csv")
    rows = propose(open_log(tmp_path / "log.csv")).rows
    assert rows.keys() == names.keys()
    assert all(names[channel].endswith(str(row.source.column)) for channel, row in rows.items())
    if RIGS[rig]["form"] != "{}":  # else units are asked for
        for what, unit in RIGS[rig]["signals"].values():
            if what in rows:
                said, wanted = (
                    find_measure(str(u), CHANNELS[what].dimension) for u in (rows[what].source.unit, unit)
                )
                assert said is not None and wanted is not None and np.isclose(said.factor, wanted.factor), (
                    what
                )
