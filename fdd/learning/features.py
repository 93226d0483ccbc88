"""What the diagnosis knows of a log, as numbers for other learners: one row a log.

Nothing is worked out a second time: misfits, fits and estimates are those that the answer was made of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.evidence import Amplitude
from fdd.diagnosis.findings import ESTIMATED, Diagnosis
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import CATALOGUE
from fdd.history.compare import column, has
from fdd.residuals.balances import BALANCES
from fdd.samples import CHANNELS, Samples
from fdd.sensors.finding import FAILING
from fdd.unit import Unit

Row = dict[str, float]
METHODS: tuple[Literal["ekf", "svsf"], ...] = ("ekf", "svsf")
MEASURED = tuple(name for name in CHANNELS if name != "time")
WEIGHED = tuple(f.id for f in CATALOGUE.values() if f.signatures)
"""Faults that the balances speak of."""
MOVING = 0.01
"""Of the drive's largest speed, what is motion."""


@dataclass(frozen=True)
class Feature:
    """One column: its SI unit (1 where it has none) and what it says."""

    unit: str
    meaning: str


def _features() -> dict[str, Feature]:
    found: dict[str, Feature] = {}
    for name, balance in BALANCES.items():
        what = f"how badly the balance of {balance.title} closes, in what that of the healthy unit does"
        found[f"misfit_{name}"] = Feature("1", f"{what}: mean over half seconds")
        found[f"misfit_{name}_max"] = Feature("1", f"{what}: the worst half second")
    for name in WEIGHED:
        title = CATALOGUE[name].title
        found[f"severity_{name}"] = Feature(
            "1", f"fitted severity of {title}, alone; 0 where it gains too little to be fitted"
        )
        found[f"severity_{name}_std"] = Feature("1", "standard deviation of that")
        found[f"score_{name}"] = Feature("1", f"log likelihood ratio of {title} against no fault")
        found[f"visible_{name}"] = Feature("1", f"least severity of {title} that the log would have shown")
    for quantity, (unit, _, title) in ESTIMATED.items():
        for method in METHODS:
            found[f"{quantity}_{method}"] = Feature(unit, f"{title} at the end, by the {method.upper()}")
            found[f"{quantity}_{method}_std"] = Feature(unit, "standard deviation of that")
            found[f"{quantity}_{method}_change"] = Feature("1", "that over the profile's healthy one, less 1")
        found[f"{quantity}_observable"] = Feature("1", f"1 where the data tell the {title.lower()}")
    for name in MEASURED:
        found[f"has_{name}"] = Feature("1", f"1 where the log has {CHANNELS[name].meaning}")
        found[f"failed_{name}"] = Feature("1", "1 where that sensor is not trusted at the end")
    found["duration"] = Feature("s", "time of the row")
    found["rate"] = Feature("Hz", "samples a second, by the median step")
    found["pump_speed_rms"] = Feature("rad/s", "root mean square of the pump's speed")
    found["pump_speed_p95"] = Feature("rad/s", "95 % of the time the pump is no faster")
    found["moving_share"] = Feature("1", f"share of time above {MOVING:.0%} of the drive's largest speed")
    found["stroke_share"] = Feature("1", "range of the position over the stroke")
    found["pressure_difference_rms"] = Feature("Pa", "root mean square of the pressure difference")
    found["pressure_difference_p95"] = Feature("Pa", "95 % of the time it is no larger")
    found["oil_temperature_mean"] = Feature("°C", "mean oil temperature")
    return found


FEATURES = _features()
"""Column to what it is, in the order of the columns: the same for every log. NaN: not told."""


