"""Everything that ``python -m reports estimators`` measures, cut into jobs for a few processes."""

from __future__ import annotations

import time
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import product

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from fdd.campaign.units import for_each_unit
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import Channels, Tracking
from fdd.unit import Unit
from reports.estimators.cases import CASES, DURATION
from reports.estimators.model import assumed
from reports.estimators.peers import PEERS, run_peer
from reports.estimators.runs import CHANGE, WORLDS, evaluate, peer_run, prepare, step_run

PEER_CASES = ("steps, constant, all", "sines, spring, all", "sines, spring, minimum")
BY_NAME = {case.name: case for case in CASES}
SEEDED_AS = {"runs": "run", "steps": "step", "peers": "peer"}
"""What a run's seed is made of, so that a report can be made again."""
AT_ONCE = 10
"""Runs of a job."""


@dataclass(frozen=True)
class Plan:
    """How much is measured: runs of each case and change, runs of each case beside filterpy, s of a run,
    which cases, and which quantities are changed."""

    runs: int = 100
    peers: int = 3
    duration: float = DURATION
    cases: tuple[str, ...] = tuple(BY_NAME)
    stepped: tuple[str, ...] = tuple(CHANGE)
    seed: int = 0


Measured = dict[str, pd.DataFrame]
"""Frames of `reports.estimators.runs` by kind (errors, consistency, steps, peers), each with the columns
world, case (or the quantity that was changed) and run; and speed, see `measure_speed`. What was left out has
none."""


def measure(plan: Plan, workers: int = 1, progress: Callable[[float], None] = lambda share: None) -> Measured:
    """Measure everything but speed; the number of processes changes no figure."""
    of = {"peers": ([name for name in PEER_CASES if name in plan.cases], plan.peers, 1),
          "runs": (plan.cases, plan.runs, AT_ONCE), "steps": (plan.stepped, plan.runs, AT_ONCE)}  # fmt: skip
    jobs = [
        f"{kind}|{world}|{name}|{first}|{min(first + step, runs)}"
        for kind, (names, runs, step) in of.items()
        for world, name, first in product(WORLDS, names, range(0, runs, step))
    ]
    told = for_each_unit(
        partial(_work, plan), jobs, workers=workers, progress=lambda n, total: progress(n / total)
    )
    return {
        kind: pd.concat([frame for k, frame in told if k == kind], ignore_index=True)
        for kind in dict.fromkeys(k for k, _ in told)
    }


def _work(plan: Plan, job: str) -> list[tuple[str, pd.DataFrame]]:
    kind, world, name, first, last = job.split("|")
    found: list[tuple[str, pd.DataFrame]] = []
    with threadpool_limits(1), warnings.catch_warnings():
        # A filter that loses its covariance overflows; it is counted, and need not be told here too.
        warnings.simplefilter("ignore", RuntimeWarning)
        for run in range(int(first), int(last)):
            seed = (plan.seed, zlib.crc32(f"{SEEDED_AS[kind]}|{world}|{name}".encode()), run)
            if kind == "steps":
                frames = {"steps": step_run(world, name, seed)}
            elif kind == "peers":
                frames = {"peers": peer_run(world, BY_NAME[name], seed)}
            else:
                case = BY_NAME[name]
                pair = evaluate(case, prepare(world, case, seed, plan.duration))
                frames = dict(zip(("errors", "consistency"), pair, strict=True))
            found += [(k, frame.assign(world=world, case=name, run=run)) for k, frame in frames.items()]
    return found


def measure_speed(
    duration: float = 60.0, repeats: int = 9, peer_samples: int = 3000, seed: int = 1
) -> pd.DataFrame:
    """µs of processor time a sample (median, best) of both filters and of filterpy's EKF, by name.

    On one simulated log of `duration` s with a spring load, one core, in turns: whatever else runs hits all.
    """
    unit, recording = Unit.load("axis_a"), Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
    samples = simulate(
        unit, Scenario(duration=duration, seed=seed, load={"name": "spring"}, recording=recording)
    ).samples
    tracking = Tracking(unit, Channels.of(samples), 1e-3)
    block, prior, took = tracking.block(samples), assumed(tracking.trackers["ekf"]), dict[str, list[float]]()
    for turn in range(repeats):
        for method, tracker in tracking.trackers.items():
            fresh = tracker.state()
            tracker.push(block[:1000])  # compiling is not its work
            tracker.restore(fresh)
            began = time.process_time()
            tracker.push(block)
            took.setdefault(method.upper(), []).append((time.process_time() - began) / len(block))
            tracker.restore(fresh)
        if turn % 3 == 0 and find_spec("filterpy") is not None:
            part, last = block[:peer_samples], np.array([peer_samples - 1])
            began = time.process_time()
            run_peer(PEERS[0], tracking.model, prior, part, False, last)
            took.setdefault(PEERS[0], []).append((time.process_time() - began) / peer_samples)
    rows = {name: {"median": 1e6 * np.median(s), "best": 1e6 * min(s)} for name, s in took.items()}
    return pd.DataFrame.from_dict(rows, orient="index").assign(samples=len(block))
