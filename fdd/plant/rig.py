"""What the rig has around an axis: the load on its rod, valves, charging and external accumulators.

Positive force acts against extension. Openings of valves are programmes over time, so that an experiment can
move one while the axis runs (thesis 4.6, Table 4.12); which settings contradict each other is said in
`fdd.plant.scenario`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field
from scipy.signal import butter, sosfilt

from fdd.errors import InputError
from fdd.plant import SHUT, AnyProgramme, Array, Programme, Ranges, ShareProgramme, Validated
from fdd.plant import conditions as c
from fdd.unit import Unit

_CONTROL_RATE = 1000.0


class Load(Validated):
    """What every load has; the plant reads the parameters of its kind by name: `rate` (N/m) of a spring,
    which is slack at `slack` (m), its `gap`, an `added` mass, a throttle's `pressure`."""

    usual: ClassVar[Ranges] = {}
    """Ranges that a campaign draws from."""

    def force(self, n: int, rng: np.random.Generator) -> Array:
        """(n,) N, the part that depends on time alone, one value per millisecond."""
        return np.zeros(n)


class NoLoad(Load):
    """A free rod."""

    name: Literal["none"] = "none"


class ConstantLoad(Load):
    """A weight: `level` newton, from the start of the log."""

    usual: ClassVar[Ranges] = {"level": (-2500.0, 2500.0)}
    name: Literal["constant"] = "constant"
    level: Annotated[float, Field(ge=-1e6, le=1e6)] = 1000.0

    def force(self, n: int, rng: np.random.Generator) -> Array:
        return np.full(n, self.level)


class SpringLoad(Load):
    """A spring, as an elastic surface or a specimen gives it."""

    usual: ClassVar[Ranges] = {"rate": (3e3, 4e4), "slack": (-0.03, 0.03)}
    name: Literal["spring"] = "spring"
    rate: Annotated[float, Field(gt=0.0, le=1e9)] = 1.5e4
    """N/m."""
    slack: Annotated[float, Field(ge=-1.0, le=1.0)] = 0.0
    """m, position without force."""


class PressLoad(SpringLoad):
    """A workpiece that is pressed: a spring beyond the place where the rod touches it, and nothing before."""

    usual: ClassVar[Ranges] = {"rate": (1e4, 2e5), "slack": (-0.03, 0.05)}
    name: Literal["press"] = "press"  # type: ignore[assignment]
    rate: Annotated[float, Field(gt=0.0, le=1e9)] = 5e4
    """N/m."""


class HingeLoad(SpringLoad):
    """A spring, as that of a surface, behind a hinge with play."""

    usual: ClassVar[Ranges] = {"rate": (3e3, 4e4), "slack": (-0.03, 0.03), "gap": (2e-4, 3e-3)}
    name: Literal["hinge"] = "hinge"  # type: ignore[assignment]
    gap: Annotated[float, Field(ge=0.0, le=0.1)] = 1e-3
    """m of play, from stop to stop."""


class InertiaLoad(Load):
    """More mass on the rod."""

    usual: ClassVar[Ranges] = {"added": (5.0, 100.0)}
    name: Literal["inertia"] = "inertia"
    added: Annotated[float, Field(ge=0.0, le=1e6)] = 30.0
    """kg."""


class GustLoad(Load):
    """Coloured noise on a surface that is held back by the air stream."""

    usual: ClassVar[Ranges] = {
        "deviation": (100.0, 900.0), "bandwidth_hz": (0.3, 6.0), "level": (-800.0, 800.0),
        "rate": (0.0, 1.5e4),
    }  # fmt: skip
    name: Literal["gust"] = "gust"
    deviation: Annotated[float, Field(ge=0.0, le=1e6)] = 400.0
    """N, standard deviation of the force."""
    bandwidth_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 2.0
    level: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    """N, mean."""
    rate: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """N/m, of the air stream."""

    def force(self, n: int, rng: np.random.Generator) -> Array:
        lead = int(min(2.0 / self.bandwidth_hz, 20.0) * _CONTROL_RATE)
        sections = butter(2, self.bandwidth_hz, fs=_CONTROL_RATE, output="sos")
        noise = np.asarray(sosfilt(sections, rng.standard_normal(n + lead)))[lead:]
        # White noise through a second-order Butterworth keeps 1.11 of its corner's share.
        share = np.sqrt(1.1107 * self.bandwidth_hz / (0.5 * _CONTROL_RATE))
        return self.level + self.deviation * noise / share


