"""A unit: what the software knows about one actuator, read from and written to YAML. Plant and estimators
take their parameters from here, and share nothing else; numbers carry their provenance (`fdd.sections`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fdd.bounds import MAX_UNIT_BYTES
from fdd.errors import InputError, input_error
from fdd.files import write_text
from fdd.sections import Section, Sensor, si
from fdd.yaml_reading import yaml_mapping, yaml_text

UNIT_SCHEMA = "fdd.unit/1"
SMALL = "axis_a_13cm3"
"""The shipped variant of axis A with the thesis's own accumulator."""
MOST = 1e30
"""Of any figure of a baseline: squares of it still are numbers."""
Finite = Annotated[float, Field(ge=-MOST, le=MOST)]
Positive = Annotated[float, Field(gt=0, le=MOST)]
_ANEW = "identify the unit anew"


class Cylinder(Section):
    """Cylinder: position 0 is mid-stroke, positive extends (raises chamber 1's volume)."""

    area_1: Annotated[float, si("m^2"), Field(gt=0)]
    area_2: Annotated[float, si("m^2"), Field(gt=0)]
    stroke: Annotated[float, si("m"), Field(gt=0)]
    moving_mass: Annotated[float, si("kg"), Field(gt=0)]
    volume_1: Annotated[float, si("m^3"), Field(gt=0)]
    """Oil of chamber 1 with its lines, at position 0."""
    volume_2: Annotated[float, si("m^3"), Field(gt=0)]
    position_compliance: Annotated[float, si("1"), Field(gt=0, le=5)] = 1.0
    """How much more the chambers' compliance changes with position than ``V ± A x`` says: hoses and walls."""

    @property
    def needs_pilots(self) -> bool:
        """Whether a chamber's valve must let oil back, since the other one takes more or less than it gives:
        where areas differ by more than 3 %."""
        return min(self.area_1, self.area_2) <= 0.97 * max(self.area_1, self.area_2)


class Pump(Section):
    """Gear pump: displacement and leakage at `Oil.reference_temperature`."""

    displacement: Annotated[float, si("m^3/rad"), Field(gt=0)]
    cross_port_leakage: Annotated[float, si("m^3/(s*Pa)"), Field(ge=0)]
    """ξ of eq. 3.14, the cylinder's own leakage L/2 included."""
    case_leakage: Annotated[float, si("m^3/(s*Pa)"), Field(ge=0)]
    """C_ep of eq. 3.14, each port to the case drain."""

    @property
    def total_leakage(self) -> float:
        """L_T = C_ep/2 + ξ, m³/(s·Pa): what the thesis measures as leakage (eq. 3.50)."""
        return self.cross_port_leakage + 0.5 * self.case_leakage


class Oil(Section):
    """Oil and the air in it. Effective bulk modulus: 1/β(p) = 1/β_stiff + α·c(p)."""

    bulk_modulus: Annotated[float, si("Pa"), Field(gt=0)]
    """Effective bulk modulus at `reference_pressure`, air and walls included."""
    air_fraction: Annotated[float, si("1"), Field(ge=0, le=0.2)]
    """Volume of free air at atmospheric pressure over volume of oil."""
    polytropic_index: Annotated[float, si("1"), Field(ge=1, le=1.67)]
    reference_pressure: Annotated[float, si("Pa"), Field(ge=0)]
    density: Annotated[float, si("kg/m^3"), Field(gt=0)]
    viscosity_40: Annotated[float, si("m^2/s"), Field(gt=0)]
    viscosity_100: Annotated[float, si("m^2/s"), Field(gt=0)]
    reference_temperature: Annotated[float, si("degC")]
    thermal_expansion: Annotated[float, si("1/K"), Field(ge=0, le=2e-3)] = 7e-4
    """By volume; mineral oils have 7e-4 1/K (ISO 6743-4 grades' data sheets: 6.5e-4 to 7.5e-4)."""


