"""Lost supplies: channels that fall silent at the same instant share a supply that failed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.limits import INDEX, NAMES, NOT_MEASURED, Limits, figure
from fdd.sensors.memory import Memory
from fdd.sensors.sensor_findings import SAME_INSTANT_S, SensorFindings

Mask = NDArray[np.bool_]

SILENT_S = 5.0
"""Noise that is there shows within some rows; this leaves time for a converter that starts late."""


class SupplyWatch:
    """Look for silence that several channels share.

    Parameters
    ----------
    limits : of the unit. memory : what is kept. findings : where they go.
    """

    def __init__(self, limits: Limits, memory: Memory, findings: SensorFindings) -> None:
        self.limits, self.memory, self.findings = limits, memory, findings

    def silent_from_start(self, end: float, failing: Mask) -> None:
        """Two or more channels that the profile gives noise, and none of them ever showed any.

        One alone may have a profile that is wrong; it is judged when the pump turns.
        """
        memory = self.memory
        alive = (memory.present > 0) & (self.limits.repeat < 1.0)
        alive[INDEX["pressure_difference"]] &= not self.memory.is_derived(INDEX["pressure_difference"])
        silent = alive & (memory.changed == 0.0) & (end - memory.run_since >= SILENT_S)
        if alive.sum() < 2 or not (silent == alive).all():
            return
        for k in np.flatnonzero(silent).tolist():
            message = (
                f"{NAMES[k]} shows exactly {figure(NAMES[k], memory.run_value[k])} since the log's first row"
            )
            failing[k] = True
            if np.isnan(memory.failed_since[k]):
                memory.failed_since[k] = memory.run_since[k]
                since, value = float(memory.run_since[k]), float(memory.run_value[k])
                self.findings.report(NAMES[k], "dead", since, None, end, value, message, adds=False)

    def lost_together(self, end: float, failing: Mask) -> None:
        """Report a lost supply for channels that fell silent at the same instant."""
        memory = self.memory
        new = [k for k in np.flatnonzero(failing).tolist() if not self.memory.is_derived(k)]
        for k in new:
            onset = float(memory.failed_since[k])
            silent = []
            for j in np.flatnonzero(memory.present > 0).tolist():
                if NAMES[j] in NOT_MEASURED or self.memory.is_derived(j):
                    continue
                fell = failing[j] and abs(memory.failed_since[j] - onset) <= SAME_INSTANT_S
                zero = (
                    memory.run_value[j] == 0.0 and abs(memory.last_value[j]) > 0.0 and memory.run_rows[j] > 1
                )
                fell |= bool(zero and abs(memory.run_since[j] - onset) <= SAME_INSTANT_S)
                if fell:
                    silent.append(j)
            if len(silent) < 2 or self._known_supply(silent):
                continue
            names = tuple(NAMES[j] for j in silent)
            for j in silent:
                failing[j] = True
                if np.isnan(memory.failed_since[j]):
                    memory.failed_since[j] = onset
            message = (
                f"{', '.join(names)} fall silent within {1e3 * SAME_INSTANT_S:.0f} ms: they lost their supply"
            )
            self.findings.merge(names, onset, end, message)

    def _known_supply(self, silent: list[int]) -> bool:
        for f in self.findings.by_onset():
            if (
                f.kind == "supply_loss"
                and f.until_s is None
                and {NAMES[j] for j in silent} <= set(f.channels)
            ):
                return True
        return False
