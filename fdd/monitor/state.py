"""A monitor's state on disk, so that it goes on after a restart where it was."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from fdd.bounds import MAX_STATE_BYTES
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.files import whole_file

CLOCK = "monitor/clock"
"""Last time given and the stream's clock offset, (2,) s."""


def save_state(path: Path, pipeline: Pipeline, *, last_time: float, offset: float) -> None:
    """Write the pipeline's state, whole or not at all.

    Parameters
    ----------
    last_time, offset : s; of the last sample, and what is added to the stream's stamps.

    Raises
    ------
    InputError : it cannot be written.
    """
    arrays = {**pipeline.state(), CLOCK: np.array([last_time, offset])}
    # Into an open file: to a name, savez would add .npz.
    with whole_file(path) as temporary, temporary.open("wb") as out:
        np.savez(out, **arrays)  # type: ignore[arg-type]


def load_state(path: Path, pipeline: Pipeline) -> tuple[float, float]:
    """Put a saved state into a new pipeline of the same unit and model.

    Returns
    -------
    last_time, offset : as they were saved.

    Raises
    ------
    InputError : damaged, too large, or of another version, unit or model.
    """
    mend = "remove the file to start anew"
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_STATE_BYTES:
            raise InputError(f"{size} bytes, at most {MAX_STATE_BYTES} are read", where=path, mend=mend)
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        last_time, offset = (float(v) for v in arrays[CLOCK])
        pipeline.restore(arrays)
        return last_time, offset
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise InputError(f"not a monitor's state ({type(error).__name__})", where=path, mend=mend) from None
