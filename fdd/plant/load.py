"""Loads on the rod. Positive force acts against extension."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import Field
from scipy.signal import butter, sosfilt

from fdd.plant import AnyProgramme, Array, Programme, Ranges, Validated

_CONTROL_RATE = 1000.0


class Load(Validated):
    """What the plant reads of every load, from its kind's own parameters; `force` goes with time."""

    usual: ClassVar[Ranges] = {}
    """Ranges that a campaign draws from."""

    @property
    def stiffness(self) -> float:
        """N/m of a spring on the rod."""
        return getattr(self, "rate", 0.0)

    @property
    def centre(self) -> float:
        """m, where that spring is slack."""
        return getattr(self, "slack", 0.0)

    @property
    def one_sided(self) -> bool:
        """Whether the spring only presses."""
        return isinstance(self, PressLoad)

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
