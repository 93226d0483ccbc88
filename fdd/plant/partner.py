"""The second axis of a dual rig: what drives it, and its own circuit."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from fdd.errors import InputError
from fdd.plant.circuit import Circuit
from fdd.plant.duty import AnyDuty, ConstantSpeed
from fdd.plant.programme import FULL, ShareProgramme
from fdd.plant.validated import Validated


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

    Raises
    ------
    InputError : a duty without drive own, or the other way round.

    Examples
    --------
    >>> Partner(drive="still", circuit={"bypass": 1}).unit
    'axis_b'
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
            raise InputError(
                "the partner cannot do constant_speed: it turns at its own encoder",
                mend="use steps, levels or another duty of given speeds",
            )
        return self