class ChangingLoad(Load):
    """A force that changes on the way: its mean, and how much it is gusty, over time."""

    usual: ClassVar[Ranges] = {
        "level": (-2000.0, 2000.0), "deviation": (0.0, 600.0), "bandwidth_hz": (0.3, 6.0),
    }  # fmt: skip
    name: Literal["changing"] = "changing"
    level: AnyProgramme = Programme(points=((0.0, 0.0), (60.0, 0.0), (60.0, 1000.0)))
    """N, mean."""
    deviation: AnyProgramme = Programme(points=((0.0, 0.0),))
    """N, standard deviation."""
    bandwidth_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 2.0

    def force(self, n: int, rng: np.random.Generator) -> Array:
        time = np.arange(n) / _CONTROL_RATE
        noise = GustLoad(deviation=1.0, bandwidth_hz=self.bandwidth_hz).force(n, rng)
        return self.level.over(time) + self.deviation.over(time) * noise


class ThrottleLoad(Load):
    """A partner cylinder on the same rod whose ports are joined through a throttle.

    Its drop is quadratic in flow, Δp = R·Q|Q|, behind the partner's own compressibility.
    """

    usual: ClassVar[Ranges] = {"pressure": (0.2e6, 3.0e6)}
    name: Literal["throttle"] = "throttle"
    pressure: Annotated[float, Field(gt=0.0, le=1e10)] = 1.0e6
    """Pa over the throttle when this axis's pump turns at 100 rad/s without leakage."""


AnyLoad = Annotated[
    NoLoad | ConstantLoad | SpringLoad | PressLoad | HingeLoad | InertiaLoad | GustLoad | ChangingLoad
    | ThrottleLoad,
    Field(discriminator="name"),
]  # fmt: skip

LOADS: dict[str, type[Load]] = {
    kind.model_fields["name"].default: kind for kind in get_args(get_args(AnyLoad)[0])
}

RATED_PRESSURE = 10.34e6
"""Pa, gauge: rated pressure of the system (4.6.3)."""

WHERE = "scenario valves"
"""Where messages say that contradictory valves stand."""

ValveFlow = Annotated[float, Field(gt=0.0, le=1e-3)]


class ExternalAccumulators(Validated):
    """The variable bulk modulus circuit (assembly 3): one accumulator on each chamber.

    Gas and added volume soften the chambers; the circuit's relief valve opens at 9.65 MPa.

    Attributes
    ----------
    gas_charge : Pa, gauge, of the nitrogen without oil; "no more than 9.30 MPa" (4.6.3).
    gas_volume : m³ of each, Table 4.15's Hawe AC13.
    valve_flow : m³/s at 1 MPa through each flow control valve as it is set (FC08-20F). Assumption:
        2e-5 lets the accumulator follow slow pressure changes and hides it from fast ones.
    """

    gas_charge: Annotated[float, Field(ge=1e4, le=9.30e6)] = 4.0e5
    gas_volume: Annotated[float, Field(ge=1e-7, le=1e-3)] = 13e-6
    valve_flow: Annotated[float, Field(ge=0.0, le=1e-3)] = 2e-5


