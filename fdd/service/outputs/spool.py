"""What a recording has so far, on the disk: an Arrow stream that is readable however it ends."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from fdd.samples import CHANNELS, Samples

_NAMES = [name for name in CHANNELS if name != "time"]
_SCHEMA = pa.schema([(name, pa.float64()) for name in CHANNELS])


@dataclass(frozen=True)
class Piece:
    """Samples in little memory: of each column its first value and the float32 differences to it.

    A pump's angle grows for ever; as float32 it would be a step of the pump after a day.

    Examples
    --------
    >>> piece = Piece.of(Samples([0.0, 1.0], {"pump_angle": [1e9, 1e9 + 0.25]}))
    >>> float(piece.samples()["pump_angle"][1] - 1e9)
    0.25
    """

    time: NDArray[np.float64]
    first: dict[str, float]
    rest: NDArray[np.float32]

    @classmethod
    def of(cls, samples: Samples) -> Piece:
        """Pack some rows."""
        columns = samples.columns
        first = {name: float(v[np.isfinite(v)][:1].sum()) for name, v in columns.items()}
        rest = np.empty((len(columns), len(samples)), np.float32)
        for row, (name, values) in zip(rest, columns.items(), strict=True):
            with np.errstate(over="ignore"):
                row[:] = values - first[name]
        rest[np.isinf(rest)] = np.nan
        return cls(samples.time.copy(), first, rest)

    def samples(self) -> Samples:
        """Unpack them."""
        columns = zip(self.first.items(), self.rest, strict=True)
        return Samples(self.time, {name: first + row.astype(np.float64) for (name, first), row in columns})

    @property
    def nbytes(self) -> int:
        """Of memory, without what Python takes for the objects."""
        return self.time.nbytes + self.rest.nbytes


@dataclass
class Recorded:
    """What a spool holds: samples, and what happened beside them, each with its ``time``."""

    about: dict[str, str]
    samples: Samples
    alarms: list[dict[str, Any]] = field(default_factory=list)
    statuses: list[dict[str, Any]] = field(default_factory=list)


class Spool:
    """A spool to write: each call is in the file when it returns.

    Parameters
    ----------
    path : a new file. about : texts that stand at its head.

    Examples
    --------
    >>> spool = Spool(Path("a.spool"), {"axis": "A1"})
    >>> spool.add(Samples([0.0, 0.5], {"position": [0.1, 0.2]}))
    >>> spool.note("alarm", {"time": 0.5, "state": "UNACK"})
    >>> spool.close()
    >>> recorded = read_spool(Path("a.spool"))
    >>> len(recorded.samples), recorded.alarms[0]["state"]
    (2, 'UNACK')
    """

    def __init__(self, path: Path, about: Mapping[str, str]) -> None:
        self.path = path
        self._file = path.open("xb")
        try:
            self._stream = pa.ipc.new_stream(self._file, _SCHEMA.with_metadata(dict(about)))
        except BaseException:
            self._file.close()
            raise

    def add(self, samples: Samples) -> None:
        """Append some rows."""
        self._write([samples.time, *(samples.get(name) for name in _NAMES)], {})

    def note(self, kind: str, what: Mapping[str, Any]) -> None:
        """Append what happened, an ``alarm`` or a ``status``."""
        self._write([np.empty(0)] * len(_SCHEMA), {kind: json.dumps(dict(what))})

    def close(self) -> None:
        """Close the file, as it is; what a full disk did not take is lost."""
        with suppress(OSError):
            self._file.close()

    def _write(self, columns: list[NDArray[np.float64]], happened: dict[str, str]) -> None:
        batch = pa.record_batch(columns, schema=_SCHEMA)
        self._stream.write_batch(batch, custom_metadata=happened)
        self._file.flush()


def read_spool(path: Path) -> Recorded | None:
    """What a spool holds up to where it is cut off; None where that is nothing.

    Examples
    --------
    >>> _ = Path("empty.spool").write_bytes(b"")
    >>> read_spool(Path("empty.spool")) is None
    True
    """
    parts: list[Samples] = []
    happened: dict[str, list[dict[str, Any]]] = {"alarm": [], "status": []}
    try:
        with pa.OSFile(str(path)) as file, pa.ipc.open_stream(file) as stream:
            metadata = stream.schema.metadata or {}
            about = {key.decode(): value.decode() for key, value in metadata.items()}
            for batch, told in _batches(stream):
                if batch.num_rows:
                    parts.append(_samples(batch))
                for kind, text in (told or {}).items():
                    happened[kind.decode()].append(json.loads(text))
    except (pa.ArrowInvalid, OSError, ValueError, KeyError):
        pass  # cut off here: what came before is whole
    if not parts:
        return None
    return Recorded(about, Samples.concatenate(parts), happened["alarm"], happened["status"])


def _batches(stream: Any) -> Any:
    while True:
        try:
            yield stream.read_next_batch_with_custom_metadata()
        except StopIteration:
            return


def _samples(batch: Any) -> Samples:
    columns = {name: batch.column(name).to_numpy() for name in CHANNELS}
    time = columns.pop("time")
    return Samples(time, {name: v for name, v in columns.items() if not np.isnan(v).all()})
