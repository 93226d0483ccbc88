"""A data set as people who know pandas and scikit-learn want it: its truth, and the features of its logs.

Features stand in one table in Parquet, and what each column is in the file: unit, meaning and role (``id``,
``label``, ``condition``, ``answer`` or ``feature``) in the metadata of its field; fdd's version and the data
set's hash in those of the table.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from fdd import __version__
from fdd.campaign.dataset import Dataset, How, Split, over_units, split_of
from fdd.campaign.labels import HEALTHY, Manifest
from fdd.campaign.spreads import identified_unit
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.learning.features import FEATURES, log_features
from fdd.samples import Samples

FEATURES_FILE = "features.parquet"
"""Where a data set's features are looked for, in its folder."""
SCHEMA = "fdd.features/1"
KEY = b"fdd"
MEND = "make it with: fdd features DATASET -o FILE.parquet"
Target = Literal["fault", "family"]
Strings = NDArray[np.str_]

TOLD: dict[str, tuple[str, str, str]] = {
    "file": ("id", "", "log, below the data set's folder"),
    "start_s": ("id", "s", "start of the row's time"),
    "end_s": ("id", "s", "end of it"),
    "unit": ("id", "", "the actuator: rows of one belong together"),
    "split": ("id", "", "train, validation or test; all rows of a unit are in one"),
    "fault": ("label", "", "true fault, the first one injected; or healthy"),
    "faults": ("label", "", "all of them, with blanks between"),
    "family": ("label", "", "of that fault, or healthy"),
    "severity": ("label", "1", "of that fault, 0 to 1; 0 while healthy"),
    "onset_s": ("label", "s", "when that fault begins"),
    "structure": ("condition", "", "kind of machine; empty where the recipe has none"),
    "load": ("condition", "", "kind of load"),
    "duty": ("condition", "", "kind of motion"),
    "control": ("condition", "", "position or speed"),
    "answer_verdict": ("answer", "", "of fdd diagnose"),
    "answer_fault": ("answer", "", "its surest fault, or healthy"),
    "answer_family": ("answer", "", "its likeliest family, or healthy"),
    "answer_confidence": ("answer", "1", "probability that it gives that family"),
}
"""Columns beside the features: role, unit and meaning."""


def feature_table(directory: str | Path, *, model: Path | None = None, **how: Unpack[How]) -> pa.Table:
    """Diagnose every log of a data set, on profiles identified from its units' own baselines.

    The table has the columns of `TOLD`, then `FEATURES`, and a row for each log, by unit and log. `model` is
    the file of the learnt layer, None takes the shipped one. An InputError where it is no data set, one
    without baselines, or the model is unusable.
    """
    learnt = Model.load(model)
    rows = over_units(_unit_rows, [directory], learnt, **how)
    return table_of(rows, Dataset.load(directory).manifest, learnt.sha256)


def table_of(rows: list[dict[str, Any]], data: Manifest, model_sha256: str) -> pa.Table:
    """Rows, with a value for each of `TOLD` but the split and of `FEATURES`, and what the file has to say."""
    split = split_of(tuple(data.baselines), data.seed)
    plain = {name: [split[r["unit"]] if name == "split" else r[name] for r in rows] for name in TOLD}
    plain |= {name: [r[name] for r in rows] for name in FEATURES}
    kinds = {**TOLD, **{n: ("feature", f.unit, f.meaning) for n, f in FEATURES.items()}}
    fields = []
    for name, (role, unit, meaning) in kinds.items():
        kind = pa.float64() if name in FEATURES or unit else pa.string()
        fields.append(pa.field(name, kind, metadata={"role": role, "unit": unit, "meaning": meaning}))
    about = {
        "schema": SCHEMA, "fdd": __version__, "data": data.name, "data_sha256": data.sha256,
        "model_sha256": model_sha256, "window_s": None,
    }  # fmt: skip
    return pa.table(plain, schema=pa.schema(fields, metadata={KEY: json.dumps(about)}))


def _unit_rows(data: Dataset, unit: str, model: Model) -> list[dict[str, Any]]:
    profile, rows = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        samples = data.samples(entry)
        answer, row = log_features(samples, profile, model)
        family = max(answer.probabilities, key=lambda name: answer.probabilities[name])
        rows.append({
            **entry.told, "start_s": float(samples.time[0]), "end_s": float(samples.time[-1]),
            **{name: getattr(entry.scenario, name) for name in ("load", "duty", "control")},
            "answer_verdict": answer.verdict,
            "answer_fault": answer.faults[0].fault if answer.faults else HEALTHY,
            "answer_family": family, "answer_confidence": answer.probabilities[family], **row,
        })  # fmt: skip
    return rows


