"""What is fuzzed: each kind of file, its seeds, how it is changed, and all that fdd does with it."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from fdd.errors import InputError
from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import LogFile, open_log
from fdd.logs.mapping.concepts import Words
from fdd.logs.mapping.proposal import propose
from tests.fuzz.containers import gzip_changed, mcap_changed, zip_changed
from tests.fuzz.mutations import bytes_changed, data_changed, text_changed

ROOT = Path(__file__).parents[2]
SEEDS, CORPUS = Path(__file__).parent / "seeds", Path(__file__).parent / "corpus"
MOST_LINE = 4300
"""Characters of a refusal."""


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    act : all that is done with a file. change : of a seed's bytes. elsewhere : seeds that stand in the
        repository anyway.
    """

    act: Callable[[Path], object]
    change: Callable[[bytes, random.Random, str], bytes]
    elsewhere: tuple[str, ...] = ()

    def seeds(self, name: str) -> list[Path]:
        """The valid files, in a fixed order."""
        found = [*(SEEDS / name).glob("*"), *(p for pattern in self.elsewhere for p in ROOT.glob(pattern))]
        return sorted(found)


def _each(*steps: Callable[[], object]) -> None:
    """Carry out all steps; an `InputError` of one does not keep the others from their turn."""
    first: InputError | None = None
    for step in steps:
        try:
            step()
        except InputError as error:
            _check(error)
            first = first or error
    if first is not None:
        raise first


def _check(error: InputError) -> None:
    text = str(error)
    assert len(text.splitlines()) == 1 and len(text) <= MOST_LINE, f"no single line: {text[:300]!r}"


def _read_all(log: LogFile) -> None:
    columns = log.read(log.signals)
    for signal in log.signals.values():
        size = columns[signal.name].size
        stamps = log.stamps(signal.clock)
        assert stamps is None or stamps.size == size, f"{stamps.size} stamps of {size} rows"


@cache
def _map_of_topics() -> ChannelMap:
    return ChannelMap.load(SEEDS / "map/topics.yaml")


def _log(path: Path, channel_map: ChannelMap | None = None) -> None:
    with np.errstate(all="ignore"):
        log = open_log(path)
        _each(
            lambda: _read_all(log),
            lambda: read_log(path, channel_map, shortest=0.1),
            lambda: propose(log).channel_map(),
        )


def _messages(path: Path) -> None:
    _log(path, _map_of_topics())


def _calls(module: str, name: str) -> Callable[[Path], object]:
    """A function of fdd that takes a path, imported when it is called."""
    return lambda path: attrgetter(name)(import_module(module))(path)


def _answers(path: Path) -> None:
    """An earlier answer, as ``fdd diagnose --resume`` takes it up."""
    from fdd.cli.batch import ANSWERS, AnswersFolder

    folder = path.parent / "answers"
    folder.mkdir(exist_ok=True)
    (folder / ANSWERS).write_bytes(path.read_bytes())
    job = SimpleNamespace(name="run.mcap", path=path, outputs=[])
    sums, versions = (lambda p: {"log": "0" * 64}), {"fdd": "0.1.0"}
    diagnoser = SimpleNamespace(settings=SimpleNamespace(axis=None), hashes=sums, versions=versions)
    AnswersFolder(folder).earlier([job], diagnoser)  # type: ignore[list-item, arg-type]


def _lines(path: Path) -> None:
    """A stream of JSON lines, in two parts, as the monitor takes it."""
    from fdd.monitor.lines import LineParser, split_lines

    raw, parser = path.read_bytes(), LineParser()
    first, tail, _ = split_lines(b"", raw[: len(raw) // 2], False)
    with np.errstate(all="ignore"):
        parser.samples(first)
        parser.samples(split_lines(tail, raw[len(raw) // 2 :], True)[0])
    parser.quality()


def _model(path: Path) -> None:
    """A model that is read is fit for use: thresholds are finite, probabilities within 0 and 1."""
    from fdd.diagnosis.model import Model

    model = Model.load(path)
    assert all(math.isfinite(model.tail.threshold(rate)) for rate in (1e-9, 1.0, 1e9))
    assert all(0.0 <= model.calibration.probability(s) <= 1.0 for s in (-1e9, 0.0, 1e9))


def _profile(path: Path) -> None:
    """The effects of faults on a profile that is read can be told apart."""
    from fdd.diagnosis.baseline import effects_of
    from fdd.unit import Unit

    for effects in effects_of(Unit.load(path)).values():
        assert np.isfinite(np.linalg.inv(effects.covariance)).all()


def _plain(change: Callable[[bytes, random.Random], bytes]) -> Callable[[bytes, random.Random, str], bytes]:
    return lambda raw, rng, suffix: change(raw, rng)


_BYTES = _plain(bytes_changed)
KINDS: dict[str, Kind] = {
    "csv": Kind(_log, _plain(text_changed)),
    "gzip": Kind(_log, _plain(gzip_changed)),
    "parquet": Kind(_log, _BYTES),
    "feather": Kind(_log, _BYTES),
    "xlsx": Kind(_log, _plain(zip_changed)),
    "matlab": Kind(_log, _BYTES),
    "hdf5": Kind(_log, _BYTES),
    "tdms": Kind(_log, _BYTES),
    "mdf": Kind(_log, _BYTES),
    "mcap": Kind(_messages, _plain(mcap_changed)),
    "map": Kind(ChannelMap.load, data_changed, ("examples/*.map.yaml",)),
    "words": Kind(lambda p: Words(p).concepts("Speicherdruck"), data_changed),
    "unit": Kind(_profile, data_changed, ("fdd/units/*.yaml", "fdd/demo/unit.yaml")),
    "model": Kind(_model, data_changed, ("fdd/diagnosis/model.json",)),
    "recipe": Kind(_calls("fdd.campaign.recipe", "Recipe.load"), data_changed, ("datasets/*.yaml",)),
    "sheet": Kind(
        _calls("fdd.data_sheet.answers", "read_answers"), data_changed, ("examples/*.datasheet.yaml",)
    ),
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
