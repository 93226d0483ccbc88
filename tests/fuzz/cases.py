"""What is fuzzed: kinds of files and all that fdd does with each, case by case in processes that may die."""

from __future__ import annotations

import faulthandler
import math
import multiprocessing
import random
import resource
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import LogFile, open_log
from fdd.logs.mapping.concepts import Words
from fdd.logs.mapping.proposal import propose
from fdd.unit import Unit
from tests.fuzz.containers import gzip_changed, mcap_changed, zip_changed
from tests.fuzz.mutations import bytes_changed, data_changed, text_changed

ROOT = Path(__file__).parents[2]
SEEDS, CORPUS = Path(__file__).parent / "seeds", Path(__file__).parent / "corpus"
MOST_LINE = 4300
"""Characters of a refusal."""
MOST_SECONDS = 10.0
MOST_BYTES = 2 << 30
"""Of address space, beyond what the process has before its first case."""


def _check(error: InputError) -> None:
    text = str(error)
    assert len(text.splitlines()) == 1 and len(text) <= MOST_LINE, f"no single line: {text[:300]!r}"


def _each(*steps: Callable[[], object]) -> None:
    """Carry out all steps; an `InputError` of one does not keep the others from their turn."""
    refused: list[InputError] = []
    for step in steps:
        try:
            step()
        except InputError as error:
            _check(error)
            refused.append(error)
    if refused:
        raise refused[0]


def _read_all(log: LogFile) -> None:
    columns = log.read(log.signals)
    for signal in log.signals.values():
        size, stamps = columns[signal.name].size, log.stamps(signal.clock)
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


def _model(path: Path) -> None:
    """A model that is read gives thresholds and probabilities that are numbers."""
    model = Model.load(path)
    assert all(math.isfinite(model.tail.threshold(rate)) for rate in (1e-9, 1.0, 1e9))
    assert all(0.0 <= model.calibration.probability(score) <= 1.0 for score in (-1e9, 0.0, 1e9))


def _unit(path: Path) -> None:
    """The baseline of a profile that is read has covariances that can be inverted."""
    for effects in effects_of(Unit.load(path)).values():
        assert np.isfinite(np.linalg.inv(effects.covariance)).all()


def _answers(path: Path) -> None:
    """An earlier answer, as ``fdd diagnose --resume`` takes it up."""
    from fdd.cli.batch import ANSWERS, AnswersFolder

    folder = path.parent / "answers"
    folder.mkdir(exist_ok=True)
    (folder / ANSWERS).write_bytes(path.read_bytes())
    job = SimpleNamespace(name="run.mcap", path=path, report=None, page=None, mcap=None)
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


