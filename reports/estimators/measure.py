"""Everything that ``python -m reports estimators`` measures, cut into jobs for a few processes."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fdd.campaign.units import for_each_unit
from fdd.residuals.tracking import METHODS, estimates
from reports.estimators.cases import CASES, DURATION, QUANTITIES, Case, quantities
from reports.estimators.peers import PEERS, run_peer
from reports.estimators.runs import (
    CHANGE,
    HOUR,
    WORLDS,
    Outcome,
    StepOutcome,
    StillOutcome,
    evaluate,
    prepare,
    step_run,
    still_run,
    true_and_bound,
)
from reports.estimators.speed import SpeedTable

Array = NDArray[np.float64]

PEER_CASES = ("steps, constant, all", "sines, spring, all", "sines, spring, minimum")
PEER_DURATION = 8.0
"""s; they are slow."""
STILL_CASES = tuple(
    Case("standstill", load, minimum=minimum) for minimum in (False, True) for load in ("none", "constant")
)
BY_NAME = {case.name: case for case in (*STILL_CASES, *CASES)}


@dataclass(frozen=True)
class Plan:
    """How much is measured.

    Attributes
    ----------
    runs : of each case, and of each change of a parameter.
    still, peers : runs of an hour at standstill in all, and runs of each case with filterpy.
    duration, still_duration : s.
    cases : which. stepped : quantities that are changed.
    seed : fixes everything random.
    """

    runs: int = 100
    still: int = 10
    peers: int = 3
    duration: float = DURATION
    still_duration: float = HOUR
    cases: tuple[str, ...] = tuple(case.name for case in CASES)
    stepped: tuple[str, ...] = tuple(CHANGE)
    seed: int = 0


@dataclass(frozen=True)
class PeerOutcome:
    """filterpy beside the estimators on one short run.

    Attributes
    ----------
    errors : (2 + methods, quantities, checks) of `PEERS`, then of `METHODS`; NaN where one was lost.
    bound, truth : (quantities, checks).
    """

    errors: Array
    bound: Array
    truth: Array


@dataclass
class Measured:
    """What was found, in the order of the jobs; keys are world and case, or world and quantity."""

    plan: Plan
    runs: dict[tuple[str, str], list[Outcome]] = field(default_factory=dict)
    steps: dict[tuple[str, str], list[StepOutcome]] = field(default_factory=dict)
    still: dict[tuple[str, str], list[StillOutcome]] = field(default_factory=dict)
    peers: dict[tuple[str, str], list[PeerOutcome]] = field(default_factory=dict)
    speed: SpeedTable | None = None


def measure(plan: Plan, workers: int = 1, progress: Callable[[float], None] = lambda share: None) -> Measured:
    """Measure everything but speed; the number of processes changes no figure."""
    jobs = [f"still|plant|{STILL_CASES[i % 4].name}|{i}|{i + 1}" for i in range(plan.still)]  # the longest
    peer_cases = [name for name in PEER_CASES if name in plan.cases]
    jobs += [
        f"peers|{w}|{name}|{i}|{i + 1}" for w in WORLDS for name in peer_cases for i in range(plan.peers)
    ]
    parts = [(i, min(i + 10, plan.runs)) for i in range(0, plan.runs, 10)]
    for kind, names in (("runs", plan.cases), ("steps", plan.stepped)):
        jobs += [f"{kind}|{w}|{name}|{a}|{b}" for w in WORLDS for name in names for a, b in parts]
    found, work = Measured(plan), partial(_work, plan)
    told = for_each_unit(work, jobs, workers=workers, progress=lambda n, total: progress(n / total))
    for kind, world, name, result in told:
        getattr(found, kind).setdefault((world, name), []).append(result)
    return found


SEEDED_AS = {"runs": "run", "steps": "step", "peers": "peer", "still": "still"}
"""What a run's seed is made of, so that a report can be made again."""


def _work(plan: Plan, job: str) -> list[tuple[str, str, str, Any]]:
    kind, world, name, first, last = job.split("|")
    results: list[tuple[str, str, str, Any]] = []
    with threadpool_limits(1), warnings.catch_warnings():
        # A filter that loses its covariance overflows; it is counted, and need not be told here too.
        warnings.simplefilter("ignore", RuntimeWarning)
        for i in range(int(first), int(last)):
            seed = (plan.seed, zlib.crc32(f"{SEEDED_AS[kind]}|{world}|{name}".encode()), i)
            result: Any
            if kind == "steps":
                result = step_run(world, name, seed)
            elif kind == "still":
                result = still_run(BY_NAME[name], seed, plan.still_duration)
            elif kind == "peers":
                result = _beside_filterpy(world, BY_NAME[name], seed)
            else:
                result = evaluate(BY_NAME[name], prepare(world, BY_NAME[name], seed, plan.duration))
            results.append((kind, world, name, result))
    return results


def _beside_filterpy(world: str, case: Case, seed: tuple[int, ...]) -> PeerOutcome:
    data = prepare(world, case, seed, PEER_DURATION)
    decimation = data.tracking.trackers["ekf"].decimation
    n = round(PEER_DURATION * 1e3)
    ends = np.linspace(n // 2, n, 5).round().astype(np.int64) // decimation * decimation
    model, viscosity = data.tracking.model, data.truth.viscosity[ends - 1]
    errors = np.empty((len(PEERS) + len(METHODS), len(QUANTITIES), ends.size))
    truth, bound = true_and_bound(case, data, ends - 1)
    for i, name in enumerate(PEERS):
        states, variances = run_peer(name, model, data.prior, data.block, case.minimum, ends - 1)
        seen = np.ones(ends.size) if case.minimum else viscosity
        errors[i] = quantities(states, variances, seen, data.unit, model)[0] - truth
    for i, records in enumerate(data.tracking.push(data.block).values(), start=len(PEERS)):
        values, _ = estimates(records, data.unit, model)
        errors[i] = np.array([values[q][ends // decimation - 1] for q in QUANTITIES]) - truth
    return PeerOutcome(errors, bound, truth)
