"""Channel maps: where each channel of the contract stands in a foreign log, and how it is converted to SI.

docs/logs.md has an example. The channels may also stand at the top level, without ``channels:``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fdd.bounds import MAX_MAP_BYTES
from fdd.errors import InputError, did_you_mean, input_error
from fdd.logs.quality import sample_numbers
from fdd.measures import Measure, measure
from fdd.samples import CHANNELS, Column
from fdd.yaml_reading import yaml_mapping, yaml_text

_MADE = {("pump_angle", "pump_speed"), ("pump_speed", "command")}
_HEAD = {"schema", "name", "axis", "csv", "channels", "description"}
LONGEST_BRIDGE = 1.0
"""s; over a longer gap nobody knows how far the pump turned, and nothing is added."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ChannelSource(BaseModel):
    """Where one channel comes from; in SI it is ``unit * (scale * sign * raw + offset)``.

    Attributes
    ----------
    column : of any log but MCAP.
    topic, field : MCAP topic, and the field in its messages (dots go deeper: ``motor.w``). A time without a
        field is the log time.
    unit : of what scale and offset give; the channel's SI unit without one.
    wrap : raw counts per turn of an angle that starts again at 0: it is unwrapped before it is scaled.
    sign_of : a second column (or field of the same topic) whose sign is the direction, where a pump turns
        one way and a valve chooses it. An angle is accumulated with it, anything else multiplied by it.
    from_ : written ``from``: ``pump_angle: {from: pump_speed}`` accumulates the angle from the speed,
        ``pump_speed: {from: command}`` takes the demanded speed for the measured one.
    period : s; with `from`, what one speed sample stands for; the log's own nominal period without it.
    delay : s by which the channel comes late in the log; it is taken out.
    """

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    column: str | None = None
    topic: str | None = None
    field: str | None = None
    unit: str | None = None
    scale: Finite = 1.0
    offset: Finite = 0.0
    sign: Literal[-1, 1] = 1
    wrap: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    sign_of: str | None = None
    from_: Literal["pump_speed", "command"] | None = Field(default=None, alias="from")
    period: Annotated[float, Field(gt=0, le=1)] | None = None
    delay: Annotated[float, Field(ge=-10, le=10)] = 0.0

    @model_validator(mode="after")
    def _one_source(self) -> ChannelSource:
        given = [k for k, v in (("column", self.column), ("topic", self.topic), ("from", self.from_)) if v]
        if len(given) != 1:
            raise ValueError(f"give one of column, topic or from (given: {', '.join(given) or 'none'})")
        if self.field is not None and self.topic is None:
            raise ValueError("field needs a topic")
        if self.period is not None and self.from_ is None:
            raise ValueError("period goes with 'from: pump_speed' only")
        if self.from_ is not None and (more := self.model_fields_set - {"from_", "period"}):
            raise ValueError(f"{sorted(more)[0]} does not go with from")
        if self.scale == 0.0:
            raise ValueError("scale is 0")
        return self

    def measure_of(self, channel: str) -> Measure:
        """The unit of measure. Raises InputError: not of the channel's dimension; names those that are."""
        wanted = CHANNELS[channel]
        try:
            return measure(self.unit if self.unit is not None else wanted.unit, wanted.dimension)
        except InputError as error:
            raise error.at(f"channel {channel}") from None


class CsvLayout(BaseModel):
    """How a CSV file is written; what is not given is detected."""

    model_config = ConfigDict(extra="forbid")

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | None = None
    decimal: Literal[".", ","] | None = None
    skip_rows: Annotated[int, Field(ge=0, le=10_000)] = 0


class ChannelMap(BaseModel):
    """A whole map: sources by channel, and how a CSV file is laid out. `load` and `from_yaml` raise an
    InputError that names the file, the channel and what is allowed."""

    model_config = ConfigDict(extra="forbid")

    schema_: Literal["fdd.map/1"] = Field(default="fdd.map/1", alias="schema")
    name: str = ""
    description: str = ""
    axis: str | None = None
    csv: CsvLayout = Field(default_factory=CsvLayout)
    channels: dict[str, ChannelSource]

    @model_validator(mode="after")
    def _consistent(self) -> ChannelMap:
        if not self.channels:
            raise ValueError("no channel is mapped")
        kinds: set[str] = set()
        for channel, source in self.channels.items():
            if channel not in CHANNELS:
                problem = f"unknown channel {channel!r}{did_you_mean(channel, CHANNELS)}"
                raise ValueError(f"{problem}; the channels are: {', '.join(CHANNELS)}")
            source.measure_of(channel)
            if source.from_ is not None:
                if (channel, source.from_) not in _MADE:
                    told = "'from' makes pump_angle of pump_speed, or pump_speed of command"
                    raise ValueError(f"{channel}: {told}")
                if source.from_ not in self.channels:
                    raise ValueError(f"{channel}: is made from {source.from_}, which the map does not give")
                continue
            kinds.add("column" if source.column else "topic")
            if source.topic and source.field is None and channel != "time":
                raise ValueError(f"{channel}: give the field in the messages of {source.topic}")
            if source.wrap is not None and CHANNELS[channel].dimension != "angle":
                raise ValueError(f"{channel}: wrap is for an angle")
        if len(kinds) > 1:
            raise ValueError("columns (CSV, Parquet) and topics (MCAP) are mixed")
        return self

    @property
    def reads_mcap(self) -> bool:
        """Whether the map names topics (MCAP) rather than columns."""
        return any(source.topic for source in self.channels.values())

    @classmethod
    def load(cls, path: str | Path) -> ChannelMap:
        """Read a map from a YAML file."""
        path = Path(path)
        text = yaml_text(path, "channel map", MAX_MAP_BYTES, "give the path of a YAML file")
        return cls.from_yaml(text, where=path)

    @classmethod
    def from_yaml(cls, text: str, where: str | Path = "channel map") -> ChannelMap:
        """Parse YAML text; `where` is named in errors."""
        mend = "write one line per channel, e.g. position: {column: cyl_pos, unit: mm}"
        data = yaml_mapping(text, where, "channel map", mend=mend)
        try:
            return cls.model_validate(_gathered(data))
        except ValidationError as error:
            raise input_error(error, where, None) from None
        except InputError as error:
            raise error.at(where) from None


