"""Structures: kinds of machines that a recipe draws from; conditions: how single logs depart from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from fdd.campaign.population import Range, Rng, Share, Weight, drawn, spread
from fdd.campaign.sizes import OIL_TEMPERATURES, Size, sized_unit, with_accumulator
from fdd.errors import InputError, input_error
from fdd.plant import Validated
from fdd.plant.details import Details
from fdd.plant.sensors.recording import Recording
from fdd.sections import Sensor
from fdd.unit import Unit

if TYPE_CHECKING:
    from fdd.campaign.recipe import Recipe

POLES = ("pole_1", "pole_2", "zero")
Part = Annotated[str, Field(pattern="^(cylinder|pump|oil|accumulator|drive)$")]
Error = Annotated[str, Field(pattern="^(noise|resolution|bandwidth_hz)$")]
EQUAL = 0.97
"""Ratio of areas from which on a pump can feed both chambers without piloted valves."""


class Departure(Validated):
    """What differs from the recipe; None leaves it as it is there.

    `weight` is its share among its likes, `loop` a factor on the poles and the zero of the drive's velocity
    loop, as one tuned anew has them, and `noise` one on the noise of all sensors.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-]{1,40}$")]
    weight: Weight = 1.0
    duties: dict[str, Weight] | None = None
    loads: dict[str, Weight] | None = None
    oil_temperature: Range | None = None
    warming: Range | None = None
    charge_factor: Range | None = None
    position_gain: Range | None = None
    speed_control_share: Share | None = None
    loop: Range = (1.0, 1.0)
    noise: Range = (1.0, 1.0)

    def applied(self, recipe: Recipe) -> Recipe:
        """The recipe with what this changes."""
        own = [n for n in Departure.model_fields if n not in ("name", "weight", "loop", "noise")]
        changed = {n: getattr(self, n) for n in own if getattr(self, n) is not None}
        return recipe.model_copy(update=changed) if changed else recipe

    def changed(self, unit: Unit, rng: Rng) -> Unit:
        """The unit with its loop tuned anew and its sensors noisier."""
        loop, noise = spread(rng, self.loop), spread(rng, self.noise)
        if loop == noise == 1.0:
            return unit
        poles = {name: loop * getattr(unit.drive, name) for name in POLES}
        sensors = {c: s.model_copy(update={"noise": noise * s.noise}) for c, s in unit.sensors.items()}
        return unit.model_copy(update={"drive": unit.drive.model_copy(update=poles), "sensors": sensors})


class Condition(Departure):
    """How some logs depart from the recipe: warm, cold, little charge, a loop tuned anew, more noise."""


class Structure(Departure):
    """A kind of machine and of its instruments.

    Attributes
    ----------
    base : shipped profile (or path) that is varied; None takes the recipe's, in turn. Not with `size`.
    size : of a machine that is drawn as a whole instead.
    profile : section to field to the range that it is drawn from, on top of base or size.
    details : of the plant (`fdd.plant.details.Details`): a range, or the name of a law.
    sensors : channel to field to range.
    rate, speed, channels : of the log, see `fdd.plant.sensors.recording.Recording`.
    baseline_kind : None takes the recipe's.
    """

    base: str | None = None
    size: Size | None = None
    profile: dict[Part, dict[str, Range]] = Field(default_factory=dict)
    details: dict[str, Range | str] = Field(default_factory=dict)
    sensors: dict[str, dict[Error, Range]] = Field(default_factory=dict)
    rate: Literal[200, 500, 1000, 2000] = 1000
    speed: Literal["counts", "sampled"] = "counts"
    channels: tuple[str, ...] | None = None
    baseline_kind: Literal["identification", "ordinary"] | None = None

    @model_validator(mode="after")
    def _possible(self) -> Structure:
        where = f"structure {self.name}"
        if self.base is not None and self.size is not None:
            raise InputError("base and size are both given", where=where, mend="leave one out")
        example = Unit.load("axis_a")
        for part, fields in self.profile.items():
            section = getattr(example, part)
            for end in (0, 1):
                values = {n: bounds[end] for n, bounds in fields.items()}
                try:
                    type(section).model_validate({**section.model_dump(exclude={"provenance"}), **values})
                except ValidationError as error:
                    raise input_error(error, f"{where} profile {part}", "correct that range") from None
        for end in (0, 1):
            Details(**{n: v if isinstance(v, str) else v[end] for n, v in self.details.items()})
        self.recording(Recording())
        pilot = self.details.get("pilot_ratio", (0.0, 0.0))
        piloted = not isinstance(pilot, str) and pilot[0] > 0.0
        if self.size is not None and self.size.area_ratio[0] < EQUAL and not piloted:
            problem = f"an area ratio of {self.size.area_ratio[0]:g} without piloted valves"
            mend = "give details a pilot_ratio, or the oil of the larger chamber has nowhere to go"
            raise InputError(problem, where=where, mend=mend)
        return self

    def recording(self, recording: Recording) -> Recording:
        """How the logs of these machines are taken."""
        own = {"rate": self.rate, "speed": self.speed, "channels": self.channels}
        return Recording(**{**recording.model_dump(), **own})

    def data_sheet(self, base: str, rng: Rng, oil_temperatures: Range = OIL_TEMPERATURES) -> Unit:
        """The profile that a unit is varied from: the base's or a drawn machine's, whose accumulator outlasts
        `oil_temperatures` (°C), and what is on top."""
        sized = None if self.size is None else sized_unit(self.size, rng, oil_temperatures)
        unit = sized or Unit.load(self.base or base)
        parts = {
            name: getattr(unit, name).model_copy(update={**drawn(rng, ranges), "provenance": {}})
            for name, ranges in self.profile.items()
        }
        unit = unit.model_copy(update=parts)
        if self.size is not None and "oil" in parts and "accumulator" not in parts:
            unit = with_accumulator(unit, oil_temperatures)  # softer oil asks for more of it
        sensors = dict(unit.sensors)
        for channel, ranges in self.sensors.items():
            known = sensors[channel].model_dump(exclude={"source", "lines"})
            sensors[channel] = Sensor(**{**known, **drawn(rng, ranges)})
        described = f"{unit.description} Structure {self.name}."
        unit = unit.model_copy(update={"sensors": sensors, "description": described})
        return Unit.from_yaml(self.changed(unit, rng).to_yaml())

    def drawn_details(self, usual: dict[str, Any], rng: Rng) -> dict[str, Any]:
        """Details of the plant: the usual draw, and what this structure has instead."""
        own = {n: v if isinstance(v, str) else spread(rng, v) for n, v in self.details.items()}
        return {**usual, **own}
