"""The one pipeline: blocks of samples in, findings out, offline and live."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Estimate, FaultFinding, Quality, Trajectories
from fdd.diagnosis.model import Model
from fdd.diagnosis.sequential import PageTest
from fdd.diagnosis.verdict import family_probabilities, finding
from fdd.errors import InputError
from fdd.residuals.features import FEATURES, HOP, WINDOW
from fdd.residuals.tracking import OBSERVABLE, estimates, healthy_coulomb, healthy_viscous
from fdd.residuals.windows import WARM_UP_S, ResidualWindows, baseline_spread, packed, unpacked
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

RECENT = 8
"""Windows that the probabilities without an alarm are taken from."""
HISTORY = 7200
"""Windows that a pipeline without trajectories remembers: an hour of them."""
LEAST_SURE = 0.5
"""Confidence of the leading family below which an alarm does not make a verdict."""
STATE_VERSION = "2"


class Pipeline:
    """Diagnose one axis from its samples.

    Parameters
    ----------
    unit : the axis's profile; best one that ``fdd identify`` made from its healthy logs.
    model : classifier; None takes the shipped one.
    axis, log : names for the answer.
    keep_trajectories : keep all records for a report; False bounds the memory of a monitor.

    Examples
    --------
    >>> pipeline = Pipeline(Unit.load("axis_a"))
    >>> pipeline.push(Samples([0.0], {"position": [0.0]}))
    []
    """

    def __init__(
        self,
        unit: Unit,
        model: Model | None = None,
        *,
        axis: str = "axis",
        log: str = "",
        keep_trajectories: bool = True,
    ) -> None:
        self.unit = unit
        self.model = model or Model.load()
        self.axis = axis
        self.log = log
        self._windows = ResidualWindows(unit, keep=keep_trajectories)
        self._spread = baseline_spread(unit)
        self._time = np.empty(0)
        self._features = np.empty((0, len(FEATURES)))
        self._probabilities = np.empty((0, len(self.model.classes)))
        self._statistic = np.empty(0)
        self._test = PageTest(self.model.tail.threshold(unit.monitoring.false_alarms_per_hour), HOP)

    def __repr__(self) -> str:
        return f"Pipeline(unit={self.unit.name!r}, axis={self.axis!r}, samples={self._windows.count})"

    @property
    def threshold(self) -> float:
        """Alarm level of the sequential test."""
        return self._test.threshold

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that carry data; empty until enough samples came."""
        return self._windows.channels

    def push(self, samples: Samples) -> list[FaultFinding]:
        """Take the next block; findings whose alarm it raised (usually none).

        Raises
        ------
        InputError : time that does not go on from the last block, or channels that do not
            suffice for a diagnosis.
        """
        ends, features = self._windows.push(samples)
        if not ends.size:
            return []
        probabilities = self.model.probabilities(features, self._spread)
        ratios = self.model.log_ratios(probabilities)
        found = []
        for k, end in enumerate(ends):
            alarm = self._test.step(ratios[k], float(end))
            self._time = np.append(self._time, end)
            self._features = np.concatenate([self._features, features[k : k + 1]])
            self._probabilities = np.concatenate([self._probabilities, probabilities[k : k + 1]])
            self._statistic = np.append(self._statistic, self._test.statistic)
            if alarm:
                found.append(self._finding(refine=False)[0])
        if not self._windows.keep and self._time.size > HISTORY:
            self._time, self._statistic = self._time[-HISTORY:], self._statistic[-HISTORY:]
            self._features, self._probabilities = self._features[-HISTORY:], self._probabilities[-HISTORY:]
        return found

    def _finding(self, *, refine: bool) -> tuple[FaultFinding, dict[str, float]]:
        return finding(
            self.model, self.unit, self.channels, self._time, self._features, self._probabilities,
            self._test, self._windows.first_time, self._spread, refine=refine,
        )  # fmt: skip

    def finish(self, quality: Quality | None = None) -> Diagnosis:
        """The answer on all samples pushed so far (more may follow).

        Parameters
        ----------
        quality : what the reader noted about the data; reasons for the verdict are put first.
        """
        quality = (quality or Quality()).model_copy(deep=True)
        windows = self._windows
        duration = float(windows.last_time - windows.first_time) if windows.count else 0.0
        found: list[FaultFinding] = []
        verdict: Literal["healthy", "faulty", "inconclusive"] = "faulty"
        if self._test.alarmed:
            fault, probabilities = self._finding(refine=True)
            found.append(fault)
            if fault.confidence < LEAST_SURE:
                verdict = "inconclusive"
                quality.notes.insert(0, "something deviates, but no kind of fault is more likely than not")
        else:
            probabilities = family_probabilities(self.model, self._probabilities[-RECENT:], self._test)
            doubts = self._doubts(duration)
            verdict = "inconclusive" if doubts else "healthy"
            quality.notes = doubts + quality.notes
        if self.unit.baseline is None:
            quality.notes.append(
                f"profile {self.unit.name} was not identified from this unit's own healthy logs: "
                "deviations of the unit count as faults (make a profile with fdd identify)"
            )
        return Diagnosis(
            log=self.log, axis=self.axis, unit=self.unit.name, duration_s=round(duration, 3),
            samples=windows.count, verdict=verdict, faults=found,
            probabilities={k: round(v, 4) for k, v in probabilities.items()},
            estimates=self._estimates(), quality=quality,
        )  # fmt: skip

    def _doubts(self, duration: float) -> list[str]:
        """Why "healthy" would say too much."""
        if not self._time.size:
            return [f"{duration:.1f} s of data; a verdict needs {WARM_UP_S + WINDOW:.0f} s or more"]
        if self._test.statistic > 0.5 * self._test.threshold:
            return [
                f"evidence for a fault is growing (test statistic {self._test.statistic:.1f} of "
                f"{self._test.threshold:.1f}) but is not enough for an alarm"
            ]
        values, stds = estimates(self._windows.last_records["ekf"], self.unit, self._windows.model)
        names = ("leakage", "bulk_modulus", "coulomb_friction")
        if all(stds[n][-1] > abs(values[n][-1]) / 3.0 for n in names):
            return ["the log excites neither leakage, bulk modulus nor friction: nothing can be said of them"]
        return []

    def _estimates(self) -> dict[str, Estimate]:
        records = self._windows.last_records["ekf"]
        if not records.size:
            empty = {"baseline": None, "value": None, "std": None, "observable": False}
            return {n: Estimate.model_validate({"unit": u, **empty}) for n, (u, _, _) in ESTIMATED.items()}
        values, stds = estimates(records, self.unit, self._windows.model)
        seen = self._windows.observed()
        healthy = {
            "leakage": self.unit.pump.total_leakage / float(records[-1, layout.R_VISCOSITY]),
            "bulk_modulus": self.unit.oil.bulk_modulus,
            "coulomb_friction": healthy_coulomb(self.unit),
            "viscous_friction": healthy_viscous(self.unit),
        }
        return {
            name: Estimate(
                unit=si,
                baseline=_significant(healthy[name]),
                value=_significant(float(values[name][-1])),
                std=_significant(float(stds[name][-1])),
                observable=bool(seen[name].valid[-1]),
                held=_significant(float(seen[name].held[-1])),
                held_std=_significant(float(seen[name].held_std[-1])),
                age_s=_significant(float(seen[name].age[-1])),
                information_std=_significant(float(seen[name].information_std[-1])),
            )
            for name, (si, _, _) in ESTIMATED.items()
        }

    def trajectories(self) -> Trajectories:
        """Everything over time, for the report and the annotated MCAP.

        Raises
        ------
        ValueError : the pipeline was told not to keep trajectories.
        """
        records = self._windows.records()
        values: dict[str, dict[str, Array]] = {}
        stds: dict[str, dict[str, Array]] = {}
        for m, r in records.items():
            if r.size:
                values[m], stds[m] = estimates(r, self.unit, self._windows.model)
            else:
                values[m] = {n: np.empty(0) for n in ESTIMATED}
                stds[m] = {n: np.empty(0) for n in ESTIMATED}
        seen = self._windows.observed_throughout()
        standard = (
            self.model.standardise(self._features, self._spread) if self._features.size else self._features
        )
        return Trajectories(
            time=records["ekf"][:, layout.R_TIME], estimates=values, stds=stds,
            observable={n: seen[n].valid for n in OBSERVABLE},
            held={n: seen[n].held for n in OBSERVABLE}, held_std={n: seen[n].held_std for n in OBSERVABLE},
            information_std={n: seen[n].information_std for n in OBSERVABLE},
            nis={m: r[:, layout.R_NIS] for m, r in records.items()}, window_time=self._time,
            feature_names=list(FEATURES), features=standard, statistic=self._statistic,
            threshold=self._test.threshold,
            probabilities={c: self._probabilities[:, i] for i, c in enumerate(self.model.classes)},
        )  # fmt: skip

    def state(self) -> dict[str, Array]:
        """The whole state as flat named arrays; `np.savez` writes it, `restore` takes it back."""
        scalars = {
            "version": STATE_VERSION, "axis": self.axis, "log": self.log, "classes": list(self.model.classes),
            "test": {k: getattr(self._test, k) for k in ("statistic", "since", "alarm_time", "peak")},
        }  # fmt: skip
        out = self._windows.state()
        out |= {
            "pipeline": packed(scalars), "window_time": self._time.copy(), "features": self._features.copy(),
            "probabilities": self._probabilities.copy(), "statistic": self._statistic.copy(),
        }  # fmt: skip
        return out

    def restore(self, state: dict[str, Array]) -> None:
        """Go on from a state that `state` gave, on the same unit and model.

        Raises
        ------
        InputError : a state of another version, unit or model.
        """
        scalars = unpacked(state["pipeline"])
        if scalars["version"] != STATE_VERSION or scalars["classes"] != list(self.model.classes):
            raise InputError("saved state of another version or model", mend="start anew")
        self._windows.restore(state)
        self.axis, self.log = scalars["axis"], scalars["log"]
        for k, v in scalars["test"].items():
            setattr(self._test, k, v)
        self._time, self._features = state["window_time"].copy(), state["features"].copy()
        self._probabilities, self._statistic = state["probabilities"].copy(), state["statistic"].copy()


def _significant(value: float, digits: int = 5) -> float | None:
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None
