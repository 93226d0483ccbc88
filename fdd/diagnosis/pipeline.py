"""The one pipeline: blocks of samples in, findings out, offline and live."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np

from fdd.diagnosis.answering import (
    Span,
    hidden_share,
    invisible,
    probabilities_of,
    probabilities_over,
    sensor_fault,
    versions_of,
)
from fdd.diagnosis.baseline import BASELINE_VERSION, effects_of
from fdd.diagnosis.decision import Found
from fdd.diagnosis.estimates import believed, estimates_of
from fdd.diagnosis.evidence import Amplitude, Evidence
from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Quality, SensorState, Trajectories
from fdd.diagnosis.fitting import Stretches
from fdd.diagnosis.hypotheses import hypotheses
from fdd.diagnosis.model import HELD_IN_DOUBT, Model
from fdd.diagnosis.sequential_detector import Evaluation, SequentialDetector
from fdd.errors import InputError
from fdd.residuals.added_tracker import AddedTracker
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.bins import FRAME_BINS, FRAME_S, BinMaker
from fdd.residuals.compiled import Array
from fdd.residuals.tracked import Tracked
from fdd.residuals.tracking import OBSERVABLE, estimates
from fdd.restorable import Restorable, packed, unpacked
from fdd.samples import Samples
from fdd.sensors import SensorWatch
from fdd.sensors.finding import FAILING
from fdd.unit import Unit

SCAN_FRAMES, VERDICT_FRAMES = 10, 16
"""Frames between two evaluations of the evidence (5 s), and the fewest that allow a verdict (8 s)."""
WINDOW_FRAMES = 300
"""Frames that onsets are looked for in; what is older has become the reference."""
STATE_VERSION = "28"
"""Of the state of all its parts: sensors, filters, bins, balances, detectors."""
SCANS_A_MINUTE, SCANS_KEPT = 12, 720
"""Evaluations in a minute, and how many a monitor remembers: an hour."""
EPOCHS = Stretches(frames=1, least=1.0)
"""Each epoch is one draw of the log-to-log variation, which is taken to be no less than usual."""
_FILTER_THREAD = ThreadPoolExecutor(1, "tracking")
"""The filters' compiled loops leave the interpreter to the balances meanwhile."""
WORTH_A_THREAD = 2000
"""Samples from which on handing a block over costs less than it saves."""


