"""Everything that ``python -m evidence estimators`` measures, cut into jobs for a few processes."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from evidence.estimators.cases import CASES, DURATION, Case, case_named
from evidence.estimators.peers import PEERS, run_peer
from evidence.estimators.run import WORLDS, Outcome, evaluate, prepare, true_and_bound
from evidence.estimators.speed import SpeedTable
from evidence.estimators.standstill import HOUR, StillOutcome, still_run
from evidence.estimators.steps import STEPPED, StepOutcome, step_run
from evidence.estimators.trajectory import QUANTITIES, quantities
from fdd.campaign.units import for_each_unit
from fdd.residuals.tracking import METHODS, estimates

Array = NDArray[np.float64]
Progress = Callable[[float], None]

PEER_CASES = ("steps, constant, all", "sines, spring, all", "sines, spring, minimum")
PEER_DURATION = 8.0
"""s; they are slow."""
STILL_CASES = (
    Case("standstill", "none"), Case("standstill", "constant"), Case("standstill", "none", minimum=True),
    Case("standstill", "constant", minimum=True),
)  # fmt: skip


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
    stepped: tuple[str, ...] = STEPPED
    seed: int = 0


@dataclass(frozen=True)
class PeerOutcome:
    """filterpy beside the estimators on one short run.

    Attributes
    ----------
    errors : (2 + methods, quantities, checks) of `PEERS`, then of `METHODS`; NaN where one was lost.
    bound : see `Outcome`.
    truth : (quantities, checks).
    """

    errors: Array
    bound: Array
    truth: Array


@dataclass
class Measured:
    """What was found; keys are world and case, or world and quantity.

    Attributes
    ----------
    plan : how much was measured.
    runs, steps, still, peers : outcomes of the jobs, in their order.
    speed : of `evidence.estimators.speed_section.measure_speed`, where it was measured.
    """

    plan: Plan
    runs: dict[tuple[str, str], list[Outcome]] = field(default_factory=dict)
    steps: dict[tuple[str, str], list[StepOutcome]] = field(default_factory=dict)
    still: list[StillOutcome] = field(default_factory=list)
    peers: dict[tuple[str, str], list[PeerOutcome]] = field(default_factory=dict)
    speed: SpeedTable | None = None


def measure(plan: Plan, workers: int = 1, progress: Progress = lambda share: None) -> Measured:
    """Measure everything.

    Parameters
    ----------
    plan : how much.
    workers : processes; changes no figure.
    progress : is told the share that is done.
    """
    jobs = _jobs(plan)
    work = partial(_work, plan)
    done = for_each_unit(work, jobs, workers=workers, progress=lambda n, total: progress(n / total))
    found = Measured(plan)
    for kind, world, name, result in done:
        if kind == "run":
            found.runs.setdefault((world, name), []).append(result)  # type: ignore[arg-type]
        elif kind == "step":
            found.steps.setdefault((world, name), []).append(result)  # type: ignore[arg-type]
        elif kind == "peer":
            found.peers.setdefault((world, name), []).append(result)  # type: ignore[arg-type]
        else:
            found.still.append(result)  # type: ignore[arg-type]
    return found


def _jobs(plan: Plan) -> list[str]:
    """Names of all jobs, ``kind|world|name|first|last``, the longest first."""
    jobs = [f"still|plant|{STILL_CASES[i % 4].name}|{i}|{i + 1}" for i in range(plan.still)]
    peer_cases = [name for name in PEER_CASES if name in plan.cases]
    jobs += [f"peer|{w}|{name}|{i}|{i + 1}" for w in WORLDS for name in peer_cases for i in range(plan.peers)]
    parts = [(i, min(i + 10, plan.runs)) for i in range(0, plan.runs, 10)]
    jobs += [f"run|{w}|{name}|{a}|{b}" for w in WORLDS for name in plan.cases for a, b in parts]
    jobs += [f"step|{w}|{name}|{a}|{b}" for w in WORLDS for name in plan.stepped for a, b in parts]
    return jobs


def _work(plan: Plan, job: str) -> list[tuple[str, str, str, object]]:
    kind, world, name, first, last = job.split("|")
    results: list[tuple[str, str, str, object]] = []
    with threadpool_limits(1), warnings.catch_warnings():
        # A filter that loses its covariance overflows; it is counted, and need not be told here too.
        warnings.simplefilter("ignore", RuntimeWarning)
        for i in range(int(first), int(last)):
            seed = (plan.seed, zlib.crc32(f"{kind}|{world}|{name}".encode()), i)
            result: object
            if kind == "run":
                case = case_named(name)
                result = evaluate(case, prepare(world, case, seed, plan.duration))
            elif kind == "step":
                result = step_run(world, name, seed)
            elif kind == "peer":
                result = _beside_filterpy(world, case_named(name), seed)
            else:
                case = {case.name: case for case in STILL_CASES}[name]
                result = still_run(case, seed, plan.still_duration)
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
