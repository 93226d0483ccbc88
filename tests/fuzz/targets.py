"""What is fuzzed: each kind of file, its seeds, how it is changed, and all that fdd does with it."""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from fdd.campaign.recipe import Recipe
from fdd.cli.batch import ANSWERS, AnswersFolder
from fdd.data_sheet.profile import read_answers
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import LogFile, open_log
from fdd.logs.mapping import propose
from fdd.monitor import LineParser
from fdd.monitor.stream import split_lines
from fdd.unit import Unit
from tests.fuzz.mutations import (
    bytes_changed,
    data_changed,
    gzip_changed,
    mcap_changed,
    text_changed,
    zip_changed,
)

ROOT = Path(__file__).parents[2]
SEEDS, CORPUS = Path(__file__).parent / "seeds", Path(__file__).parent / "corpus"
TOPICS = ChannelMap.load(SEEDS / "map/topics.yaml")
MOST_LINE = 4300
"""Characters of a refusal."""


@dataclass(frozen=True)
class Kind:
    """What is done with a file, how a seed's bytes are changed, and seeds that stand elsewhere anyway."""

    act: Callable[[Path], object]
    change: Callable[[bytes, random.Random, str], bytes]
    elsewhere: tuple[str, ...] = ()

    def seeds(self, name: str) -> list[Path]:
        """The valid files, in a fixed order."""
        found = [*(SEEDS / name).glob("*"), *(p for pattern in self.elsewhere for p in ROOT.glob(pattern))]
        return sorted(found)


def _check(error: InputError) -> None:
    text = str(error)
    assert len(text.splitlines()) == 1 and len(text) <= MOST_LINE, f"no single line: {text[:300]!r}"


def _read_all(log: LogFile) -> None:
    columns = log.read(log.signals)
    for signal in log.signals.values():
        size = columns[signal.name].size
        stamps = log.stamps(signal.clock)
        assert stamps is None or stamps.size == size, f"{stamps.size} stamps of {size} rows"


def _log(path: Path, channel_map: ChannelMap | None = None) -> None:
    """All that is done with a log; an `InputError` of one step does not keep the others from their turn."""
    first: InputError | None = None
    with np.errstate(all="ignore"):
        log = open_log(path)
        for step in (
            lambda: _read_all(log),
            lambda: read_log(path, channel_map, shortest=0.1),
            lambda: propose(log).channel_map(),
        ):
            try:
                step()
            except InputError as error:
                _check(error)
                first = first or error
    if first is not None:
        raise first


def _answers(path: Path) -> None:
    """An earlier answer, as ``fdd diagnose --resume`` takes it up."""
    folder = path.parent / "answers"
    folder.mkdir(exist_ok=True)
    (folder / ANSWERS).write_bytes(path.read_bytes())
    job = SimpleNamespace(name="run.mcap", path=path, outputs=[])
    sums, versions = (lambda p: {"log": "0" * 64}), {"fdd": "0.1.0"}
    diagnoser = SimpleNamespace(settings=SimpleNamespace(axis=None), hashes=sums, versions=versions)
    AnswersFolder(folder).earlier([job], diagnoser)


def _lines(path: Path) -> None:
    """A stream of JSON lines, in two parts, as the monitor takes it."""
    raw, parser = path.read_bytes(), LineParser()
    first, tail, _ = split_lines(b"", raw[: len(raw) // 2], False)
    with np.errstate(all="ignore"):
        parser.samples(first)
        parser.samples(split_lines(tail, raw[len(raw) // 2 :], True)[0])
    parser.quality()


def _model(path: Path) -> None:
    """A model that is read is fit for use: thresholds are finite, probabilities within 0 and 1."""
    model = Model.load(path)
    assert all(math.isfinite(model.tail.threshold(rate)) for rate in (1e-9, 1.0, 1e9))
    assert all(0.0 <= model.calibration.probability(s) <= 1.0 for s in (-1e9, 0.0, 1e9))


def _profile(path: Path) -> None:
    """The effects of faults on a profile that is read can be told apart."""
    for effects in effects_of(Unit.load(path)).values():
        assert np.isfinite(np.linalg.inv(effects.covariance)).all()


def _plain(change: Callable[[bytes, random.Random], bytes]) -> Callable[[bytes, random.Random, str], bytes]:
    return lambda raw, rng, suffix: change(raw, rng)


KINDS: dict[str, Kind] = {
    "csv": Kind(_log, _plain(text_changed)),
    "gzip": Kind(_log, _plain(gzip_changed)),
    "xlsx": Kind(_log, _plain(zip_changed)),
    **dict.fromkeys(
        ("parquet", "feather", "matlab", "hdf5", "tdms", "mdf"), Kind(_log, _plain(bytes_changed))
    ),
    "mcap": Kind(lambda path: _log(path, TOPICS), _plain(mcap_changed)),
    "map": Kind(ChannelMap.load, data_changed, ("examples/*.map.yaml",)),
    "unit": Kind(_profile, data_changed, ("fdd/units/*.yaml", "fdd/demo/unit.yaml")),
    "model": Kind(_model, data_changed, ("fdd/diagnosis/model.json",)),
    "recipe": Kind(Recipe.load, data_changed, ("datasets/*.yaml",)),
    "sheet": Kind(read_answers, data_changed, ("examples/*.datasheet.yaml",)),
    "answers": Kind(_answers, data_changed),
    "lines": Kind(_lines, data_changed),
}


def case(kind: str, seed: int, number: int) -> tuple[str, bytes]:
    """Suffix and bytes of one case: the same for the same kind, seed and number."""
    rng = random.Random(f"{kind}/{seed}/{number}")
    path = rng.choice(KINDS[kind].seeds(kind))
    suffix = "".join(path.suffixes[-2:]) if path.suffix == ".gz" else path.suffix
    return suffix, KINDS[kind].change(path.read_bytes(), rng, suffix)


def run(kind: str, path: Path) -> str:
    """Let fdd do all it does with a file: ``"read"`` or ``"refused"``; whatever else it raises is a find."""
    try:
        KINDS[kind].act(path)
    except InputError as error:
        _check(error)
        return "refused"
    return "read"
