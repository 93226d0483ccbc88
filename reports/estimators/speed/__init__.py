"""How fast the EHA tracker is, beside filterpy and plain C++ on the same log, in one go."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from estimators.eha.tracker import EhaTracker, Method
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import Channels, Tracking
from fdd.unit import Unit
from reports.estimators.speed.cpp import Program, Unavailable, version
from reports.estimators.speed.peers import run_filterpy

Array = NDArray[np.float64]

MOST_MICROSECONDS, LEAST_PEER, MOST_CPP = 2.0, 25.0, 2.0
"""Goals: µs of a sample for EKF and SVSF; times slower that filterpy is; times the plain C++ loop."""
WARM_UP = 1000
"""Samples before the measured ones: the start, and compiling."""


@dataclass(frozen=True)
class Speed:
    """One line of the table: processor time a sample, median and best of the repeats (NaN where it could not
    run), and the median over that of the tracker's EKF."""

    name: str
    microseconds: float
    best: float
    ratio: float
    note: str


@dataclass(frozen=True)
class SpeedTable:
    """All of them, from one process and one go.

    Attributes
    ----------
    rows : lines of the table, the tracker's EKF first.
    samples : of the log that all but filterpy ran over.
    compiler : of the C++ peer, with its flags, or why there is none.
    """

    rows: tuple[Speed, ...]
    samples: int
    compiler: str

    def verdicts(self) -> Iterator[tuple[str, float, str, bool]]:
        """The goals on speed: name, figure, its unit, and whether it is met."""
        took = {row.name: row.microseconds for row in self.rows}
        for name in ("EKF", "SVSF"):
            yield (
                f"{name} within {MOST_MICROSECONDS:g} µs a sample",
                took[name],
                "µs",
                took[name] <= MOST_MICROSECONDS,
            )
            ratio = took[name] / took[f"C++ {name}"]
            if np.isfinite(ratio):
                yield f"{name} within {MOST_CPP:g} times C++", ratio, "times", ratio <= MOST_CPP
        ratio = took["filterpy EKF"] / took["EKF"]
        if np.isfinite(ratio):
            yield f"{LEAST_PEER:g} times filterpy's speed", ratio, "times", ratio >= LEAST_PEER


def log(duration: float = 60.0, seed: int = 1) -> tuple[dict[str, EhaTracker], Array]:
    """Trackers by method, not yet fed, and the block of a simulated log: sensors, a spring load, no gaps."""
    unit = Unit.load("axis_a")
    recording = Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
    scenario = Scenario(duration=duration, seed=seed, load={"name": "spring"}, recording=recording)
    samples = simulate(unit, scenario).samples
    tracking = Tracking(unit, Channels.of(samples), 1e-3)
    return tracking.trackers, tracking.block(samples)


def measure(
    duration: float = 60.0, *, repeats: int = 9, peer_samples: int = 3000, seed: int = 1
) -> SpeedTable:
    """Time the tracker, filterpy and C++ on one log and one core, in turns: whatever else runs hits all.

    filterpy runs a third as often, on `peer_samples`; `duration` (s) and `seed` are of the simulated log.
    """
    trackers, block = log(duration, seed)
    try:
        program: Program | None = Program()
        compiler = version()
    except Unavailable as missing:
        program, compiler = None, str(missing)
    methods: tuple[Method, ...] = ("ekf", "svsf")
    found: dict[str, list[float]] = {}
    own_note = f"estimators.EhaTracker, all of the loop, {len(trackers['ekf'].x)} states"
    notes = dict.fromkeys((m.upper() for m in methods), own_note)
    for method in methods:
        notes[_cpp_name(method, False)] = compiler if program is None else "Eigen, its structure by hand"
        notes[_cpp_name(method, True)] = compiler if program is None else "Eigen, products of whole matrices"
    filterpy = find_spec("filterpy") is not None
    absent = "filterpy is not installed"
    whole = f"predict and update, with the compiled model step; {peer_samples} samples"
    notes["filterpy EKF"] = whole if filterpy else absent
    notes["filterpy EKF alone"] = "its predict and update without the model" if filterpy else absent
    started = trackers["ekf"]
    fresh = started.state()
    for i in range(repeats):
        for method in methods:
            tracker = trackers[method]
            start = tracker.state()
            tracker.push(block[:WARM_UP])
            tracker.restore(start)
            found.setdefault(method.upper(), []).append(_cpu(tracker.push, block) / len(block))
            tracker.restore(start)
            if program is not None:
                for dense in (False, True):
                    seconds = program.run(tracker, block, dense=dense).seconds
                    found.setdefault(_cpp_name(method, dense), []).append(float(seconds[0]))
        if i % 3 == 0 and filterpy:
            started.push(block[:WARM_UP])
            peer = run_filterpy(started, block[WARM_UP : WARM_UP + peer_samples])
            started.restore(fresh)
            found.setdefault("filterpy EKF", []).append(peer.whole)
            found.setdefault("filterpy EKF alone", []).append(peer.filterpy)
    own = float(np.median(found["EKF"]))
    rows = []
    for name, note in notes.items():
        seconds = np.array(found.get(name, [np.nan]))
        median, best = float(np.median(seconds)), float(seconds.min())
        rows.append(Speed(name, median * 1e6, best * 1e6, median / own, note))
    return SpeedTable(tuple(rows), len(block), compiler)


def _cpp_name(method: str, dense: bool) -> str:
    return f"C++ {method.upper()}, dense" if dense else f"C++ {method.upper()}"


def _cpu(run: Callable[[Array], object], block: Array) -> float:
    """s of processor time."""
    start = time.process_time()
    run(block)
    return time.process_time() - start
