"""The features of a whole data set beside its truth, as one table in Parquet.

What each column is stands in the file: unit, meaning and role (``id``, ``label``, ``condition``, ``answer``
or ``feature``) in the metadata of its field; fdd's version and the data set's hash in those of the table.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Unpack

import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from fdd import __version__
from fdd.campaign.dataset import HEALTHY, Dataset, Manifest, split_of
from fdd.campaign.train import identified_unit
from fdd.campaign.units import How, over_units
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.learning.features import FEATURES, log_features

SCHEMA = "fdd.features/1"
KEY = b"fdd"
MEND = "make it with: fdd features DATASET -o FILE.parquet"

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


def feature_table(directory: str | Path, *, model: str | None = None, **how: Unpack[How]) -> pa.Table:
    """Diagnose every log of a data set, on profiles identified from its units' own baselines.

    Parameters
    ----------
    model : file of the learnt layer; None takes the shipped one.

    Returns
    -------
    Columns of `TOLD`, then `FEATURES`; a row for each log, by unit and log.

    Raises
    ------
    InputError : not a data set, without baselines, or an unusable model.
    """
    learnt = Model.load(model)
    rows = over_units(_unit_rows, [directory], learnt, **how)
    return table_of(rows, Dataset.load(directory).manifest, learnt.sha256)


def table_of(rows: list[dict[str, Any]], data: Manifest, model_sha256: str) -> pa.Table:
    """Rows with what the file has to say of them.

    Parameters
    ----------
    rows : a value for each of `TOLD` but the split, and of `FEATURES`. data : of their data set.
    """
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
        span = {"start_s": float(samples.time[0]), "end_s": float(samples.time[-1])}
        conditions = {name: getattr(entry.scenario, name) for name in ("load", "duty", "control")}
        rows.append({**entry.told, **span, **conditions, **_answer(answer), **row})
    return rows


def _answer(answer: Diagnosis) -> dict[str, Any]:
    family = max(answer.probabilities, key=lambda name: answer.probabilities[name])
    return {
        "answer_verdict": answer.verdict,
        "answer_fault": answer.faults[0].fault if answer.faults else HEALTHY,
        "answer_family": family, "answer_confidence": answer.probabilities[family],
    }  # fmt: skip


def write_features(table: pa.Table, path: str | Path) -> None:
    """Write a table whole or not at all; the same table gives the same bytes.

    Raises
    ------
    InputError : it cannot be written.
    """
    with whole_file(path) as temporary:
        parquet.write_table(table, temporary, compression="zstd")


def read_features(path: str | Path) -> tuple[pd.DataFrame, dict[str, Any], dict[str, str]]:
    """Read a table of features.

    Returns
    -------
    The table; what it says of itself (``fdd``, ``data``, ``data_sha256``, ``model_sha256``);
    role of each column.

    Raises
    ------
    InputError : no such file, or not one that `write_features` wrote.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=path, mend=MEND)
    try:
        table = parquet.read_table(path, memory_map=False)
        about = json.loads((table.schema.metadata or {})[KEY])
        roles = {f.name: f.metadata[b"role"].decode() for f in table.schema}
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        raise InputError("not a table of features", where=path, mend=MEND) from None
    if not isinstance(about, dict) or about.get("schema") != SCHEMA:
        raise InputError(f"not of version {SCHEMA}", where=path, mend=MEND)
    return table.to_pandas(), about, roles
