"""A scenario: everything about one simulated run beside the unit, validated."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from fdd.errors import InputError
from fdd.plant.circuit import Circuit, Connect
from fdd.plant.details import Details
from fdd.plant.duty import AnyDuty, ConstantSpeed, Steps
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.load import AnyLoad, NoLoad
from fdd.plant.oil import ATMOSPHERE
from fdd.plant.partner import Partner
from fdd.plant.programme import FULL, ShareProgramme
from fdd.plant.sensors.recording import Recording
from fdd.plant.validated import Validated
from fdd.plant.valves import check_valves

MAX_DURATION = 3600.0
"""s; a millisecond takes about 350 bytes while it is simulated."""


class Control(Validated):
    """How the pump speed is commanded.

    Attributes
    ----------
    mode : position (a P loop on the encoder, thesis 7.2) or speed (no feedback).
    gain : (rad/s)/m of the position loop; its command saturates at the drive's largest speed. The
        thesis's ultimate gain is 33750 (section 7.2), that of its linear models ten times as much.
    rate_gain : (rad/s)/(m/s) taken off the command in position mode, by the encoder differentiated and
        filtered; 0 is the thesis's controller.
    filter_cutoff : rad/s of that filter, a second-order Butterworth (eq. 7.5, `chatter_filter`).
    """

    mode: Literal["position", "speed"] = "position"
    gain: Annotated[float, Field(gt=0.0, le=1e6)] = 16_875.0
    rate_gain: Annotated[float, Field(ge=0.0, le=10_000.0)] = 0.0
    filter_cutoff: Annotated[float, Field(ge=1.0, le=3_000.0)] = 350.0


class Scenario(Validated):
    """One run.

    Attributes
    ----------
    unit : name of the unit, kept with the data; `simulate` takes the unit itself.
    duration : s, one row per millisecond.
    duty, control, load : what is done, how, and against what.
    oil_temperature, warming : °C at the start, and °C/s from then on.
    charge_factor : accumulator charge (gauge) over the unit's; gas and oil at rest keep their volumes.
    accumulator : of a dual rig: shared by both axes as in section 4.3, the first unit's; or one for each.
    ambient : Pa, absolute pressure around the actuator.
    friction_wander : relative standard deviation by which friction drifts within the run, over tens of
        seconds (`fdd.plant.rows.FRICTION_TIME`); 0 keeps it steady.
    faults : any number, each kind at most once for each axis.
    fault_scales : what severity 1 is in figures.
    power : share of the first axis's current limit; 0 is a motor without power.
    circuit : the first axis's valves.
    partner : second axis of a dual rig, on the same rod; None for a single one.
    connect : valves between both axes.
    recording : dropped rows, late stamps, NaN.
    details : of the plant, which no unit profile knows.
    seed : fixes everything random.

    Raises
    ------
    InputError : names the field and what is allowed.

    Examples
    --------
    >>> Scenario(duration=5.0, faults=[{"fault": "aeration", "severity": 0.5, "onset": 2.0}]).faults[0].family
    'aeration'
    """

    unit: str = "axis_a"
    duration: Annotated[float, Field(ge=0.01, le=MAX_DURATION)] = 60.0
    duty: AnyDuty = Steps()
    control: Control = Control()
    load: AnyLoad = NoLoad()
    oil_temperature: Annotated[float, Field(ge=-20.0, le=110.0)] = 40.0
    warming: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    charge_factor: Annotated[float, Field(ge=0.2, le=3.0)] = 1.0
    accumulator: Literal["shared", "each"] = "shared"
    ambient: Annotated[float, Field(ge=15_000.0, le=120_000.0)] = ATMOSPHERE
    friction_wander: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    faults: list[FaultSpec] = Field(default_factory=list)
    fault_scales: FaultScales = FaultScales()
    power: ShareProgramme = FULL
    circuit: Circuit = Circuit()
    partner: Partner | None = None
    connect: Connect = Connect()
    recording: Recording = Recording()
    details: Details = Details()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    @model_validator(mode="after")
    def _together(self) -> Scenario:
        _check_faults(self)
        check_valves(self)
        if isinstance(self.duty, ConstantSpeed) and self.control.mode != "speed":
            raise InputError(
                "duty constant_speed needs speed control", mend="set control mode to speed, or use strokes"
            )
        final = self.oil_temperature + self.warming * self.duration
        if not -40.0 <= final <= 140.0:
            raise InputError(
                f"the oil would end at {final:.0f} °C", mend="lower warming; -40 to 140 °C is modelled"
            )
        return self

    @property
    def rows(self) -> int:
        """Milliseconds in the run."""
        return max(round(self.duration * 1000.0), 1)


def _check_faults(scenario: Scenario) -> None:
    """Every fault within the run, on an axis that is there, once."""
    seen: set[tuple[str, int]] = set()
    for spec in scenario.faults:
        if spec.onset >= scenario.duration:
            raise InputError(
                f"fault {spec.fault}: onset {spec.onset:g} s is past the end, {scenario.duration:g} s",
                mend="set an earlier onset or a longer duration",
            )
        if spec.axis == 2 and scenario.partner is None:
            raise InputError(
                f"fault {spec.fault}: there is no axis 2", mend="leave axis out or give a partner"
            )
        if (spec.fault, spec.axis) in seen:
            raise InputError(
                f"fault {spec.fault} is given twice for axis {spec.axis}", mend="give it once for each axis"
            )
        seen.add((spec.fault, spec.axis))
