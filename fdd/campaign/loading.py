"""A data set as people who know pandas and scikit-learn want it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.campaign.dataset import Dataset, Split, split_of
from fdd.campaign.feature_table import feature_table, read_features
from fdd.campaign.units import How
from fdd.errors import InputError
from fdd.learning.features import FEATURES
from fdd.samples import Samples

FEATURES_FILE = "features.parquet"
"""Where a data set's features are looked for, in its folder."""

Target = Literal["fault", "family"]
Strings = NDArray[np.str_]


@dataclass(frozen=True)
class LabelledData:
    """A data set with its truth and, where they were made, its features.

    Attributes
    ----------
    data : the data set.
    truth : a row for each log: ``file``, ``unit``, ``split``, ``fault``, ``faults``, ``family``,
        ``severity``, ``onset_s``, ``profile``, ``law``, conditions, and ``true_…``: medians of what really
        was (SI).
    features : a row for each log (see `fdd.campaign.feature_table`); None where there are none.
    names : of the features, in the order of X.
    """

    data: Dataset
    truth: pd.DataFrame
    features: pd.DataFrame | None
    names: tuple[str, ...]

    def arrays(
        self, split: Split | None = None, target: Target = "family"
    ) -> tuple[NDArray[np.float64], Strings, Strings]:
        """What scikit-learn takes.

        Parameters
        ----------
        split : rows of these units; None gives all. target : what y is.

        Returns
        -------
        X (n, k) features, SI, NaN where a log tells nothing; y (n,) true faults or families, or ``healthy``;
        groups (n,) units.

        Raises
        ------
        InputError : the data set has no features.
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
        """The samples of a log, its hash checked.

        Raises
        ------
        InputError : no such log, or it was changed.
        """
        entry = next((e for e in self.data.logs if e.file == file), None)
        if entry is None:
            raise InputError(f"no log {file!r}", where=self.data.directory, mend="take one of truth['file']")
        self.data.check(file)
        return self.data.samples(entry)


def load_dataset(directory: str | Path, features: str | Path | None = None) -> LabelledData:
    """Open a data set that ``fdd generate`` made.

    Parameters
    ----------
    features : table that ``fdd features`` made of it; None takes ``features.parquet`` in its folder, if there
        is one.

    Raises
    ------
    InputError : not a data set, labels or recipe were changed, or features of other data.
    """
    data = Dataset.load(directory)
    path = data.directory / FEATURES_FILE if features is None else Path(features)
    truth = truth_table(data)
    if features is None and not path.is_file():
        return LabelledData(data, truth, None, ())
    table, about, roles = read_features(path)
    if about["data_sha256"] != data.manifest.sha256:
        mend = f"make them anew: fdd features {data.directory} -o {path}"
        raise InputError(f"features of other data than {data.directory}", where=path, mend=mend)
    names = tuple(name for name, role in roles.items() if role == "feature")
    return LabelledData(data, truth, table, names)


def with_features(directory: str | Path, **how: Unpack[How]) -> LabelledData:
    """A data set with its features: those in its folder, or made now where none of this version are there.

    Raises
    ------
    InputError : not a data set, without baselines, or features of other data in its folder.
    """
    found = load_dataset(directory)
    if found.names == tuple(FEATURES):
        return found
    table = feature_table(directory, **how)
    return replace(found, features=table.to_pandas(), names=tuple(FEATURES))


def truth_table(data: Dataset) -> pd.DataFrame:
    """The truth of a data set's logs, a row each; see `LabelledData`."""
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
