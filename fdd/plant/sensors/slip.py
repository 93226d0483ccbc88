"""A position encoder that slips: its zero walks. Controller and log must see the same walk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors.recording import PERIOD
from fdd.plant.sensors.streams import generator

Array = NDArray[np.float64]

SLIP = "position_sensor_slip"
SLIPS_PER_SECOND = 1.0
SLIP_STEP = 1e-3
"""m, mean size of a slip at severity 1: with one a second, 1 % of the travel at 0.1 m/s."""
PLAY = 5e-3
"""m; the reader head's clamp ends the walk on either side (assumption), so that strokes stay possible."""
_AT_ONCE = 256


class PositionSlip:
    """Offset of the position encoder: slips at random times, of random sign and size.

    The reader head, or the rail that couples it to the rod (thesis A.1.2, figure A.4), slips in its clamp: at
    times of a Poisson process the zero jumps by ``severity·SLIP_STEP`` times 0.5 to 1.5, to either
    side, and stays where it then is; walls at ± `PLAY` reflect it. It depends on time and seed alone, not on
    the motion, so that plant and log can each ask for it. An assumption: the thesis tells of no slip.

    Parameters
    ----------
    spec : the fault. seed : of the scenario.
    stream : tells the axes of one scenario apart.

    Examples
    --------
    >>> spec = FaultSpec.model_construct(fault=SLIP, severity=1.0, onset=1.0, profile="step")
    >>> slip = PositionSlip(spec, seed=3)
    >>> slip.offset(0, 1000).any(), slip.offset(0, 60_000).any()
    (np.False_, np.True_)
    """

    def __init__(self, spec: FaultSpec, seed: int, stream: str = "") -> None:
        self.spec = spec
        self._rng = generator(seed, f"position slip{stream}")
        # Rows at which the zero jumps and where it is from then on; the first is where it begins.
        self._rows = [0]
        self._offsets = [0.0]
        self._time = 0.0

    def offset(self, first_row: int, n: int) -> Array:
        """Metres that the encoder shows too much in rows ``first_row`` to ``first_row + n - 1``, (n,)."""
        while self._rows[-1] < first_row + n:
            self._slip_on()
        rows = np.arange(first_row, first_row + n)
        at = np.searchsorted(np.array(self._rows), rows, side="right") - 1
        return np.array(self._offsets)[at]

    def _slip_on(self) -> None:
        """Draw the next slips; always as many, so that the walk does not depend on who asks for how much."""
        times = np.cumsum(np.append(self._time, self._rng.exponential(1.0 / SLIPS_PER_SECOND, _AT_ONCE)))[1:]
        sizes, sides = self._rng.random(_AT_ONCE), self._rng.random(_AT_ONCE)
        rows = np.ceil(times / PERIOD).astype(np.int64)
        severity = self.spec.over(rows.astype(np.float64) * PERIOD)
        steps = severity * SLIP_STEP * (0.5 + sizes) * np.where(sides < 0.5, 1.0, -1.0)
        offset = self._offsets[-1]
        for step in steps.tolist():
            offset += step
            if abs(offset) > PLAY:
                offset = (2.0 * PLAY - abs(offset)) * (1.0 if offset > 0.0 else -1.0)
            self._offsets.append(offset)
        self._rows += rows.tolist()
        self._time = float(times[-1])


def position_offset(faults: list[FaultSpec], first_row: int, n: int, seed: int, stream: str = "") -> Array:
    """What slipping adds to the position encoder's reading in n rows from `first_row` on, (n,) m.

    A column of it belongs to the position controller: its encoder reads ``gain·x + zero + offset``, rounded.
    The log's position has the same offset. All zero without the fault.

    Parameters
    ----------
    faults : of the scenario (of this axis). seed : of the scenario. stream : as the recorder's.

    Examples
    --------
    >>> position_offset([], 0, 3, seed=1)
    array([0., 0., 0.])
    """
    total = np.zeros(n)
    for spec in faults:
        if spec.fault == SLIP:
            total += PositionSlip(spec, seed, stream).offset(first_row, n)
    return total