def features_of(pipeline: Pipeline, answer: Diagnosis, samples: Samples) -> Row:
    """The features of a log: a number for each of `FEATURES`, SI.

    From a pipeline and the answer that its `finish` gave; `samples` of the log are for the duty. Fits are of
    no more than the last two and a half minutes of evidence.
    """
    row = dict.fromkeys(FEATURES, math.nan)
    _, names, misfits = pipeline.misfits()
    for name, values in zip(names, misfits.T, strict=True):
        told = values[values > 0.0]  # 0 stands for a half second that told nothing
        if told.size:
            row[f"misfit_{name}"], row[f"misfit_{name}_max"] = float(told.mean()), float(told.max())
    row |= _fits(pipeline.fitted, answer)
    for method in METHODS:
        for quantity, e in pipeline.estimates(method).items():
            row[f"{quantity}_observable"] = float(e.observable)
            if e.value is None or e.std is None or not e.baseline:
                continue
            row[f"{quantity}_{method}"], row[f"{quantity}_{method}_std"] = e.value, e.std
            row[f"{quantity}_{method}_change"] = e.value / e.baseline - 1.0
    states = {s.channel: s.state for s in answer.sensors}
    for name in MEASURED:
        row[f"has_{name}"] = float(has(samples, name))
        row[f"failed_{name}"] = float(states.get(name) in FAILING)
    return row | _duty(samples, pipeline.unit)


def _fits(fitted: list[Amplitude], answer: Diagnosis) -> Row:
    """Of each fault's hypotheses (sides, variants, channels) the one that explains most."""
    row: Row = {}
    best: dict[str, Amplitude] = {}
    for fit in fitted:
        name = fit.hypothesis.fault
        if name not in best or fit.gain > best[name].gain:
            best[name] = fit
    # The answer lists what it weighed; of these, one that no fit is left of explains nothing.
    for unseen in answer.not_visible:
        row[f"visible_{unseen.fault}"] = math.nan if unseen.severity is None else unseen.severity
        row[f"severity_{unseen.fault}"] = row[f"score_{unseen.fault}"] = 0.0
    for name, fit in best.items():
        row[f"severity_{name}"], row[f"score_{name}"] = fit.active_amplitude, fit.score
        row[f"severity_{name}_std"] = math.sqrt(fit.variance)
    return row


def _duty(samples: Samples, unit: Unit) -> Row:
    """What the time asked of the actuator."""
    speed = np.abs(_told(column(samples, "pump_speed")))
    difference = samples.get("pressure_difference")
    if not has(samples, "pressure_difference"):
        difference = samples.get("pressure_1") - samples.get("pressure_2")
    difference = np.abs(_told(difference))
    position, celsius = _told(samples.get("position")), _told(samples.get("oil_temperature"))
    row = {
        "duration": float(samples.duration),
        "rate": 1.0 / float(np.median(np.diff(samples.time))) if len(samples) > 1 else math.nan,
    }
    if speed.size:
        row["pump_speed_rms"], row["pump_speed_p95"] = _rms(speed), float(np.percentile(speed, 95.0))
        row["moving_share"] = float(np.mean(speed > MOVING * unit.drive.max_speed))
    if position.size:
        row["stroke_share"] = float(np.ptp(position)) / unit.cylinder.stroke
    if difference.size:
        row["pressure_difference_rms"] = _rms(difference)
        row["pressure_difference_p95"] = float(np.percentile(difference, 95.0))
    if celsius.size:
        row["oil_temperature_mean"] = float(celsius.mean())
    return row


def _told(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[np.isfinite(values)]


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def log_features(samples: Samples, unit: Unit, model: Model | None = None) -> tuple[Diagnosis, Row]:
    """Diagnose a log on its profile `unit`, best one that was identified: its answer, and its features.

    Raises InputError: channels that do not suffice.

    Examples
    --------
    >>> answer, row = log_features(Samples([0.0], {"position": [0.0]}), Unit.load("axis_a"))
    >>> answer.verdict, row["has_position"], row["has_pressure_1"]
    ('inconclusive', 1.0, 0.0)
    """
    pipeline = Pipeline(unit, model, keep_trajectories=False)
    pipeline.push(samples)
    answer = pipeline.finish()
    return answer, features_of(pipeline, answer, samples)
