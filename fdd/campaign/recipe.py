"""A recipe: what a labelled data set of simulated runs is made of, read from YAML.

Ranges are ``[low, high]`` in SI units, weights are relative. What a recipe leaves out has the
defaults below. The ranges of single duties and loads are the plant's own (their ``usual``)
unless `Recipe.ranges` overrides them.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from fdd.bounds import MAX_RECIPE_BYTES
from fdd.campaign.population import Range, Share, Weight, within
from fdd.campaign.structures import Condition, Structure
from fdd.diagnosis.findings import is_none
from fdd.errors import InputError
from fdd.faults import CATALOGUE, PROFILES
from fdd.plant import Validated
from fdd.plant.duty import DUTIES
from fdd.plant.faults import SIMULATED, FaultScales
from fdd.plant.rig import LOADS
from fdd.plant.scenario import Recording
from fdd.yaml_reading import yaml_mapping, yaml_of, yaml_text

RECIPE_SCHEMA = "fdd.recipe/1"
MIN_DURATION = 3.0
"""s; readers of logs refuse shorter ones."""
Severities = Annotated[Range, within(0.0, 1.0)]

ZERO_ERROR = {
    "position": 2e-3, "pressure_difference": 8e3, "pressure_1": 8e3, "pressure_2": 8e3,
    "pressure_accumulator": 8e3, "motor_current": 0.02, "oil_temperature": 1.0,
}  # fmt: skip
"""Most that a sensor's zero is off, SI: assumptions, about 0.1 % of the transducers' range."""
PROFILE_WEIGHTS = {"step": 0.6, "ramp": 0.25, "intermittent": 0.15}
DUTY_WEIGHTS = {
    "steps": 1.0, "sines": 1.0, "flight": 1.0, "sawtooth": 1.0, "strokes": 1.0, "prbs": 0.5, "sweep": 0.5,
    "constant_speed": 0.5,
}  # fmt: skip
LOAD_WEIGHTS = dict.fromkeys(("none", "constant", "spring", "inertia", "gust", "throttle"), 1.0)
"""A press and a hinge with play are drawn where a recipe names them."""
DRAWN_DUTIES = tuple(name for name in DUTIES if name != "levels")
"""Duties that a campaign draws; levels are for what a user writes down."""


class FaultShare(Validated):
    """How often a fault is injected, and how severely.

    Attributes
    ----------
    weight : relative to the recipe's other faults.
    severity : its own range; None takes the recipe's.
    variants : of the catalogue's, those that are drawn; None draws them all.
    laws : of the catalogue's, those that are drawn; None goes by the recipe's `laws`.
    """

    weight: Weight = 1.0
    severity: Severities | None = None
    variants: tuple[str, ...] | None = None
    laws: Annotated[tuple[str, ...] | None, Field(min_length=1, exclude_if=is_none)] = None


class SensorVariation(Validated):
    """How a unit's sensors differ from their data sheet. The same in all logs of a unit.

    Attributes
    ----------
    noise_factor : of the base's noise, drawn log-uniformly for each sensor.
    gain_error : most that the gain is off, relative; incremental encoders count, and have none.
    zero_error : channel to the most that its zero is off (SI).
    """

    noise_factor: Annotated[Range, within(0.01, 100.0)] = (0.5, 2.5)
    gain_error: Annotated[float, Field(ge=0.0, le=0.2)] = 0.005
    zero_error: dict[str, Weight] = Field(default_factory=lambda: dict(ZERO_ERROR))


class Recipe(Validated):
    """A data set's recipe.

    Attributes
    ----------
    bases : shipped profiles (or paths) that units are varied from, in turn.
    population : how units and their logs differ: ``uniform``, every physical parameter within ± `variation`;
        ``stated``, each by a distribution of its own with its source (`fdd.campaign.population`).
    variation : share of its base's value within which every physical parameter is drawn uniformly.
    area_mismatch : most by which the second area departs from the first, relative; 0 keeps them equal. Both
        with the uniform population alone.
    duration : s of each log.
    faults : id of the catalogue to its weight and severities.
    laws : by which faults come that may have several: ``first``, which signatures know best; ``all``;
        ``unseen``, all but the first, where there are others. See `laws_of`.
    severity : range for faults without their own.
    fault_scales : figures of severity 1 to the ranges that each log draws them from.
    second_fault_share : share of the faulty logs that carry a second fault.
    stuck_valve : chamber whose check valve sticks: any, or the one that the load presses on. On the
        other side the valve stands open anyway and nothing can be seen while the load keeps its sign.
    onset : of a fault, as shares of the log's duration.
    at_start_share : share of faults that are there from the beginning instead.
    profiles, duties, loads : name to weight. What comes with load or heat is a fault of the plant; for one of
        a sensor the other profiles' weights hold. A sensor's drift always starts as a step.
    speed_control_share : share of logs in speed control, for duties that can be done so.
    position_gain : (rad/s)/m of the position loop, drawn log-uniformly.
    oil_temperature, warming : °C at the start, °C/s.
    charge_factor : accumulator charge over the unit's.
    ranges : duty or load to its parameters' ranges, where the plant's usual ones are not wanted.
    baseline : whether each unit also makes healthy calibration runs, for ``fdd identify``.
    baseline_kind : what these are: strokes, multi-sine and throttled strokes that were made for
        ``identification``, or ``ordinary`` ones: strokes at several speeds and two runs of work.
    structures : machines that differ in kind, drawn by weight for each unit; none: the bases as they are.
    conditions : what departs from the recipe in single logs, drawn by weight; never in a baseline.
    twins : whether each faulty log is simulated again without its faults.
    licence, cite : what the data set's card says of them.

    An InputError names the field that is not possible, and what is allowed.
    """

    schema_: Literal["fdd.recipe/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\- ]{1,64}$")] = "data set"
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    bases: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)] = ("axis_a", "axis_b")
    units: Annotated[int, Field(ge=1, le=10_000)] = 10
    logs_per_unit: Annotated[int, Field(ge=0, le=1_000)] = 5
    population: Annotated[Literal["uniform", "stated"], Field(exclude_if=lambda how: how == "uniform")] = (
        "uniform"
    )
    variation: Annotated[float, Field(ge=0.0, le=0.5)] = 0.15
    area_mismatch: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    sensors: SensorVariation = SensorVariation()
    duration: Annotated[Range, within(MIN_DURATION, 3600.0)] = (40.0, 60.0)
    healthy_share: Share = 0.3
    faults: dict[str, FaultShare] = Field(default_factory=dict)
    laws: Annotated[Literal["first", "all", "unseen"], Field(exclude_if=lambda how: how == "first")] = "first"
    severity: Severities = (0.15, 1.0)
    fault_scales: dict[str, Range] = Field(default_factory=lambda: dict(FaultScales.usual))
    second_fault_share: Share = 0.0
    stuck_valve: Literal["any", "loaded"] = "any"
    onset: Annotated[Range, within(0.0, 0.99)] = (0.2, 0.6)
    at_start_share: Share = 0.1
    profiles: dict[str, Weight] = Field(default_factory=lambda: dict(PROFILE_WEIGHTS))
    duties: dict[str, Weight] = Field(default_factory=lambda: dict(DUTY_WEIGHTS))
    loads: dict[str, Weight] = Field(default_factory=lambda: dict(LOAD_WEIGHTS))
    speed_control_share: Share = 0.3
    position_gain: Annotated[Range, within(1.0, 30_000.0)] = (4_000.0, 16_875.0)
    oil_temperature: Annotated[Range, within(-20.0, 100.0)] = (25.0, 55.0)
    warming: Annotated[Range, within(-0.5, 0.5)] = (0.0, 0.03)
    charge_factor: Annotated[Range, within(0.2, 3.0)] = (0.7, 1.4)
    ranges: dict[str, dict[str, Range]] = Field(default_factory=dict)
    recording: Recording = Recording()
    baseline: bool = True
    baseline_kind: Literal["identification", "ordinary"] = "identification"
    structures: tuple[Structure, ...] = ()
    conditions: tuple[Condition, ...] = ()
    twins: Annotated[bool, Field(exclude_if=operator.not_)] = False
    format: Literal["parquet", "mcap"] = "parquet"
    licence: Annotated[str | None, Field(max_length=200, exclude_if=is_none)] = None
    cite: Annotated[str | None, Field(max_length=2000, exclude_if=is_none)] = None

    @model_validator(mode="after")
    def _together(self) -> Recipe:
        _known("faults", self.faults, SIMULATED)
        _known("profiles", self.profiles, PROFILES)
        _known("fault_scales", self.fault_scales, tuple(FaultScales.model_fields))
        _known("duties", self.duties, DRAWN_DUTIES)
        _known("loads", self.loads, tuple(LOADS))
        _known("ranges", self.ranges, (*DUTIES, *LOADS))
        for kind_of, listed in (("structures", self.structures), ("conditions", self.conditions)):
            names = [each.name for each in listed]
            if len(set(names)) < len(names):
                raise InputError("a name is there twice", where=f"recipe {kind_of}", mend="name each anew")
            if listed:
                _weighted(kind_of, [each.weight for each in listed])
            for each in listed:
                _known(f"{kind_of} {each.name} duties", each.duties or {}, DRAWN_DUTIES)
                _known(f"{kind_of} {each.name} loads", each.loads or {}, tuple(LOADS))
        for name, bounds in self.ranges.items():
            kind = DUTIES[name] if name in DUTIES else LOADS[name]
            _known(f"ranges {name}", bounds, tuple(kind.usual))
        for name, share in self.faults.items():
            _known(f"faults {name} variants", dict.fromkeys(share.variants or ()), CATALOGUE[name].variants)
            _known(f"faults {name} laws", dict.fromkeys(share.laws or ()), tuple(CATALOGUE[name].laws))
        for name, ends in self.fault_scales.items():
            for end in ends:
                FaultScales(**{name: end})
        for field, weights in (("profiles", self.profiles), ("duties", self.duties), ("loads", self.loads)):
            _weighted(field, weights.values())
        weighted = sum(f.weight > 0.0 for f in self.faults.values())
        if self.healthy_share < 1.0 and not weighted:
            faulty = 1.0 - self.healthy_share
            problem = f"{faulty:.0%} of the logs are to be faulty, but no fault has a weight"
            raise InputError(problem, where="recipe faults", mend="name faults, or set healthy_share to 1")
        if self.second_fault_share > 0.0 and weighted < 2:
            raise InputError("second_fault_share needs two faults with a weight", where="recipe faults")
        return self

    def laws_of(self, name: str) -> tuple[str, ...]:
        """Laws that a fault is drawn by, each as likely; () for one that has none."""
        every, own = tuple(CATALOGUE[name].laws), self.faults[name].laws
        return own or {"first": every[:1], "all": every, "unseen": every[1:] or every}[self.laws]

    @property
    def oil_temperatures(self) -> Range:
        """Coldest and hottest oil of any run, calibration runs included, °C."""
        parts: tuple[Recipe | Condition | Structure, ...] = (self, *self.structures, *self.conditions)
        starts = [each.oil_temperature for each in parts if each.oil_temperature is not None]
        rates = [rate for each in parts if each.warming is not None for rate in each.warming]
        falls, rises = (self.duration[1] * edge for edge in (min(0.0, *rates), max(0.0, *rates)))
        return min(30.0, *(s[0] + falls for s in starts)), max(45.0, *(s[1] + rises for s in starts))

    @property
    def number(self) -> int:
        """Logs beside the baselines."""
        return self.units * self.logs_per_unit

    @classmethod
    def load(cls, path: str | Path) -> Recipe:
        """Read a recipe; an InputError where there is no file, it is none, or a field is not possible."""
        path = Path(path)
        mend = "give a YAML file, see datasets/README.md"
        return cls.from_yaml(yaml_text(path, "recipe", MAX_RECIPE_BYTES, mend), where=path)

    @classmethod
    def from_yaml(cls, text: str, where: str | Path = "recipe") -> Recipe:
        """Parse YAML text; `where` is named in errors."""
        data = yaml_mapping(text, where, "recipe", schema=RECIPE_SCHEMA)
        try:
            return cls(**data)
        except InputError as error:
            raise error.at(where) from None

    def to_yaml(self) -> str:
        """The whole recipe, defaults filled in; `from_yaml` gives the same recipe back."""
        return yaml_of(self.model_dump(mode="json", by_alias=True))


def _weighted(field: str, weights: Iterable[float]) -> None:
    if not sum(weights) > 0.0:
        raise InputError("all weights are 0", where=f"recipe {field}", mend="give one a weight")


def _known(field: str, given: dict[str, Any], known: tuple[str, ...]) -> None:
    for name in given:
        if name not in known:
            mend = f"use: {', '.join(known) or 'none'}"
            raise InputError(f"unknown {name!r}", where=f"recipe {field}", mend=mend)
