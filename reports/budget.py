"""Where faults are lost, and what healthy logs differ by: the loss budget of a data set with twins."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from fdd.campaign.dataset import Dataset, Entry
from fdd.campaign.scores import wilson
from fdd.campaign.spreads import healthy_logs
from fdd.campaign.units import How, over_units
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.departures import VAGUE, departures
from fdd.diagnosis.evidence import Evidence, time_profile_of
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.hypotheses import Hypothesis, hypotheses
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.diagnosis.random_effects import scattered
from fdd.markdown import table as markdown
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES

LEAST_SEVERITY = 0.3
TOLD = 0.3
"""Information of a coefficient in a log over that of its spread, from which its departure says something."""
LEAST_LOGS, FARTHEST = 30, 12
BEYOND = 3.0
CHANGES_EVERY, CHANGES_MARGIN, MOST_FRAMES = 24, 16, 320
"""Frames between the onsets at which changes are looked for, from the log's ends, and of a log."""


@dataclass(frozen=True)
class Said:
    """One log's answer. score : of the whole log. faults : answered, the surest first, with groups."""

    entry: Entry
    verdict: str
    score: float
    faults: tuple[tuple[str, tuple[str, ...]], ...]

    @property
    def named(self) -> bool:
        """Whether a true fault is in the first answer's group."""
        return bool(self.faults) and any(f.fault in self.faults[0][1] for f in self.entry.faults)


@dataclass(frozen=True)
class Departure:
    """A coefficient of a healthy log, or a change within one (coefficient empty), over what is stated."""

    balance: str
    coefficient: str
    z: float
    stated: float
    file: str