def _calls(module: str, name: str) -> Callable[[Path], object]:
    """A function of fdd that takes a path, imported when it is called."""
    return lambda path: attrgetter(name)(import_module(module))(path)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    act : all that is done with a file. change : of a seed's bytes, by its suffix for `data_changed`.
        elsewhere : seeds that stand in the repository anyway.
    """

    act: Callable[[Path], object]
    change: Callable[..., bytes] = data_changed
    elsewhere: tuple[str, ...] = ()

    def seeds(self, name: str) -> list[Path]:
        """The valid files, in a fixed order."""
        return sorted(
            [*(SEEDS / name).glob("*"), *(p for pattern in self.elsewhere for p in ROOT.glob(pattern))]
        )


KINDS: dict[str, Kind] = {
    "csv": Kind(_log, text_changed),
    "gzip": Kind(_log, gzip_changed),
    **{kind: Kind(_log, bytes_changed) for kind in ("parquet", "feather", "matlab", "hdf5", "tdms", "mdf")},
    "xlsx": Kind(_log, zip_changed),
    "mcap": Kind(lambda path: _log(path, _map_of_topics()), mcap_changed),
    "map": Kind(ChannelMap.load, elsewhere=("examples/*.map.yaml",)),
    "words": Kind(lambda path: Words(path).concepts("Speicherdruck")),
    "unit": Kind(_unit, elsewhere=("fdd/units/*.yaml", "fdd/demo/unit.yaml")),
    "model": Kind(_model, elsewhere=("fdd/diagnosis/model.json",)),
    "recipe": Kind(_calls("fdd.campaign.recipe", "Recipe.load"), elsewhere=("datasets/*.yaml",)),
    "sheet": Kind(_calls("fdd.data_sheet.answers", "read_answers"), elsewhere=("examples/*.datasheet.yaml",)),
    "answers": Kind(_answers),
    "lines": Kind(_lines),
}
DATA = [name for name, kind in KINDS.items() if kind.change is data_changed]
"""Kinds that Python reads: none can end the process."""


@dataclass(frozen=True)
class Task:
    """A case by its number, or a file."""

    kind: str
    seed: int = 0
    number: int = 0
    file: Path | None = None

    def content(self) -> tuple[str, bytes]:
        """Suffix and bytes: the same for the same kind, seed and number."""
        if self.file is not None:
            return _suffix(self.file), self.file.read_bytes()
        rng, kind = random.Random(f"{self.kind}/{self.seed}/{self.number}"), KINDS[self.kind]
        path = rng.choice(kind.seeds(self.kind))
        more = (path.suffix,) if kind.change is data_changed else ()
        return _suffix(path), kind.change(path.read_bytes(), rng, *more)


def _suffix(path: Path) -> str:
    return "".join(path.suffixes[-2:]) if path.suffix == ".gz" else path.suffix


def run(kind: str, path: Path) -> str:
    """Let fdd do all it does with a file: ``"read"`` or ``"refused"``; whatever else it raises is a find."""
    try:
        KINDS[kind].act(path)
    except InputError as error:
        _check(error)
        return "refused"
    return "read"


def result(task: Task, folder: Path) -> str:
    """What came of a case: ``"read"``, ``"refused"``, or the find in a line."""
    suffix, raw = task.content()
    path = folder / f"case{suffix}"
    path.write_bytes(raw)
    try:
        return run(task.kind, path)
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-3:]
        places = " > ".join(f"{Path(f.filename).name}:{f.lineno}" for f in last)
        return f"{type(error).__name__}: {' '.join(str(error).split())[:200]} [{places}]"


@dataclass
class Outcome:
    """What came of all tasks: counts by kind, and the finds with what happened."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    finds: list[tuple[Task, str]] = field(default_factory=list)


def fuzz(tasks: Iterable[Task]) -> Outcome:
    """Carry out tasks in another process; where it dies or hangs, that is a find, and the next goes on."""
    out, left = Outcome(), list(tasks)
    context = multiprocessing.get_context("spawn")
    while left:
        connection, inner = context.Pipe()
        process = context.Process(target=_serve, args=(inner, left), daemon=True)
        process.start()
        inner.close()
        try:
            assert connection.recv() == "ready"
            while left:
                what = connection.recv()
                _take(out, left.pop(0), what)
        except (EOFError, OSError):
            process.join(5)
            _take(out, left.pop(0), f"died, or not done in {MOST_SECONDS:g} s (status {process.exitcode})")
        process.kill()
        process.join()
    return out


def _take(out: Outcome, task: Task, what: str) -> None:
    found = what not in ("read", "refused")
    out.counts[task.kind, "find" if found else what] += 1
    out.finds += [(task, what)] * found


def _serve(connection: Any, tasks: list[Task]) -> None:
    """Work one task after the other, within bounds of memory and time that end the process."""
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        for kind in {task.kind for task in tasks}:  # loads libraries and compiled code
            result(Task(kind, file=KINDS[kind].seeds(kind)[0]), Path(folder))
        limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        connection.send("ready")
        for task in tasks:
            faulthandler.dump_traceback_later(MOST_SECONDS, exit=True)
            connection.send(result(task, Path(folder)))
            faulthandler.cancel_dump_traceback_later()
