"""EKF and SVSF on the reduced EHA model, as one compiled loop over blocks of samples.

A tracker holds its whole state in a few arrays, so results do not depend on how a log
was cut into blocks, and `state` / `restore` carry it across a restart.
"""

from __future__ import annotations

from copy import copy
from typing import Literal

import numpy as np

from estimators.eha import model as eha
from estimators.eha.layout import MEMORY, RECORD, Records
from estimators.eha.loop import MEASUREMENTS, track
from estimators.eha.noise import Noise
from estimators.eha.walk import WALKING, walk_rates
from estimators.linalg import Array

Method = Literal["ekf", "svsf"]


class EhaTracker:
    """Track leakage, bulk modulus and friction of an axis online.

    Parameters
    ----------
    model : of `estimators.eha.model.parameters`.
    noise : process and measurement noise; None takes the defaults.
    method : ``"ekf"``, or ``"svsf"``: the combined EKF-SVSF, which switches to the SVSF
        gain where the optimal boundary layer leaves its limit (Gadsden and Habibi 2013,
        doi 10.1115/1.4006628).
    period : s, nominal sample period.
    pressures : whether both chamber pressures are measured (else their difference).
    angle : whether the pump angle is measured (else the speed is summed up).
    difference : whether the pressure difference has a sensor of its own.
    viscous_friction, viscous_skew : N·s/m, healthy: mean of both directions, and what extending has more.
    air_fraction : volume fraction, healthy; with the former two where the filter starts.
    decimation : samples per record.
    gamma, layer : SVSF memory, and limit of the boundary layer in innovation sigmas: 1.5 times the
        99.9 % quantile of the optimal layer on healthy simulated duties and loads.
    """

    def __init__(
        self, model: eha.Parameters, noise: Noise | None = None, method: Method = "ekf", *,
        period: float = 1e-3, pressures: bool = True, angle: bool = True, difference: bool = True,
        viscous_friction: float = 0.0, viscous_skew: float = 0.0, air_fraction: float = 0.003,
        decimation: int = 10, gamma: float = 0.1, layer: float = 10.0,
    ) -> None:  # fmt: skip
        if method not in ("ekf", "svsf"):
            raise ValueError(f"method is 'ekf' or 'svsf', not {method!r}")
        self.model = copy(model)
        self.noise, self.method, self.decimation = noise or Noise(), method, decimation
        self.period, self.pressures, self.angle = period, pressures, angle
        self.gamma, self.layer = gamma, layer
        c = self._c = self.noise.numbers()
        self.x = np.zeros(eha.STATES)
        self.x[[eha.LEAK, eha.FRIC]] = 1.0
        self.x[eha.AIR] = air_fraction * 1e3
        self.x[eha.VISC], self.x[eha.SKEW] = viscous_friction, viscous_skew
        c.initial_air_split *= pressures
        c.initial_zero *= pressures and difference
        spread = np.zeros(eha.STATES)
        for state, name, unit in WALKING:
            spread[state] = getattr(c, f"initial_{name}") * unit
        spread[[eha.VALVE1, eha.VALVE2]] = c.initial_valve
        spread[eha.LOAD] = c.initial_load
        self._rates = walk_rates(c)
        self.P = np.diag(spread**2)
        self._memory = np.zeros(1, MEMORY)
        self._memory["accumulator_pressure"] = np.nan
        self._memory["viscosity"] = self._memory["unrest"] = 1.0
        self._e_post = np.zeros(MEASUREMENTS)

    def push(self, block: Array) -> Records:
        """Process the rows of a block.

        Parameters
        ----------
        block : (n, 9) time s, position m, pump angle rad, pump speed rad/s, pressures 1 and 2,
            pressure difference, accumulator pressure (Pa), viscosity over the reference's.

        Returns
        -------
        (k,) one `layout.RECORD` per `decimation` samples.
        """
        records = np.empty(block.shape[0] // self.decimation + 1, RECORD)
        n = track(
            np.ascontiguousarray(block, dtype=np.float64), self.period, self.method == "svsf", self.pressures,
            self.angle, self.decimation, self.model, self._c, self._rates, self.x, self.P, self._memory[0],
            self._e_post, self.gamma, self.layer, records,
        )  # fmt: skip
        return records[:n]

    def state(self) -> dict[str, Array]:
        """Everything that changes, as arrays (copies)."""
        return {name: mine.copy() for name, mine in self._changing().items()}

    def _changing(self) -> dict[str, Array]:
        return {"x": self.x, "P": self.P, "memory": self._memory.view(np.float64), "e_post": self._e_post}

    def restore(self, state: dict[str, Array]) -> None:
        """Take a state back that `state` gave."""
        for name, mine in self._changing().items():
            mine[...] = state[name]