class Accumulator(Section):
    """Inner circuit: accumulator and the valves around it."""

    charge_pressure: Annotated[float, si("Pa"), Field(ge=0)]
    """Of the charged circuit at rest, gas and oil."""
    gas_volume: Annotated[float, si("m^3"), Field(gt=0)]
    """Of the gas at charge pressure."""
    oil_volume: Annotated[float | None, si("m^3"), Field(ge=0)] = None
    """Oil held at charge pressure; None is half the gas, a third of the shell."""
    refeed_cracking_pressure: Annotated[float, si("Pa"), Field(ge=0)]
    refeed_pilots: bool = True
    """Whether the other chamber's pressure may hold a refeeding valve open, as unequal areas ask for;
    False where healthy logs show that the lower chamber keeps what oil it has."""
    refeed_flow_gain: Annotated[float, si("m^3/(s*Pa)"), Field(gt=0)]
    """Flow of an open refeeding check valve per pressure drop, K_v of eq. 3.18."""
    case_cracking_pressure: Annotated[float, si("Pa"), Field(ge=0)]
    relief_pressure: Annotated[float, si("Pa"), Field(gt=0)]
    relief_flow_gain: Annotated[float, si("m^3/(s*Pa)"), Field(gt=0)]

    @property
    def oil_at_rest(self) -> float:
        """Oil held at charge pressure, m³."""
        return 0.5 * self.gas_volume if self.oil_volume is None else self.oil_volume


class FrictionBranch(Section):
    """Steady friction of one direction of motion: eq. 5.12 of the thesis, magnitudes."""

    coulomb: Annotated[float, si("N"), Field(ge=0)]
    static: Annotated[float, si("N"), Field(ge=0)]
    stribeck_velocity: Annotated[float, si("m/s"), Field(gt=0)]
    stribeck_exponent: Annotated[float, si("1"), Field(gt=0, le=3)]
    viscous: Annotated[float, si("N*s/m"), Field(ge=0)]


class Friction(Section):
    """Friction of the cylinder, per direction."""

    forward: FrictionBranch
    reverse: FrictionBranch
    trial_spread: Annotated[float, si("1"), Field(ge=0, le=0.5)]
    """Relative standard deviation from trial to trial (Table 5.1)."""


class Drive(Section):
    """Servomotor, its velocity loop and its limits."""

    max_speed: Annotated[float, si("rad/s"), Field(gt=0)]
    delay: Annotated[float, si("s"), Field(ge=0)]
    pole_1: Annotated[float, si("1/s"), Field(gt=0)]
    pole_2: Annotated[float, si("1/s"), Field(gt=0)]
    zero: Annotated[float, si("1/s"), Field(gt=0)]
    torque_constant: Annotated[float, si("N*m/A"), Field(gt=0)]
    winding_resistance: Annotated[float, si("ohm"), Field(gt=0)]
    winding_inductance: Annotated[float, si("H"), Field(gt=0)] = 0.014
    """Thesis Table 4.11."""
    back_emf_constant: Annotated[float, si("V*s/rad"), Field(gt=0)] = 0.98
    """Thesis Table 4.11."""
    voltage_limit: Annotated[float, si("V"), Field(gt=0)] = 540.0
    """Largest winding voltage; by default the direct-current link of a 400 V converter (assumption)."""
    inertia: Annotated[float, si("kg*m^2"), Field(gt=0)]
    viscous_friction: Annotated[float, si("N*m*s/rad"), Field(ge=0)]
    current_limit: Annotated[float, si("A"), Field(gt=0)]


class Monitoring(Section):
    """What the operator wants of the diagnosis."""

    false_alarms_per_hour: Annotated[float, si("1/s", written="1/h"), Field(gt=0, le=1.0 / 60.0)] = 1 / 3600
    """Wanted rate of false alarms of the sequential test: per hour in the profile, at most 60; 1/s here."""