def write_features(table: pa.Table, path: str | Path) -> None:
    """Write a table whole or not at all; the same table gives the same bytes."""
    with whole_file(path) as temporary:
        parquet.write_table(table, temporary, compression="zstd")


def _read_features(path: Path) -> tuple[pd.DataFrame, str, tuple[str, ...]]:
    """A table of features, the hash of its data set, and the names of the features among its columns."""
    if not path.is_file():
        raise InputError("no such file", where=path, mend=MEND)
    try:
        table = parquet.read_table(path, memory_map=False)
        about = json.loads((table.schema.metadata or {})[KEY])
        names = tuple(f.name for f in table.schema if f.metadata[b"role"] == b"feature")
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        raise InputError("not a table of features", where=path, mend=MEND) from None
    if not isinstance(about, dict) or about.get("schema") != SCHEMA:
        raise InputError(f"not of version {SCHEMA}", where=path, mend=MEND)
    return table.to_pandas(), about["data_sha256"], names


@dataclass(frozen=True)
class LabelledData:
    """A data set with its truth and, where they were made, its features.

    Attributes
    ----------
    data : the data set.
    truth : a row for each log: ``file``, ``unit``, ``split``, ``fault``, ``faults``, ``family``,
        ``severity``, ``onset_s``, ``profile``, ``law``, conditions, and ``true_…``: medians of what really
        was (SI).
    features : a row for each log of `feature_table`; None where there are none.
    names : of the features, in the order of X.
    """

    data: Dataset
    truth: pd.DataFrame
    features: pd.DataFrame | None
    names: tuple[str, ...]

    def arrays(
        self, split: Split | None = None, target: Target = "family"
    ) -> tuple[NDArray[np.float64], Strings, Strings]:
        """What scikit-learn takes, of a `split` or of all units; an InputError where there are no features.

        X (n, k) features, SI, NaN where a log tells nothing; y (n,) true faults or families as `target` says,
        or ``healthy``; groups (n,) units.
        """
        rows = self.rows(split)
        x = rows[list(self.names)].to_numpy(dtype=np.float64)
        return x, rows[target].to_numpy(dtype=np.str_), rows["unit"].to_numpy(dtype=np.str_)

    def rows(self, split: Split | None = None) -> pd.DataFrame:
        """The table of features, of one split or whole; an InputError as of `arrays`."""
        if self.features is None:
            folder = self.data.directory
            mend = f"make them with: fdd features {folder} -o {folder / FEATURES_FILE}"
            raise InputError("no features", where=folder, mend=mend)
        return self.features if split is None else self.features[self.features["split"] == split]

    def samples(self, file: str) -> Samples:
        """The samples of a log, its hash checked; an InputError where there is none, or it was changed."""
        entry = next((e for e in self.data.logs if e.file == file), None)
        if entry is None:
            raise InputError(f"no log {file!r}", where=self.data.directory, mend="take one of truth['file']")
        self.data.check(file)
        return self.data.samples(entry)


def load_dataset(directory: str | Path, features: str | Path | None = None) -> LabelledData:
    """Open a data set that ``fdd generate`` made.

    `features` is the table that ``fdd features`` made of it; None takes ``features.parquet`` in its folder,
    if there is one. An `InputError` where it is no data set, labels or recipe were changed, or the features
    are of other data.
    """
    data = Dataset.load(directory)
    path = data.directory / FEATURES_FILE if features is None else Path(features)
    truth = _truth_table(data)
    if features is None and not path.is_file():
        return LabelledData(data, truth, None, ())
    table, sha256, names = _read_features(path)
    if sha256 != data.manifest.sha256:
        mend = f"make them anew: fdd features {data.directory} -o {path}"
        raise InputError(f"features of other data than {data.directory}", where=path, mend=mend)
    return LabelledData(data, truth, table, names)


def with_features(directory: str | Path, **how: Unpack[How]) -> LabelledData:
    """A data set with its features: those in its folder, or made now where none of this version are there;
    errors are those of `load_dataset` and `feature_table`."""
    found = load_dataset(directory)
    if found.names == tuple(FEATURES):
        return found
    return replace(found, features=feature_table(directory, **how).to_pandas(), names=tuple(FEATURES))


def _truth_table(data: Dataset) -> pd.DataFrame:
    split = split_of(data.units, data.manifest.seed)
    rows = []
    for e in data.logs:
        lead = e.faults[0] if e.faults else None
        how = {name: getattr(lead, name, None) for name in ("profile", "law", "channel")}
        same = {name: getattr(e, name) for name in ("duration_s", "samples", "base", "condition")}
        rows.append({
            **e.told, "onset_s": lead.onset_s if lead else np.nan, "split": split[e.unit], **how, **same,
            **e.scenario.model_dump(),
            **{f"true_{name}": value for name, value in e.truth_medians.items()},
        })  # fmt: skip
    return pd.DataFrame(rows)
