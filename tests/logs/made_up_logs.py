"""Made-up logs, and how an error line must look."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fdd.errors import InputError
from fdd.logs import Log, read_log
from fdd.samples import Samples


def strokes(n: int = 6000, seed: int = 5) -> Samples:
    """A cylinder going to and fro at 1 kHz, with plausible magnitudes in every channel."""
    noise = np.random.default_rng(seed)
    time = np.arange(n) * 1e-3
    speed = 80.0 * np.sin(2.0 * np.pi * 0.5 * time)
    angle = np.cumsum(speed) * 1e-3
    pressure_1 = 6e5 + 2e5 * np.sin(2.0 * np.pi * 0.5 * time) + 3e3 * noise.standard_normal(n)
    pressure_2 = 6e5 - 2e5 * np.sin(2.0 * np.pi * 0.5 * time) + 3e3 * noise.standard_normal(n)
    return Samples(
        time,
        {
            "command": speed,
            "pump_angle": angle,
            "pump_speed": speed,
            "position": 3.6e-4 * angle,
            "pressure_difference": pressure_1 - pressure_2,
            "pressure_1": pressure_1,
            "pressure_2": pressure_2,
            "oil_temperature": np.full(n, 40.0),
        },
    )


def refused(act: Callable[[], object]) -> str:
    """The line of the InputError that `act` must raise."""
    with pytest.raises(InputError) as caught:
        act()
    line = str(caught.value)
    assert "\n" not in line and "Traceback" not in line and 10 < len(line) < 1500
    return line


def refused_log(path: Path, *args: object, **kwargs: object) -> str:
    """The line that refuses a log; it must begin with the file."""
    line = refused(lambda: read_log(path, *args, **kwargs))  # type: ignore[arg-type]
    assert line.startswith(f"{path}: "), line
    return line


def assert_same(log: Log, samples: Samples) -> None:
    """The log has the samples' channels, bit for bit (apart from the sign of zero)."""
    np.testing.assert_array_equal(log.samples.time, samples.time)
    for name in samples.channels:
        np.testing.assert_array_equal(log.samples.get(name), samples[name], err_msg=name)
