"""A generated data set, read back: its logs with their labels, the truth, the units' calibration runs; and
the same work for each of its units, in as many processes as are wanted."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, TypedDict, TypeVar, TypeVarTuple, Unpack

import numpy as np
from pydantic import TypeAdapter, ValidationError

from fdd.bounds import MAX_JSON_BYTES
from fdd.campaign.labels import Entry, Manifest
from fdd.campaign.recipe import Recipe
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError, input_error
from fdd.files import sha256_of
from fdd.logs import read_log
from fdd.plant.state import TRUTH, Truth
from fdd.samples import Samples
from fdd.unit import Unit
from fdd.yaml_reading import yaml_text

DATASET_SCHEMA = "fdd.dataset/1"
RECIPE = "recipe.yaml"
LABELS = "labels.json"
MANIFEST = "manifest.json"
"""Written last: a folder without it is unfinished."""
CARD = "README.md"
SUMS = "SHA256SUMS"
"""Hashes of all other files, as sha256sum has them."""
PARTS = ".parts"
"""Label of each finished run, until the data set is complete."""
TRUE_UNIT = "true_unit.yaml"
BASE_UNIT = "base_unit.yaml"
"""The data sheet that the unit was varied from, where no shipped profile is it."""
SHARE = 0.2
"""Of the units, for validation, and again for test."""
Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
M = TypeVar("M")
Progress = Callable[[int, int], None]
Job = TypeVar("Job")
Result = TypeVar("Result")
Given = TypeVarTuple("Given")
AGAIN = "copy the data set again or generate it anew"


@dataclass(frozen=True)
class Dataset:
    """A data set on disk: what it was made from, what it says of itself, and its logs by unit and number,
    which are read when they are asked for."""

    directory: Path
    recipe: Recipe
    manifest: Manifest
    logs: tuple[Entry, ...]

    @classmethod
    def load(cls, directory: str | Path) -> Dataset:
        """Open a data set; an InputError where it is none, unfinished, of another version, or its labels or
        recipe were changed."""
        directory = Path(directory)
        mend = "make one with: fdd generate RECIPE -o DIR"
        if not directory.is_dir():
            raise InputError("no such folder", where=directory, mend=mend)
        if not (directory / MANIFEST).is_file():
            kind = "not a"
            if (directory / RECIPE).is_file():
                kind, mend = "unfinished", f"finish it with: fdd generate {directory / RECIPE} -o {directory}"
            raise InputError(f"{kind} data set (no {MANIFEST})", where=directory, mend=mend)
        manifest = _read(Manifest, directory / MANIFEST)
        recipe_text, labels_text = _text(directory / RECIPE), _text(directory / LABELS)
        if digest(recipe_text, labels_text) != manifest.sha256:
            problem = f"{LABELS} or {RECIPE} is not what the manifest's SHA-256 was taken of"
            raise InputError(problem, where=directory, mend=AGAIN)
        logs = _read(tuple[Entry, ...], directory / LABELS)
        return cls(directory, Recipe.from_yaml(recipe_text, where=directory / RECIPE), manifest, logs)

    @property
    def described(self) -> str:
        """Name, seed and size, in a few words."""
        return f"{self.recipe.name} (seed {self.recipe.seed}, {len(self.units)} units, {len(self.logs)} logs)"

    @property
    def units(self) -> tuple[str, ...]:
        """Names of the units, in order."""
        return tuple(self.manifest.baselines)

    def logs_of(self, unit: str) -> tuple[Entry, ...]:
        """The unit's logs."""
        return tuple(e for e in self.logs if e.unit == unit)

    def check(self, *files: str) -> None:
        """Compare files below the data set's folder, all where none is given, with their SHA-256; an
        InputError where one is missing or was changed, or the data set has no hashes."""
        if not (self.directory / SUMS).is_file():
            mend = f"write them with: fdd generate {self.directory / RECIPE} -o {self.directory}"
            raise InputError(f"no hashes of the files ({SUMS})", where=self.directory, mend=mend)
        lines = _text(self.directory / SUMS).splitlines()
        known = {name: told for told, _, name in (line.partition("  ") for line in lines)}
        for name in files or known:
            path = self.directory / name
            if not path.is_file():
                raise InputError("is missing", where=path, mend=AGAIN)
            if sha256_of(path) != known.get(name):
                raise InputError(f"is not what {SUMS} was taken of", where=path, mend=AGAIN)

    def samples(self, entry: Entry) -> Samples:
        """The log, as any reader of logs gives it."""
        return read_log(self.directory / entry.file).samples

    def twin(self, entry: Entry) -> Samples | None:
        """The same log without its faults, of the same rows; None where there is none."""
        return None if entry.twin is None else read_log(self.directory / entry.twin).samples

    def truth(self, entry: Entry) -> Truth:
        """What really was, at 20 Hz; an InputError where the file is missing or damaged."""
        import pyarrow as pa
        from pyarrow import parquet

        path = self.directory / entry.truth
        try:
            table = parquet.read_table(path)
        except (OSError, pa.ArrowException) as error:
            problem = f"truth can't be read ({type(error).__name__})"
            raise InputError(problem, where=path, mend=AGAIN) from None
        columns = {n: np.asarray(table[n], dtype=np.float64) for n in table.column_names}
        severity = {n.removeprefix("severity_"): v for n, v in columns.items() if n.startswith("severity_")}
        return Truth(columns["time"], {n: v for n, v in columns.items() if n in TRUTH}, severity)

    def baseline(self, unit: str) -> list[Samples]:
        """What `baseline_files` hold."""
        return [read_log(path).samples for path in self.baseline_files(unit)]

    def baseline_files(self, unit: str) -> list[Path]:
        """The unit's healthy calibration runs, in the order they were taken; [] if the recipe has none; an
        InputError where there is no such unit."""
        if unit not in self.manifest.baselines:
            mend = f"the units are {self.units[0]} to {self.units[-1]}"
            raise InputError(f"no unit {unit!r}", where=self.directory, mend=mend)
        return [self.directory / file for file in self.manifest.baselines[unit]]

    def base_unit(self, unit: str) -> Unit:
        """The profile that an identification of the unit may start from: its data sheet."""
        path = self.directory / unit / BASE_UNIT
        if path.is_file():
            return Unit.load(path)
        return Unit.load(next(e.base for e in self.logs if e.unit == unit))

    def true_unit(self, unit: str) -> Unit:
        """The profile that the unit was simulated with, sensors' errors included."""
        return Unit.load(self.directory / unit / TRUE_UNIT)


