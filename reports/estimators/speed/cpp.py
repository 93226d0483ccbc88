"""The tracker in plain C++ with Eigen, compiled and run where there is a compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators import kernels
from estimators.eha import bounds, forces, gate, layout, loop, model, noise, redundancy, walk
from estimators.eha.tracker import EhaTracker

Array = NDArray[np.float64]

SOURCES = ("tracker.cpp", "filter.hpp", "model.hpp")
FLAGS = ("-std=c++17", "-O3", "-march=native", "-DNDEBUG")
_COMPILERS = ("g++", "clang++", "c++")
_INCLUDES = ("/usr/include/eigen3", "/usr/local/include/eigen3", "/opt/homebrew/include/eigen3")
# What the sources take from the Python modules, so that a state added there moves no number here unnoticed.
_NAMES = {
    model: [name for name in vars(model) if name.isupper()],
    layout: [name for name in vars(layout) if name.isupper()],
    bounds: ["LOWEST", "HIGHEST"],
    forces: ["FORCE_PERIOD", "FRICTION_LAG", "FRICTION_SETTLES", "PARTNER_MISFIT", "ROBUST"],
    gate: ["FAST", "SLOW", "REST"],
    loop: ["LONGEST_GAP"],
    redundancy: ["PAIRS"],
    walk: ["JUMP_SIGMAS", "SCORE_WINDOW", "LONG_WINDOWS", "MOST_STREAK", "SHORT"],
    kernels: ["TIE_BREAK"],
}


class Unavailable(RuntimeError):
    """This machine cannot compile the peer; the text says why."""


@dataclass(frozen=True)
class Run:
    """What the C++ program made of a block.

    Attributes
    ----------
    seconds : (1,) processor time per sample.
    x, variances : (STATES,) final state and its variances, model units.
    log_likelihood : sum over the samples.
    """

    seconds: Array
    x: Array
    variances: Array
    log_likelihood: float


def header() -> str:
    """C++ constants: figures of the Python modules, and the indices of states, parameters and noise."""
    lines = ["#pragma once", "#include <cmath>"]
    for total, prefix, record in (("PARAMETERS", "Q", model.PARAMETERS), ("NOISE", "N", noise.NOISE)):
        names = [f"{prefix}_{name.upper()}" for name in record.names or ()] + [total]
        lines += [f"constexpr int {name} = {index};" for index, name in enumerate(names)]
    for module, names in _NAMES.items():
        for name in names:
            value = getattr(module, name)
            if isinstance(value, int | float):
                lines.append(
                    f"constexpr {type(value).__name__.replace('float', 'double')} {name} = {value!r};"
                )
            elif isinstance(value, np.ndarray):
                numbers = ", ".join(repr(float(v)).replace("inf", "HUGE_VAL") for v in value)
                lines.append(f"constexpr double {name}[] = {{{numbers}}};")
    return "\n".join(lines) + "\n"


def flat(record: object) -> Array:
    """A record's numbers in the order of its fields."""
    return np.array([record]).view(np.float64)


def toolchain() -> tuple[str, str]:
    """Compiler, and the folder of Eigen's headers; `CXX` and `EIGEN_INCLUDE` name others than the usual.

    Raises
    ------
    Unavailable : one of them is not there.
    """
    compiler = next(filter(None, map(shutil.which, filter(None, (os.environ.get("CXX"), *_COMPILERS)))), None)
    if compiler is None:
        raise Unavailable("no C++ compiler on this machine")
    for folder in filter(None, (os.environ.get("EIGEN_INCLUDE"), *_INCLUDES)):
        if (Path(folder) / "Eigen" / "Dense").is_file():
            return compiler, folder
    raise Unavailable("no Eigen headers on this machine (set EIGEN_INCLUDE to their folder)")


def version() -> str:
    """Compiler and flags, one line."""
    found = subprocess.run([toolchain()[0], "--version"], capture_output=True, text=True, check=False)
    return f"{found.stdout.splitlines()[0] if found.stdout else 'unknown compiler'}, {' '.join(FLAGS)}"


class Program:
    """The compiled program, in a temporary folder that goes with it.

    Raises
    ------
    Unavailable : no compiler, no Eigen, or the compiler fails; its first error is in the text.
    """

    def __init__(self, flags: tuple[str, ...] = FLAGS) -> None:
        compiler, eigen = toolchain()
        self._folder = tempfile.TemporaryDirectory()
        self._path = Path(self._folder.name)
        for name in SOURCES:
            text = resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
            (self._path / name).write_text(text, encoding="utf-8")
        (self._path / "indices.h").write_text(header(), encoding="utf-8")
        command = [compiler, *flags, "-isystem", eigen, "tracker.cpp", "-o", "tracker"]
        done = subprocess.run(command, cwd=self._path, capture_output=True, text=True, check=False)
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if "error" in line]
            raise Unavailable(f"the C++ peer does not compile: {(errors or ['no message'])[0]}")

    def run(self, tracker: EhaTracker, block: Array, *, dense: bool = False) -> Run:
        """Track a block (n, COLUMNS) from a tracker's settings and present estimate; it stays as it is.

        `dense` takes products of whole matrices instead of the tracker's own structure.
        """
        settings = [
            len(block), 1, dense, tracker.period, tracker.method == "svsf", tracker.pressures,
            tracker.angle, tracker.gamma, tracker.layer,
        ]  # fmt: skip
        parts = [
            settings,
            flat(tracker.model),
            flat(tracker.noise_numbers),
            tracker.x,
            np.diag(tracker.P),
            np.ascontiguousarray(block).ravel(),
        ]
        np.concatenate([np.asarray(p, dtype=np.float64) for p in parts]).tofile(self._path / "input")
        done = subprocess.run(
            [self._path / "tracker", "input", "output"],
            cwd=self._path,
            capture_output=True,
            text=True,
            check=True,
        )
        result = np.fromfile(self._path / "output")
        n = model.STATES
        return Run(
            seconds=np.array(done.stdout.split(), dtype=np.float64),
            x=result[:n], variances=result[n : 2 * n], log_likelihood=float(result[2 * n]),
        )  # fmt: skip