class Circuit(Validated):
    """Valves and auxiliary circuits of one axis, as they are set and moved in a run.

    Attributes
    ----------
    blocked : the ball valve between pump and cylinder is shut (assembly 7); manual, so for a whole run.
    bypass : opening of the by-pass across the cylinder (figure 4.2's decoupling valve). The rig's sits
        in the pump block (4.5); the plant has it beside the throttle, which differs only where `blocked`.
    bypass_flow : m³/s at 1 MPa when fully open; 137 kPa at 1.39e-4 m³/s (4.4, SV08-24), quadratic.
    throttle : opening of the throttling valve across the cylinder, behind its ball valve (assembly 8).
    throttle_flow : m³/s at 1 MPa when fully open. Assumption: the pump's 1.75e-4 m³/s at
        0.34 MPa, about what friction alone takes.
    external_leakage : opening of the external leakage valve (assembly 2).
    external_leakage_side : chamber that it is connected to.
    external_leakage_coefficient : m³/(s·Pa) when fully open, taken as laminar. Assumption: at 0.5 MPa
        the accumulator's 13 cm³ leave within a second, "real-time discharging" (4.6.4).
    charging : share of the charging pump's speed (assembly 4).
    charging_displacement : m³/rad of that pump, Table 4.16.
    charging_speed : rad/s of its motor at 1; the drive's own 3000 rpm.
    charging_pressure : Pa, gauge, set value of the charging circuit's relief valve. The gauge charge
        of the thesis goes up to 689 kPa; the rig's relief valve to 9.65 MPa.
    accumulators : the bulk-modulus circuit, where it is connected.

    Examples
    --------
    >>> import numpy as np
    >>> Circuit(throttle="0:1/5:0.2").throttle.over(np.array([0.0, 5.0]))
    array([1. , 0.2])
    """

    blocked: bool = False
    bypass: ShareProgramme = SHUT
    bypass_flow: ValveFlow = 3.76e-4
    throttle: ShareProgramme = SHUT
    throttle_flow: ValveFlow = 3e-4
    external_leakage: ShareProgramme = SHUT
    external_leakage_side: Annotated[int, Field(ge=1, le=2)] = 1
    external_leakage_coefficient: Annotated[float, Field(gt=0.0, le=1e-9)] = 3e-11
    charging: ShareProgramme = SHUT
    charging_displacement: Annotated[float, Field(gt=0.0, le=1e-5)] = 2.83e-7
    charging_speed: Annotated[float, Field(gt=0.0, le=2000.0)] = 314.16
    charging_pressure: Annotated[float, Field(ge=0.0, le=9.65e6)] = 6.89e5
    accumulators: ExternalAccumulators | None = None

    @property
    def passes(self) -> bool:
        """Whether oil can ever go from one side of the cylinder to the other over this axis's valves."""
        return self.bypass.most > 0.0 or self.throttle.most > 0.0


class Connect(Validated):
    """The connect valves between both axes (assembly 6).

    Attributes
    ----------
    line_1, line_2 : opening of the valve between both axes' lines 1, and 2.
    flow : m³/s at 1 MPa through each when fully open. Assumption: a pump's 1.75e-4 m³/s at 0.12 MPa.
    """

    line_1: ShareProgramme = SHUT
    line_2: ShareProgramme = SHUT
    flow: ValveFlow = 5e-4

    @property
    def open(self) -> bool:
        """Whether either valve ever opens."""
        return self.line_1.most > 0.0 or self.line_2.most > 0.0

    @property
    def joined(self) -> bool:
        """Whether both valves open: only then can one axis's pump move the other's oil to and fro."""
        return self.line_1.most > 0.0 and self.line_2.most > 0.0


def apply(circuit: Circuit, rows: Array, time: Array) -> None:
    """Write an axis's valves into its conditions (n, COLUMNS) at `time` (n,) s, in place."""
    across = circuit.bypass.over(time) * circuit.bypass_flow
    rows[:, c.BYPASS] += across + circuit.throttle.over(time) * circuit.throttle_flow
    outside = c.OUTSIDE_1 if circuit.external_leakage_side == 1 else c.OUTSIDE_2
    rows[:, outside] += circuit.external_leakage.over(time) * circuit.external_leakage_coefficient
    full = circuit.charging_displacement * circuit.charging_speed
    rows[:, c.CHARGE] += circuit.charging.over(time) * full


def apply_connect(connect: Connect, rows: Array, time: Array) -> None:
    """Write the connect valves into the first axis's conditions, in place; as `apply`."""
    rows[:, c.CONNECT_1] += connect.line_1.over(time) * connect.flow
    rows[:, c.CONNECT_2] += connect.line_2.over(time) * connect.flow


def check_charging(circuit: Circuit, unit: Unit, charge_factor: float = 1.0) -> None:
    """Refuse charging without flow, or beyond the rated pressure without the circuit that protects."""
    if circuit.charging.most == 0.0:
        return
    charge = unit.accumulator.charge_pressure * charge_factor
    told = f"charging to {circuit.charging_pressure / 1e6:g} MPa"
    if circuit.charging_pressure <= charge:
        problem = f"{told} adds nothing to a charge of {charge / 1e6:g} MPa"
        raise InputError(problem, where=WHERE, mend="raise charging_pressure or lower charge_factor")
    together = circuit.charging_pressure + unit.accumulator.relief_pressure
    if together > RATED_PRESSURE and circuit.accumulators is None:
        raise InputError(
            f"{told} below relief valves of {unit.accumulator.relief_pressure / 1e6:g} MPa exceeds the rated "
            f"{RATED_PRESSURE / 1e6:g} MPa",
            where=WHERE,
            mend="lower charging_pressure or connect the accumulators, whose relief valve protects",
        )