def budget(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[Said | Departure]:
    """Answers on all logs, and departures of all healthy logs and twins from their units' baselines."""
    return over_units(_unit, [directory], Model.load(model), **how)


def _unit(data: Dataset, name: str, model: Model) -> list[Said | Departure]:
    logs = healthy_logs(data, name, model.spreads)
    each = hypotheses(logs.unit, effects_of(logs.unit, model.spreads))
    out: list[Said | Departure] = []
    for entry in data.logs_of(name):
        pipeline = Pipeline(logs.unit, model, keep_trajectories=False)
        pipeline.push(data.samples(entry))
        found = pipeline.finish()
        faults = tuple((f.fault, tuple(f.ambiguity)) for f in found.faults)
        out.append(Said(entry, found.verdict, pipeline.score, faults))
    for file, history in logs.healthy:
        out += _departures(file, history) + _changes(file, history, each)
    return out


def _departures(file: str, history: BalanceHistory) -> list[Departure]:
    out = []
    effects = history.expected()
    for name, (m, v) in history.marginalised().items():
        e = effects[name]
        evidence = Evidence({name: (m, v)}, effects)
        own = [k for k, c in enumerate(BALANCES[name].columns) if c not in BALANCES[name].free]
        parts = _alone(name, np.eye(len(e.mean))[own][:, None], np.ones((len(own), 1, len(m))))
        scatter = np.full(len(own), scattered(m, v, e)[1])
        found = departures(evidence.balances, parts, scatter, from_start=True)
        stated = np.sqrt(np.diag(e.covariance))[own]
        z = found.size * np.sqrt(found.information)
        out += [
            Departure(name, BALANCES[name].columns[own[k]], float(z[k]), float(stated[k]), file)
            for k in np.flatnonzero(found.information * np.square(stated) > TOLD)
        ]
    return out


def _alone(balance: str, columns: NDArray[np.float64], time_profiles: NDArray[np.float64]) -> Parts:
    """Columns of one balance, each by itself, of any size and sign."""
    vague = np.full((len(columns), 1), VAGUE)
    return Parts({balance: columns}, time_profiles, vague, np.zeros(len(columns), np.bool_))


def _changes(file: str, history: BalanceHistory, each: Sequence[Hypothesis]) -> list[Departure]:
    """Amplitudes of each hypothesis of one balance, over onsets in a healthy log."""
    frames = min(len(history.frames), MOST_FRAMES)
    wide = {n: (m[:frames], v[:frames]) for n, (m, v) in history.marginalised().items()}
    evidence = Evidence(wide, history.expected())
    mine = [h for h in each if len(h.columns) == 1 and evidence.shared(h)]
    out = []
    for onset in range(CHANGES_MARGIN, frames - CHANGES_MARGIN, CHANGES_EVERY):
        time_profile = time_profile_of("step", frames, onset)[None, None]
        fits = evidence.fitted([(h, "step", onset, np.zeros(0)) for h in mine], [])
        for h, f in zip(mine, fits, strict=True):
            if f.size == 0.0:  # where a fault's sign is against it, its scores say nothing of the noise
                continue
            ((name, column),) = h.columns.items()
            parts = _alone(name, column[None, None], time_profile)
            found = departures(evidence.balances, parts, np.array([f.overdispersion]), from_start=False)
            std = 1.0 / float(np.sqrt(found.information[0]))
            out.append(Departure(name, "", float(found.size[0]) / std, std, file))
    return out


def table(found: Sequence[Said | Departure]) -> str:
    """The report (Markdown)."""
    said = [x for x in found if isinstance(x, Said)]
    return "\n".join([*_faults(said), *_healthy([x for x in found if isinstance(x, Departure)])]) + "\n"


def _faults(said: Sequence[Said]) -> list[str]:
    healthy = [s for s in said if not s.entry.faults]
    mine = [
        s for s in said
        if len(s.entry.faults) == 1 and s.entry.visible and s.entry.faults[0].severity >= LEAST_SEVERITY
    ]  # fmt: skip
    by: list[tuple[str, Callable[[Said], str]]] = [
        ("all", lambda s: ""),
        ("onset", lambda s: "from the first sample" if s.entry.faults[0].onset_s <= 0.0 else "inside"),
        ("course", lambda s: s.entry.faults[0].profile),
        ("fault", lambda s: s.entry.faults[0].fault.replace("_", " ")),
        ("load", lambda s: s.entry.scenario.load),
        ("structure", lambda s: s.entry.structure),
    ]
    rows = []
    for title, of in by:
        groups = defaultdict[str, list[Said]](list)
        for s in mine:
            groups[of(s)].append(s)
        for name, each in sorted(groups.items()):
            rows.append([
                title, name, wilson(sum(s.verdict == "faulty" for s in each), len(each)),
                wilson(sum(s.verdict == "faulty" and s.named for s in each), len(each)),
            ])  # fmt: skip
    alarmed = sum(s.verdict == "faulty" for s in healthy)
    highest = sorted(healthy, key=lambda s: -s.score)[:FARTHEST]
    largest = [f"{s.entry.file} {s.score:.1f}" for s in highest]
    return [
        f"Visible single faults of severity {LEAST_SEVERITY:g} and more; healthy logs called faulty: "
        f"{wilson(alarmed, len(healthy))}\n",
        *markdown(["by", "", "faulty", "named"], rows),
        f"Healthy logs with the largest scores: {', '.join(largest)}\n",
    ]


def _healthy(found: Sequence[Departure]) -> list[str]:
    groups = defaultdict[tuple[str, str], list[Departure]](list)
    for d in found:
        groups[d.balance, d.coefficient].append(d)
    rows = []
    for (balance, coefficient), each in groups.items():
        if len(each) < LEAST_LOGS:
            continue
        z: NDArray[np.float64] = np.array([d.z for d in each])
        far = max(each, key=lambda d: abs(d.z))
        rows.append([
            balance, coefficient or "changes within", str(len(each)), f"{1.4826 * np.median(np.abs(z)):.2f}",
            f"{np.sqrt(np.mean(z**2)):.2f}", wilson(int(np.sum(np.abs(z) > BEYOND)), len(each)),
            f"{np.median([d.stated for d in each]):.3g}", f"{far.file} {far.z:+.1f}",
        ])  # fmt: skip
    head = ["balance", "coefficient", "logs", "median", "rms", "beyond 3 std", "stated", "farthest"]
    return ["\nHealthy departures over what is stated\n", *markdown(head, rows)]