class Pipeline(Restorable):
    """Diagnose one axis from its samples.

    Parameters
    ----------
    unit : the axis's profile; best one that ``fdd identify`` made from its healthy logs.
    model : learnt layer; None takes the shipped one.
    axis, log : names for the answer.
    keep_trajectories : keep all records for a report; False bounds the memory of a monitor.
    without : faults of the catalogue that are not considered.
    trackers : names of installed packages' trackers that run beside ours.

    Raises
    ------
    InputError : no such tracker, or a fault of a package that cannot be used.

    Attributes
    ----------
    found, fitted, score : by the last `finish`, what the balances show, every fault that explains anything on
        its own, and the whole log's score.

    Examples
    --------
    >>> pipeline = Pipeline(Unit.load("axis_a"))
    >>> pipeline.push(Samples([0.0], {"position": [0.0]}))
    []
    """

    STATE = (
        "axis", "log", "_sensors", "_tracked", "_bins", "_history", "_first_time", "_last_time", "_count",
        "_acute", "_slow", "_epochs", "_hidden", "_told", "_scans",
    )  # fmt: skip

    def __init__(
        self, unit: Unit, model: Model | None = None, *, axis: str = "axis", log: str = "",
        keep_trajectories: bool = True, without: Collection[str] = (), trackers: Collection[str] = (),
    ) -> None:  # fmt: skip
        self.unit, self.model, self.axis, self.log = unit, model or Model.load(), axis, log
        self.threshold = self.model.tail.threshold(unit.monitoring.false_alarms_per_hour * 3600.0)
        self._effects = effects_of(unit, self.model.spreads)
        self._sensors = SensorWatch(unit)
        self._tracked = Tracked(unit, keep=keep_trajectories)
        self._added = [AddedTracker(name, unit) for name in dict.fromkeys(trackers)]
        self._bins = BinMaker(unit, SCAN_FRAMES)
        self._history = BalanceHistory(unit, self._effects)
        self._hypotheses = [h for h in hypotheses(unit, self._effects) if h.fault not in without]
        self._first_time = self._last_time = np.nan
        self._count = 0
        self._acute = SequentialDetector(self._hypotheses, self.threshold, self.model)
        self._slow = SequentialDetector(self._hypotheses, self.threshold, self.model, unknown=False)
        self._epochs = 0
        self._hidden = 1.0
        """Share of faults that could not be seen, as of the last minute."""
        self._told: set[tuple[str, str]] = set()
        """Channel and kind of the sensor faults that were told."""
        self._scans: list[tuple[float, float]] = []
        self.found: list[Found] = []
        self.fitted: list[Amplitude] = []
        self.score = 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that carry data; empty until enough samples came."""
        return self._tracked.channels

    @property
    def largest_score(self) -> float:
        """Largest score that held for `EVALUATIONS` evaluations of the evidence."""
        return max((s for _, s in self._scans), default=0.0)

    def push(self, samples: Samples) -> list[FaultFinding]:
        """Take the next block; findings whose alarm it raised (usually none).

        Raises
        ------
        InputError : time that does not go on from the last block, or channels that do not suffice.
        """
        if not len(samples):
            return []
        if samples.time[0] <= self._last_time:
            raise InputError(
                f"channel time: block starts at {samples.time[0]:.6f} s, after {self._last_time:.6f} s",
                mend="push blocks in time order, each sample once",
            )
        if np.isnan(self._first_time):
            self._first_time = float(samples.time[0])
        self._last_time = float(samples.time[-1])
        self._count += len(samples)
        trusted = self._sensors.push(samples)
        self._bins.jumps += self._sensors.take_jumps()
        if len(trusted) < WORTH_A_THREAD:
            self._tracked.push(trusted)
            return self._sensor_alarms() + self._weighed(trusted)
        tracked = _FILTER_THREAD.submit(self._tracked.push, trusted)
        try:
            return self._sensor_alarms() + self._weighed(trusted)
        finally:
            tracked.result()

    def _weighed(self, trusted: Samples) -> list[FaultFinding]:
        """The balances of a block; findings whose alarm it raised."""
        found: list[FaultFinding] = []
        for first, bins in self._bins.stretches(trusted):
            for added in self._added:
                added.push(first, bins)
            if len(bins) and self._history.stopped(first):
                self._history.begin_anew(self._acute.active.intervals(), SCAN_FRAMES)
            # The history takes whole frames, a scan's worth at a time, so that evaluations fall on the same
            # frames however a log was cut.
            while len(bins):
                due = SCAN_FRAMES - self._history.taken % SCAN_FRAMES
                part, bins = bins[: due * FRAME_BINS], bins[due * FRAME_BINS :]
                self._history.push(first, part)
                first += due
                if self._history.taken % SCAN_FRAMES == 0 and len(self._history.frames) >= VERDICT_FRAMES:
                    found += self._scan()
        return found

    def _sensor_alarms(self) -> list[FaultFinding]:
        fresh = [f for f in self._sensors.findings() if (f.channel, f.kind) not in self._told]
        self._told |= {(f.channel, f.kind) for f in fresh}
        return [sensor_fault(f) for f in fresh]

    @property
    def standing(self) -> list[FaultFinding]:
        """Active faults, and sensors that have not recovered."""
        failed = (f for f in self._sensors.findings() if f.kind in FAILING and f.until_s is None)
        acute = self._acute.active.findings()
        return [*acute, *self._slowly({f.family for f in acute}), *map(sensor_fault, failed)]

    def _slowly(self, seen: Collection[str]) -> list[FaultFinding]:
        """Active slow wear, of families that are not among `seen`."""
        return [f for f in self._slow.active.findings() if f.family not in seen]

    @property
    def looked_at(self) -> float:
        """s, end of the data at the last evaluation of the evidence (every five seconds); 0 before."""
        return self._acute.at

    def misfits(self) -> tuple[Array, list[str], Array]:
        """Ends of frames (s), balances' names and how badly each closed; see `BalanceHistory.misfits`."""
        return self._history.misfits()

    def estimates(self, method: Literal["ekf", "svsf"] = "ekf") -> dict[str, Estimate]:
        """Tracked quantities at the end of what was pushed, as one of the filters has them."""
        return estimates_of(self._tracked, self.unit, self.standing, method=method)

    def now(self) -> tuple[dict[str, float], dict[str, Estimate], dict[str, float]]:
        """By the last evaluation: each family's probability, estimates, and how badly balances close."""
        standing = sorted(self.standing, key=lambda f: -f.confidence)
        score = self._scans[-1][1] if self._scans else 0.0
        _, names, misfits = self._history.misfits()
        return (
            probabilities_of(standing, self.model, score, self._hidden),
            estimates_of(self._tracked, self.unit, standing),
            dict(zip(names, misfits[-1].tolist(), strict=True)) if len(misfits) else {},
        )

    def _evaluate(self, even: float | None = None) -> Evaluation:
        """What the evidence says now, older frames being the reference; see `SequentialDetector.evaluate`."""
        history = self._history
        start = history.fold(WINDOW_FRAMES, self._acute.active.intervals())
        frames, prior = history.marginalised(), history.held_against()
        evidence = Evidence(frames, prior, from_start=start == 0, duty=history.duty)
        starts = [h * FRAME_S for h in history.frames]
        return self._acute.evaluate(evidence, Span(starts, starts[-1] + FRAME_S), self._first_time, even=even)

    def _scan(self) -> list[FaultFinding]:
        evaluation = self._evaluate()
        if not self._tracked.keep:
            del self._scans[: -SCANS_KEPT + 1]
        number = self._history.taken // SCAN_FRAMES
        # The share that could not be seen changes fast at first, and slowly after a minute.
        if number in (1, 2, 4, 8) or number % SCANS_A_MINUTE == 1 or not self._scans:
            self._hidden = hidden_share(invisible(evaluation.evidence, self._hypotheses, self.threshold))
        self._scans.append((evaluation.now, evaluation.stands))
        fresh, over = self._acute.take(evaluation, self._history.frames[0] * FRAME_S)
        for span in over:
            self._history.forget(*span)
        if self._history.epochs.completed > self._epochs:
            fresh += self._wear()
        return fresh

    def _wear(self) -> list[FaultFinding]:
        """Evaluate the epochs after one was completed: slow wear, which the window's reference follows."""
        epochs = self._history.epochs
        self._epochs = epochs.completed
        starts = epochs.starts().tolist()
        effects = epochs.effects(self._effects)
        evidence = Evidence(epochs.marginalised(effects), effects, from_start=False, stretches=EPOCHS)
        span = Span(starts, self._acute.at, "flights or hours in motion", None)
        evaluation = self._slow.evaluate(evidence, span, self._first_time)
        seen = set(self._acute.active.now)
        fresh, over = self._slow.take(evaluation, starts[0])
        for gone in over:
            epochs.forget(*gone)
        return [f for f in fresh if f.family not in seen]

    def finish(self, quality: Quality | None = None) -> Diagnosis:
        """The answer on all samples pushed so far: what alarmed, and what is likelier than not. `quality` is
        what the reader noted about the data; reasons for the verdict are put first."""
        quality = (quality or Quality()).model_copy(deep=True)
        duration = float(self._last_time - self._first_time) if self._count else 0.0
        faults = [sensor_fault(f) for f in self._sensors.findings()]
        self.found, self.fitted, self.score, hydraulic, unseen = [], [], 0.0, list[FaultFinding](), []
        rest = self._bins.rest()
        self._history.push(*rest)
        for added in self._added:
            added.push(*rest)
        if len(self._history.frames) >= VERDICT_FRAMES:
            even = min(self.model.calibration.even, self.threshold)
            evaluation = self._evaluate(even)
            hydraulic, self.score = evaluation.findings, evaluation.stands
            self.found, self.fitted = evaluation.found, evaluation.evidence.alone
            unseen = invisible(evaluation.evidence, self._hypotheses, even)
        for f in hydraulic:
            first = self._acute.active.alarms.get(f.family)
            # An alarm before its onset was raised for something else; an onset may move by a scan.
            if first is not None and first.detected_s > f.onset_s - SCAN_FRAMES * FRAME_S:
                f.detected_s = max(first.detected_s, f.onset_s)
        # An alarm stays, though its onset has left the window.
        start = self._history.frames[0] * FRAME_S if self._history.frames else 0.0
        hydraulic += self._acute.active.past({f.family for f in hydraulic}, start)
        faults += [*hydraulic, *self._slowly({f.family for f in hydraulic})]
        faults.sort(key=lambda f: -f.confidence)
        probabilities = probabilities_of(faults, self.model, self.score, hidden_share(unseen))
        verdict: Literal["healthy", "faulty", "inconclusive"] = "faulty"
        if not faults:
            doubts = self._doubts(duration)
            if not doubts and probabilities["healthy"] < HELD_IN_DOUBT:
                doubts = [f"evidence for a fault (score {self.score:.1f} of {even:.1f}) is not enough"]
            verdict = "inconclusive" if doubts else "healthy"
            quality.notes = doubts + quality.notes
        elif faults[0].confidence < HELD_IN_DOUBT:
            verdict = "inconclusive"
            quality.notes.insert(0, "something deviates, but no kind of fault is more likely than not")
        if self._tracked.lost:
            quality.notes.append(
                "the estimators lost this log's motion: their values are not shown from there on"
            )
        quality.notes += [*self._sensors.notes(), *(a.problem for a in self._added if a.problem is not None)]
        if self.unit.baseline is None:
            quality.notes.append(
                f"profile {self.unit.name} was not identified from this unit's own healthy logs: "
                "only what changes within the log is told (make a profile with fdd identify)"
            )
        elif self.unit.baseline.version != BASELINE_VERSION:
            quality.notes.append(
                f"profile {self.unit.name}'s healthy balances are of another version of fdd: "
                "how they err is known less well (make it anew with fdd identify)"
            )
        return Diagnosis(
            log=self.log, axis=self.axis, unit=self.unit.name, duration_s=round(duration, 3),
            samples=self._count, verdict=verdict, faults=faults, probabilities=probabilities,
            estimates=estimates_of(self._tracked, self.unit, faults, self._added), quality=quality,
            sensors=[SensorState(**s) for s in self._sensors.states()], not_visible=unseen,
            prior=self.model.calibration.prior,
            versions=versions_of({a.name: a.package for a in self._added}) | {"model": self.model.schema_},
            sha256={"model": self.model.sha256},
        )  # fmt: skip

    def _doubts(self, duration: float) -> list[str]:
        """Reasons why the log does not allow the verdict "healthy"."""
        if len(self._history.frames) < VERDICT_FRAMES:
            return [f"{duration:.1f} s of data; a verdict needs {VERDICT_FRAMES * FRAME_S:.0f} s or more"]
        rows = sum(float(e.rows) for e in self._history.equations["volume"])
        if rows < VERDICT_FRAMES * FRAME_BINS * 0.25:
            return ["the log hardly moves or loads the actuator: its balances say nothing of its health"]
        return []

    def trajectories(self, answer: Diagnosis | None = None) -> Trajectories:
        """Everything over time, for the report and the annotated MCAP; `answer` is what `finish` gave after
        the last block, where it is at hand.

        Raises
        ------
        ValueError : the pipeline was told not to keep trajectories.
        """
        records = self._tracked.records()
        nothing = {name: np.empty(0) for name in OBSERVABLE}
        values, stds = dict.fromkeys(records, nothing), dict.fromkeys(records, nothing)
        for m, r in records.items():
            if r.size:
                values[m], stds[m] = estimates(r, self.unit, self._tracked.model)
        for added in self._added:
            values[added.name], stds[added.name] = added.over(records["ekf"]["time"])
        time, names, misfit = self.misfits()
        now, watched = answer or self.finish(), self._tracked.observed_throughout()
        # Nothing is known before it was looked at; the last look is the answer's own.
        at, scores = np.array([(0.0, 0.0), *self._scans, *((t, self.score) for t in time[-1:])]).T
        statistic = scores[np.searchsorted(at[1:], time, side="right")]
        seen, _ = believed(watched, records["ekf"], self.unit, self.channels, now.faults)
        hidden = hidden_share(now.not_visible)
        return Trajectories(
            time=records["ekf"]["time"], estimates=values, stds=stds,
            observable={n: seen[n].valid for n in OBSERVABLE},
            held={n: seen[n].held for n in OBSERVABLE}, held_std={n: seen[n].held_std for n in OBSERVABLE},
            information_std={n: seen[n].information_std for n in OBSERVABLE},
            nis={m: r["nis"] for m, r in records.items()}, window_time=time,
            feature_names=names, features=misfit, statistic=statistic, threshold=self.threshold,
            even=min(self.model.calibration.even, self.threshold),
            probabilities=probabilities_over(time, statistic, now, self.model, hidden),
        )  # fmt: skip

    def state(self) -> dict[str, Array]:
        """The whole state as flat named arrays; `np.savez` writes it, `restore` takes it back. Raises
        ValueError: trackers of packages run, whose state nobody knows."""
        if self._added:
            raise ValueError("a pipeline with trackers of packages has no state that could be saved")
        return super().state() | {"about": packed([STATE_VERSION, self.model.sha256, self.unit.name])}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from a state that `state` gave. Raises InputError: of another version, unit or model."""
        about = unpacked(state["about"]) if "about" in state else []
        if about[:2] != [STATE_VERSION, self.model.sha256]:
            raise InputError("saved state of another version or model", mend="start anew")
        if about[2:] != [self.unit.name]:
            problem = f"saved state of unit {about[-1]!r}, not {self.unit.name!r}"
            raise InputError(problem, mend="start anew")
        super().restore(state)
