"""A scenario: everything about one simulated run beside the unit, validated; and as a YAML file.

`_check_valves` refuses settings of the rig's valves that contradict each other (thesis, 4.6). Allowed are:

- charging with external leakage open: how static pressure is varied in real time (4.6.4);
- throttle or by-pass on a driving axis: how 4.6.8 injects internal leakage. Where it passes the pump's whole
  flow the axis stands and its loop saturates, which harms nothing;
- one connect valve of two, which relieves one line (4.6.6); to drive the other's cylinder a pump needs both;
- a blocked first axis in speed control: its pump works against its relief valve;
- a partner that is still, its valves shut, or valves shut for a part of the run: up to the relief valves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from fdd.bounds import MAX_SCENARIO_BYTES
from fdd.errors import InputError
from fdd.plant import FULL, ShareProgramme, Validated
from fdd.plant.details import Details
from fdd.plant.duty import AnyDuty, ConstantSpeed, Standstill, Steps
from fdd.plant.faults import FaultScales, FaultSpec
from fdd.plant.oil import ATMOSPHERE
from fdd.plant.rig import WHERE, AnyLoad, Circuit, Connect, NoLoad
from fdd.plant.sensors.recording import Recording
from fdd.yaml_reading import yaml_mapping, yaml_text

SCENARIO_SCHEMA = "fdd.scenario/1"
"""``schema`` of a scenario file; may be left out."""

_MEND = "give a YAML file with a scenario's fields: duration, duty, faults, partner, …"


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


class Partner(Validated):
    """The axis whose cylinder sits on the same rod (thesis 4.3: two actuators in series).

    Attributes
    ----------
    unit : name of its unit, kept with the data; `simulate` takes the unit itself.
    drive : same (the first axis's speed command), still (a command of zero, the motor holding) or
        own (the open-loop speeds of `duty`).
    duty : for drive own.
    power : share of the motor's current limit; 0 is a motor without power, which the oil turns.
    circuit : its valves.
    """

    unit: str = "axis_b"
    drive: Literal["same", "still", "own"] = "same"
    duty: AnyDuty | None = None
    power: ShareProgramme = FULL
    circuit: Circuit = Circuit()

    @model_validator(mode="after")
    def _driven(self) -> Partner:
        if (self.drive == "own") != (self.duty is not None):
            problem = "drive own needs a duty" if self.drive == "own" else f"drive {self.drive} takes no duty"
            raise InputError(problem, mend="give drive own and a duty together")
        if isinstance(self.duty, ConstantSpeed):
            problem = "the partner cannot do constant_speed: it turns at its own encoder"
            raise InputError(problem, mend="use steps, levels or another duty of given speeds")
        return self


class Scenario(Validated):
    """One run; an `InputError` names the field that is not possible, and what is allowed.

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
        seconds (`fdd.plant.prepare.FRICTION_TIME`); 0 keeps it steady.
    faults : any number, each kind at most once for each axis.
    fault_scales : what severity 1 is in figures.
    power : share of the first axis's current limit; 0 is a motor without power.
    circuit : the first axis's valves.
    partner : second axis of a dual rig, on the same rod; None for a single one.
    connect : valves between both axes.
    recording : dropped rows, late stamps, NaN.
    details : of the plant, which no unit profile knows.
    seed : fixes everything random.

    Examples
    --------
    >>> Scenario(duration=5.0, faults=[{"fault": "aeration", "severity": 0.5, "onset": 2.0}]).faults[0].family
    'aeration'
    """

    unit: str = "axis_a"
    duration: Annotated[float, Field(ge=0.01, le=3600.0)] = 60.0
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
        _check_valves(self)
        if isinstance(self.duty, ConstantSpeed) and self.control.mode != "speed":
            problem = "duty constant_speed needs speed control"
            raise InputError(problem, mend="set control mode to speed, or use strokes")
        final = self.oil_temperature + self.warming * self.duration
        if not -40.0 <= final <= 140.0:
            problem = f"the oil would end at {final:.0f} °C"
            raise InputError(problem, mend="lower warming; -40 to 140 °C is modelled")
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
            problem = f"fault {spec.fault}: onset {spec.onset:g} s is past the end, {scenario.duration:g} s"
            raise InputError(problem, mend="set an earlier onset or a longer duration")
        if spec.axis == 2 and scenario.partner is None:
            problem = f"fault {spec.fault}: there is no axis 2"
            raise InputError(problem, mend="leave axis out or give a partner")
        if (spec.fault, spec.axis) in seen:
            problem = f"fault {spec.fault} is given twice for axis {spec.axis}"
            raise InputError(problem, mend="give it once for each axis")
        seen.add((spec.fault, spec.axis))


def _check_valves(scenario: Scenario) -> None:
    """Refuse what contradicts itself; charging against a unit's pressures is `check_charging`'s."""
    partner, circuit, connect = scenario.partner, scenario.circuit, scenario.connect

    def refused(problem: str, mend: str, where: str = WHERE) -> InputError:
        return InputError(problem, where=where, mend=mend)

    if partner is None:
        if connect.open:  # 4.6.6
            raise refused("a connect valve is open but there is no partner", "shut connect or give a partner")
        if circuit.blocked:
            mend = "open its ball valve (blocked: false) or give a partner"
            raise refused("the axis is blocked and no partner moves its cylinder", mend)
        return
    if scenario.load.name == "throttle":
        raise refused(
            "load throttle stands for a throttled partner, and there is a partner",
            "open the partner's own throttle instead, with another load",
            "scenario load",
        )
    if circuit.blocked and partner.circuit.blocked:  # 4.6.7
        raise refused("both axes are blocked: no pump reaches a cylinder", "open one of the ball valves")
    asked = not isinstance(scenario.duty, Standstill)
    first = asked and scenario.power.most > 0.0
    second = partner.power.most > 0.0 and (
        asked if partner.drive == "same" else not isinstance(partner.duty, Standstill | None)
    )
    for name, valves, driven in (("first axis", circuit, second), ("partner", partner.circuit, first)):
        # The connect valves lie on the pumps' side: they are no way out (4.6.7).
        driven = (first or second) if connect.joined else driven
        if valves.blocked and driven and not valves.passes:
            raise refused(
                f"hydraulic lock: the {name} is blocked, its throttle and by-pass are shut, and its cylinder "
                "is driven by the other's",
                "open its throttle or by-pass",
            )
    by_position = scenario.control.mode == "position" and partner.drive != "same"
    if circuit.blocked and by_position and not connect.joined:
        raise refused(
            "the first axis is blocked: its position loop would not see what its pump does",
            "use speed control, partner drive same, or open both connect valves",
        )
    if min(circuit.charging.most, partner.circuit.charging.most) > 0.0:  # 4.6.4
        raise refused(
            "both axes are being charged, and the rig has one charging pump",
            "charge one of them; they share the accumulator",
        )


def scenario_data(path: str | Path) -> dict[str, Any]:
    """The fields that a scenario file gives, not yet validated; refuses what is no YAML of this schema."""
    path = Path(path)
    text = yaml_text(path, "scenario", MAX_SCENARIO_BYTES, _MEND)
    data = yaml_mapping(text, path, "scenario", mend=_MEND)
    schema = data.pop("schema", SCENARIO_SCHEMA)
    if schema != SCENARIO_SCHEMA:
        raise InputError(f"schema {schema!r:.60} is not a scenario", where=path, mend=_MEND)
    return data
