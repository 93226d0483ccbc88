"""Convert the logs of rigs 0, 2, 3 and 5 (CSV of a German logger, HDF5, MDF4, MATLAB 5) to SI Parquet.

    python examples/convert_rigs.py LOGS -o OUT [--rigs rig0 rig2]

LOGS holds a folder per rig. Each log becomes a plain table under the rig's own column names first, then
``examples/<rig>.map.yaml`` makes the contract's channels of it, as for any foreign log. Rigs 1 and 4
(Parquet, MCAP) go through their maps straight away; logs that carry the contract's own columns (rigs 6
and 7) are only linked. OUT/<rig>/<log>.parquet is read by `fdd` without a map.

HDF5 and MDF4 need h5py and asammdf, which `fdd` itself does not depend on: they are for this script alone.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fdd.errors import InputError
from fdd.logs import ChannelMap, read_log
from fdd.logs.conversion import held
from fdd.logs.tabular_writing import write_parquet

MAPS = Path(__file__).parent
OIL_HELD = 5.0
"""s; the oil is measured once a second, and its temperature does not change much in five."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rigs", nargs="*", help="only these folders")
    options = parser.parse_args()
    rigs = options.rigs or sorted(p.name for p in options.logs.iterdir() if p.is_dir())
    for rig in rigs:
        folder = options.output / rig
        folder.mkdir(parents=True, exist_ok=True)
        for log in sorted((options.logs / rig).iterdir()):
            if log.suffix == ".json":
                continue
            convert(log, MAPS / f"{rig}.map.yaml", folder / f"{log.stem}.parquet")


def convert(log: Path, map_file: Path, target: Path) -> None:
    """Write one log as SI Parquet; without a map file it is in SI already and only linked."""
    if not map_file.exists():
        read_log(log)
        target.unlink(missing_ok=True)
        target.symlink_to(log.resolve())
        return
    table = TABLES.get(log.suffix)
    channel_map = ChannelMap.load(map_file)
    if table is None:
        write_parquet(target, read_log(log, channel_map).samples)
        return
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / f"{log.stem}.parquet"
        table(log).to_parquet(plain, index=False)
        write_parquet(target, read_log(plain, channel_map).samples)


def from_csv(log: Path) -> pd.DataFrame:
    """Semicolons, decimal commas, Latin-1, a comment above the names and a line of units below them."""
    return pd.read_csv(log, sep=";", decimal=",", encoding="latin-1", comment="#", skiprows=[2])


def from_hdf5(log: Path) -> pd.DataFrame:
    """Groups of two rates, each with its stamps in ns of the day; the slower one is held."""
    import h5py  # type: ignore[import-untyped]

    with h5py.File(log) as file:
        fast, slow = (
            {name: column[:].astype(np.int64 if name == "stamp" else float) for name, column in g.items()}
            for g in (file["daq/fast"], file["daq/slow"])
        )
    stamp = fast.pop("stamp")
    oil = held(stamp, slow["stamp"], slow["T_oil"], OIL_HELD)
    return pd.DataFrame({"t": (stamp - stamp[0]) * 1e-9, **fast, "T_oil": oil})


def from_mdf(log: Path) -> pd.DataFrame:
    """One channel group a rate; the slower ones are held."""
    from asammdf import MDF

    with MDF(log) as file:
        groups: list[Any] = file.groups
        signals = [
            file.get(c.name, group=i)
            for i, group in enumerate(groups)
            for c in group.channels
            if c.name != "time"
        ]
    return on_longest((s.name, s.timestamps, s.samples) for s in signals)


def from_matlab(log: Path) -> pd.DataFrame:
    """A struct of signals, each with its own time, value and unit; slower ones are held."""
    from scipy.io import loadmat

    record = loadmat(log, simplify_cells=True)["rec"]
    return on_longest((name, s["time"], s["value"]) for name, s in record.items())


def on_longest(signals: Iterable[tuple[str, Any, Any]]) -> pd.DataFrame:
    """Signals on the time base of the one with the most rows, in a column ``t``."""
    series = [
        (name, np.rint(np.asarray(t, float) * 1e9).astype(np.int64), np.asarray(v, float))
        for name, t, v in signals
    ]
    base = max((stamps for _, stamps, _ in series), key=len)
    columns = {
        name: values if np.array_equal(stamps, base) else held(base, stamps, values, OIL_HELD)
        for name, stamps, values in series
    }
    return pd.DataFrame({"t": base * 1e-9, **columns})


TABLES: dict[str, Callable[[Path], pd.DataFrame]] = {
    ".csv": from_csv,
    ".h5": from_hdf5,
    ".mf4": from_mdf,
    ".mat": from_matlab,
}

if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"error: {error}") from None