def _gathered(data: dict[str, Any]) -> dict[str, Any]:
    """Bring the short form (channels at the top level) into the long one."""
    others = [key for key in data if key not in _HEAD]
    if "channels" in data:
        if not isinstance(data["channels"], dict):
            raise InputError("channels: not a mapping", mend="write one line per channel below it")
        if others:
            if others[0] not in CHANNELS and (near := did_you_mean(others[0], _HEAD)):
                raise InputError(f"unknown key {others[0]!r}{near}")
            raise InputError(f"{others[0]!r} stands beside channels:", mend="move it below channels:")
        return data
    for key in others:
        if isinstance(data[key], dict) and all(isinstance(v, dict) for v in data[key].values()):
            raise InputError(f"unknown key {key!r}{did_you_mean(key, _HEAD)}")
    return {k: data[k] for k in data if k in _HEAD} | {"channels": {k: data[k] for k in others}}


def to_si(channel: str, source: ChannelSource, raw: Column, direction: Column | None = None) -> Column:
    """One channel in its SI unit, (n,): unwrap, give direction, scale, convert. `raw`, `direction`: (n,)
    numbers as they stand in the log, and those of the column named by ``sign_of``."""
    unit = source.measure_of(channel)
    values = raw if source.wrap is None else unwrap_counts(raw, source.wrap)
    if direction is not None:
        values = directed(values, direction, accumulate=unit.dimension == "angle")
    for factor, offset in ((source.scale * source.sign, source.offset), (unit.factor, unit.offset)):
        if (factor, offset) != (1.0, 0.0):
            values = factor * values + offset
    return np.asarray(values, dtype=np.float64)


def unwrap_counts(raw: Column, wrap: float) -> Column:
    """An angle that starts again at 0 each `wrap` counts, made continuous; NaN stays and is passed over."""
    out, there = raw.copy(), np.isfinite(raw)
    out[there] = np.unwrap(raw[there], period=wrap)
    return out


def directed(raw: Column, direction: Column, *, accumulate: bool) -> Column:
    """Give a quantity, (n,), NaN where missing, the sign of another one, e.g. of a directional valve.

    `direction`: (n,) only its sign counts; NaN keeps the last sign. Before the first one a value is missing,
    and an angle stands. `accumulate`: for an angle, of which each step takes the sign of the row it ends in.
    """
    known = np.where(np.isfinite(direction), np.arange(direction.size), -1)
    last = np.maximum.accumulate(known) if known.size else known
    sign = np.where(last >= 0, np.sign(direction[last]), 0.0 if accumulate else np.nan)
    if not accumulate:
        return np.asarray(raw * sign)
    out = raw.copy()
    there = np.flatnonzero(np.isfinite(raw))
    if there.size:
        steps = np.diff(raw[there]) * sign[there[1:]]
        out[there] = np.concatenate(([raw[there[0]]], raw[there[0]] + np.cumsum(steps)))
    return out


def accumulate_speed(time: Column, speed: Column, period: float) -> Column:
    """Angle from speed samples, each of which stands for one nominal period.

    Where the speed is a count difference over the nominal period (s), this gives the counts back exactly.
    Missing rows and NaN are bridged by the mean of their neighbours times the periods missed, up to
    `LONGEST_BRIDGE`. Of (n,) s and rad/s it gives (n,) rad, 0 at the first row that has a speed; NaN stays.
    """
    angle = np.full(time.size, np.nan)
    there = np.flatnonzero(np.isfinite(speed))
    if there.size == 0:
        return angle
    missed = np.diff(sample_numbers(time, period)[there]) - 1
    present = speed[there]
    missed[missed * period > LONGEST_BRIDGE] = 0
    turned = period * (present[1:] + missed * 0.5 * (present[1:] + present[:-1]))
    del missed, present
    angle[there] = np.concatenate(([0.0], np.cumsum(turned, out=turned)))
    return angle