class Estimation(Section):
    """Noise that this unit's healthy logs show, in place of the estimators' defaults.

    Written by ``fdd identify`` for what a healthy log can tell; what is left out stays as
    `estimators.eha.layout.Noise` argues. Measurement noise is a standard deviation per sample; process
    noise that of its integral after one second.
    """

    position: Annotated[float | None, si("m"), Field(gt=0)] = None
    angle: Annotated[float | None, si("rad"), Field(gt=0)] = None
    pressure: Annotated[float | None, si("Pa"), Field(gt=0)] = None
    pressure_difference: Annotated[float | None, si("Pa"), Field(gt=0)] = None
    force: Annotated[float | None, si("N*s^0.5"), Field(gt=0)] = None
    acceleration: Annotated[float | None, si("rad/s^1.5"), Field(gt=0)] = None
    flow: Annotated[float | None, si("m^3/s^0.5"), Field(gt=0)] = None

    @property
    def known(self) -> dict[str, float]:
        """The numbers that are there, SI."""
        values = {n: getattr(self, n) for n in type(self).model_fields if n != "provenance"}
        return {n: float(v) for n, v in values.items() if v is not None}


class BalanceBaseline(Section):
    """One balance on this unit's healthy logs.

    `columns`, `mean`, `covariance`: of its coefficients. `noise`: std of a row. `information`: of all frames.
    `scatter`: sum of squares of the scores of stretches of 2 s, which the information would equal if all
    errors were independent; empty in older profiles. `moderation`: this unit's variances, from log to log and
    within one, over the population's; empty for the same. `hops`: how many frames told something.
    `hop_noise`: what older versions wrote, and nothing reads.
    """

    columns: Annotated[list[str], Field(min_length=1, max_length=64)]
    mean: list[Finite]
    covariance: list[list[Finite]]
    information: list[list[Finite]] = Field(default_factory=list)
    scatter: list[list[Finite]] = Field(default_factory=list)
    moderation: list[Positive] = Field(default_factory=list)
    noise: Annotated[float, si("1"), Field(gt=0, le=MOST)]
    hops: Annotated[int, Field(ge=0, le=10**9)] = 0
    hop_noise: list[Positive] = Field(default_factory=list, max_length=100)

    @model_validator(mode="after")
    def _fits_together(self) -> BalanceBaseline:
        n = len(self.columns)
        for name, wanted in (("mean", (n,)), ("moderation", (0, n))):
            if (count := len(getattr(self, name))) not in wanted:
                raise InputError(f"{count} figures for {n} columns", where=name, mend=_ANEW)
        for name in ("covariance", "information", "scatter"):
            rows = getattr(self, name)
            if not rows and name != "covariance":
                continue
            if len(rows) != n or any(len(row) != n for row in rows):
                raise InputError(f"is not {n} by {n}", where=name, mend=_ANEW)
            matrix = np.array(rows)
            std = np.sqrt(np.maximum(np.diag(matrix), 0.0)) + 1e-30
            scaled = matrix / std / std[:, None]
            # Figures are rounded to eight places.
            if np.abs(scaled - scaled.T).max() > 1e-6 or np.linalg.eigvalsh(scaled)[0] < -1e-6:
                raise InputError("is not that of any coefficients", where=name, mend=_ANEW)
        return self


class Baseline(Section):
    """Healthy behaviour of this unit, written by ``fdd identify`` (see `fdd.residuals.balances`)."""

    version: str
    seconds: Annotated[float, Field(ge=0)] = 0.0
    """s of healthy logs behind it."""
    balances: dict[str, BalanceBaseline] = Field(default_factory=dict)


class Origin(Section):
    """What an identified profile was made from, and what was said of it.

    `base`, `base_sha256`: profile that was started from: its name and what it said. `date`: ISO 8601. `logs`:
    SHA-256 of each healthy log's file to its name. `limits`: what a user must know. `accepted`: why it would
    have been refused, had nobody accepted it.
    """

    base: str
    base_sha256: str = ""
    date: str = ""
    fdd: str = ""
    map_sha256: str | None = None
    logs: dict[str, str] = Field(default_factory=dict, max_length=10_000)
    limits: list[str] = Field(default_factory=list)
    accepted: list[str] = Field(default_factory=list)


