"""Prior of a healthy unit's coefficients: random effects between units and logs, within a log, by frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from fdd.residuals.balances import BALANCES
from fdd.residuals.compiled import Array, Flags
from fdd.unit import Unit

UNKNOWN_VISCOSITY = 0.6
"""Standard deviation of ln viscosity between two logs without a thermometer: 15 K, at 4 %
a kelvin (ISO VG 32 at 40 °C by Walther's equation)."""
WARMING = 2e-3
"""1/s, std of the rate at which ln viscosity falls while oil warms: 3 K a minute, at 4 % a kelvin."""
DUTY_SCALE = 0.3
"""Of relief pressure and of the largest speed: distance between two duties at which a law's errors correlate
by 1/e. As many of 387 simulated faults score above 99 of 100 healthy logs with 0.15 as with 0.6."""
LEAST_PROFILE = 0.02
"""Variance, over that from log to log, below which a profile of these errors is left out."""
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
Positive = Annotated[float, Field(ge=0.0, le=1e12)]


class CoefficientSpread(BaseModel):
    """Mean of one coefficient over healthy units, and its standard deviations.

    Attributes
    ----------
    mean, units : of units, and their std. between : std from log to log of one unit, for each of
        `LogConditions`. logs : how many logs' worth of information these rest on, 0 for what is assumed;
        their relative std is ``1/√(2 logs)``. within : std of what changes in some minutes of a healthy log.
        wander : std from frame to frame.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    mean: Number
    units: Positive
    between: tuple[Positive, Positive, Positive, Positive, Positive]
    logs: Positive = 0.0
    within: Positive
    wander: Positive


class BalanceSpread(BaseModel):
    """One balance's; `noise` is the initial std of a row."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    noise: Positive
    coefficients: dict[str, CoefficientSpread]


class Spreads(BaseModel):
    """Variance components of healthy units and logs, learnt by ``fdd train`` from the population `data`."""

    model_config = ConfigDict(extra="forbid")
    data: str
    balances: dict[str, BalanceSpread]


class LogConditions(NamedTuple):
    """Conditions of a log that its coefficients' variance about the unit's depends on: weights of variances.

    Attributes
    ----------
    always : one. rows : variance of the log's rows: a law's model error grows with its residuals.
        reconstructed : share in which the chambers' pressures are. heat : square of what the oil's
        temperature is off the reference's, in units of ten kelvin: a data sheet's viscosity law is not this
        oil's. without_thermometer : share of the log in which the oil's temperature, so its viscosity, is
        unknown.
    """

    always: float
    rows: float
    reconstructed: float
    heat: float
    without_thermometer: float


@cache
def shipped_spreads() -> Spreads:
    """Those that come with fdd."""
    return Spreads.model_validate_json((resources.files("fdd.residuals") / "spreads.json").read_text("utf-8"))


@dataclass(frozen=True)
class Effects:
    """Random effects of one balance's coefficients, (n,) each.

    Attributes
    ----------
    mean : of the healthy unit. covariance : (n, n) of a log's coefficients: log-to-log variation and
        uncertainty of the mean. known : (n, n), of the mean alone. units : std of units about the
        population's mean. between : (5, n) std from log to log, see `CoefficientSpread`. within : std of
        unmeasured changes in some minutes of a healthy log; assumed: a magnet loses 0.1 % of its torque a
        kelvin and warms by 20, a position transducer 0.01 to 0.03 % of its gain a kelvin. wander : std from
        frame to frame. noise : initial std of a row. information, scatter : (n, n), of healthy logs, and the
        sum of squares of the scores of their stretches of 2 s. log_variance : (n,) of a log's coefficients
        about the unit's. warming : (n,) std of their change in a second by oil that warms without a
        thermometer. own : (n,), see `Balance.own`.
    """

    mean: Array
    covariance: Array
    known: Array
    units: Array
    between: Array
    within: Array
    wander: Array
    noise: float
    information: Array
    scatter: Array
    log_variance: Array
    warming: Array | float = 0.0
    own: Flags | bool = True

    def between_logs(self, conditions: LogConditions) -> Array:
        """Variance (n,) of a log's coefficients about the unit's."""
        return np.asarray(np.array(conditions) @ np.square(self.between))


def usual_conditions(noise: float) -> LogConditions:
    """Those of a log at the reference temperature, with all pressures, whose rows have that std."""
    return LogConditions(1.0, noise**2, 0.0, 0.0, 0.0)


def first_effects(name: str, spreads: Spreads | None = None, unit: Unit | None = None) -> Effects:
    """Effects in one balance of a unit of which no healthy balances are known, by a model's `spreads` (None
    takes the shipped ones). A profile's stated doubt about its displacement is the volume balance's about its
    gain."""
    spread = (spreads or shipped_spreads()).balances[name]
    each = [spread.coefficients[c] for c in BALANCES[name].columns]
    mean, units, within, wander = (
        np.array([getattr(c, what) for c in each]) for what in ("mean", "units", "within", "wander")
    )
    if name == "volume" and unit is not None:
        gain = BALANCES[name].columns.index("gain")
        stated = unit.pump.std_of("displacement") or 0.0
        units[gain] = np.hypot(units[gain], stated / unit.pump.displacement)
    between = np.array([c.between for c in each]).T
    none = np.zeros((mean.size, mean.size))
    known = np.diag(np.square(units))
    first = Effects(
        mean, known, known, units, between, within, wander, spread.noise, none, none, np.zeros_like(mean),
        own=BALANCES[name].own,
    )  # fmt: skip
    return with_logs(first, usual_conditions(spread.noise))


def with_logs(effects: Effects, conditions: LogConditions, viscous: Array | float = 0.0) -> Effects:
    """The same for a log under these conditions; `viscous` (n,) is of `viscous_change`."""
    differs, blind = effects.between_logs(conditions), np.sqrt(conditions.without_thermometer) * viscous
    unknown = UNKNOWN_VISCOSITY**2 * np.outer(blind, blind)
    return replace(
        effects, covariance=effects.known + np.diag(differs) + unknown, log_variance=differs,
        warming=WARMING * blind,
    )  # fmt: skip


def viscous_change(name: str, mean: Array) -> Array:
    """Derivative of a balance's coefficients (n,) by ln viscosity; they go by it or by its inverse."""
    balance = BALANCES[name]
    goes = [float(c in balance.viscous) - float(c in balance.laminar) for c in balance.columns]
    return np.array(goes) * mean


def duty_profiles(duty: Array) -> Array:
    """Profiles (h, j) of what a law errs by as the duty changes in a log, load and speed (h, 2) of frames.

    The error is a Gaussian process over the duty, as in Kennedy and O'Hagan 2001 (doi
    10.1111/1467-9868.00294), with an exponential covariance and the variance from log to log; about its mean
    in the log it is the sum of these profiles times independent variables of that variance.
    """
    # All frames in one cell of half a scale err alike: the matrix stays small.
    cells, place, count = np.unique(
        np.round(2.0 * duty / DUTY_SCALE), axis=0, return_inverse=True, return_counts=True
    )
    weight = np.sqrt(count / len(duty))
    centred = np.eye(len(cells)) - np.outer(weight, weight)
    alike = np.exp(-0.5 * np.abs(cells[:, None] - cells).sum(axis=2))
    values, vectors = np.linalg.eigh(centred @ (weight[:, None] * alike * weight) @ centred)
    kept = values > LEAST_PROFILE
    profiles = vectors[:, kept] * np.sqrt(values[kept]) / weight[:, None]
    return np.asarray(profiles[place.ravel()])