def _text(path: Path) -> str:
    return yaml_text(path, "part of a data set", MAX_JSON_BYTES, AGAIN)


def _read(kind: type[M], path: Path) -> M:
    try:
        return TypeAdapter(kind).validate_json(_text(path))
    except ValidationError as error:
        raise input_error(error, path, AGAIN) from None


def digest(recipe_text: str, labels_text: str) -> str:
    """SHA-256 over a data set's labels and recipe, as its files have them."""
    return hashlib.sha256(labels_text.encode() + b"\0" + recipe_text.encode()).hexdigest()


def split_of(units: Sequence[str], seed: int = 0) -> dict[str, Split]:
    """Which units a learner sees, tunes by and is judged on: at random, the same way each time.

    A fifth each is for validation and test (at least one of three units or more; of two, one is for test),
    the rest for training.

    Examples
    --------
    >>> sorted(split_of(["a", "b"]).values())
    ['test', 'train']
    """
    order = sorted(units, key=lambda unit: hashlib.sha256(f"{seed}/{unit}".encode()).hexdigest())
    held = max(round(SHARE * len(order)), 1)
    test = set(order[:held] if len(order) > 1 else ())
    validation = set(order[held : 2 * held] if len(order) > 2 else ())
    return {u: "test" if u in test else "validation" if u in validation else "train" for u in units}


class How(TypedDict, total=False):
    """Where units are worked, see `fdd.engines.map_unordered`; `progress` is told (done, total) units."""

    workers: int | None
    progress: Progress | None
    engine: Engine


def over_units(
    work: Callable[[Dataset, str, *Given], list[Result]], directories: Sequence[str | Path], *given: *Given,
    **how: Unpack[How],
) -> list[Result]:  # fmt: skip
    """Join what `work`, a function of a module, gives for the units of data sets, in their order: of the data
    set, the unit's name and what is `given`. See `for_each_unit`."""
    folders = [data.directory / unit for data in map(Dataset.load, directories) for unit in data.units]
    return for_each_unit(partial(_opened, work, given), folders, **how)


def _opened(work: Callable[..., list[Result]], given: tuple[object, ...], folder: Path) -> list[Result]:
    return work(Dataset.load(folder.parent), folder.name, *given)


def for_each_unit(
    work: Callable[[Job], list[Result]], units: Sequence[Job], **how: Unpack[How]
) -> list[Result]:
    """Join what `work` gives for each unit, in the order of the units.

    A unit that refuses, as where a baseline cannot be identified, is left out with a warning; where all
    refuse, the last one's InputError is raised.
    """
    found: dict[int, list[Result] | InputError] = {}
    progress = how.get("progress") or (lambda done, total: None)
    engine, workers = how.get("engine", "local"), how.get("workers", 1)
    for number, told in map_unordered(partial(_tried, work), units, engine=engine, workers=workers):
        found[number] = told
        if isinstance(told, InputError):
            warnings.warn(f"{units[number]} left out: {told}", stacklevel=2)
        progress(len(found), len(units))
    refused = [told for told in found.values() if isinstance(told, InputError)]
    if refused and len(refused) == len(units):
        raise refused[-1]
    whole = (found[number] for number in range(len(units)))
    return [result for told in whole if not isinstance(told, InputError) for result in told]


def _tried(work: Callable[[Job], list[Result]], unit: Job) -> list[Result] | InputError:
    try:
        return work(unit)
    except InputError as error:
        return error