class Unit(BaseModel):
    """Profile of one actuator. `load` raises an InputError that names file, field and what is allowed.

    Examples
    --------
    >>> unit = Unit.load("axis_a")
    >>> round(unit.pump.total_leakage * 1e12, 2)
    6.52
    """

    model_config = ConfigDict(extra="forbid", validate_assignment=True)

    schema_: Literal["fdd.unit/1"] = Field(default="fdd.unit/1", alias="schema")
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\- ]{1,64}$")]
    axis: str = "axis"
    description: str = ""
    cylinder: Cylinder
    pump: Pump
    oil: Oil
    accumulator: Accumulator
    friction: Friction
    drive: Drive
    sensors: dict[str, Sensor]
    estimation: Estimation | None = None
    monitoring: Monitoring = Field(default_factory=Monitoring)
    origin: Origin | None = None
    baseline: Baseline | None = None

    @classmethod
    def load(cls, source: str | Path) -> Unit:
        """Read a shipped profile by name, or a YAML file by path."""
        if isinstance(source, str) and source in shipped_units():
            return _shipped(source).model_copy(deep=True)
        path = Path(source)
        mend = f"give a YAML file or one of: {', '.join(shipped_units())}"
        return cls.from_yaml(yaml_text(path, "unit profile", MAX_UNIT_BYTES, mend), where=path)

    @classmethod
    def from_yaml(cls, text: str, where: str | Path = "unit profile") -> Unit:
        """Parse YAML text; `where` is named in errors."""
        data = yaml_mapping(text, where, "unit profile", schema=UNIT_SCHEMA)
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise input_error(error, where, "correct that field") from None

    def to_yaml(self) -> str:
        """The profile as YAML with units and sources."""
        out: dict[str, Any] = {"schema": UNIT_SCHEMA, "name": self.name, "axis": self.axis}
        if self.description:
            out["description"] = self.description
        for name, part in self:
            if isinstance(part, Section):
                out[name] = part.to_plain()
            elif name == "sensors":
                out[name] = {channel: sensor.to_plain() for channel, sensor in part.items()}
        return yaml.dump(out, sort_keys=False, allow_unicode=True, width=110, Dumper=_Dumper)

    def save(self, path: str | Path) -> None:
        """Write the profile whole or not at all."""
        write_text(path, self.to_yaml())

    def sensor(self, channel: str) -> Sensor:
        """The channel's sensor, or an ideal one where the profile names none."""
        return self.sensors.get(channel) or Sensor()


class _Dumper(yaml.SafeDumper):
    """Quantities on one line each."""

    def flow_leaves(self, data: dict[str, Any]) -> yaml.Node:
        return self.represent_mapping("tag:yaml.org,2002:map", data.items(), flow_style="value" in data)

    def flow_numbers(self, data: Sequence[Any]) -> yaml.Node:
        return self.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)


_Dumper.add_representer(dict, _Dumper.flow_leaves)
_Dumper.add_representer(list, _Dumper.flow_numbers)
_Dumper.add_representer(tuple, _Dumper.flow_numbers)
_Dumper.add_representer(np.float64, lambda d, v: d.represent_float(float(v)))


@lru_cache(maxsize=1)
def shipped_units() -> tuple[str, ...]:
    """Names of the profiles that ship with the package."""
    folder = resources.files("fdd") / "units"
    names = [f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml")]
    return (*sorted(names), SMALL)


@lru_cache(maxsize=16)
def _shipped(name: str) -> Unit:
    if name == SMALL:
        large, source = _shipped("axis_a"), "thesis, Hawe AC13 of 13 cm^3: a third is oil at rest"
        small = Accumulator.model_validate({
            **large.accumulator.to_plain(), "gas_volume": {"value": 8.7e-6, "source": source},
            "oil_volume": {"value": 4.3e-6, "source": "as gas_volume"},
        })  # fmt: skip
        described = "Axis A with the thesis's accumulator of 13 cm³, which a few kelvin fill or empty."
        return large.model_copy(update={"name": SMALL, "description": described, "accumulator": small})
    text = (resources.files("fdd") / "units" / f"{name}.yaml").read_text(encoding="utf-8")
    return Unit.from_yaml(text, where=f"{name}.yaml")
