"""What a log asked of the actuator: much that differs between two logs is that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.history.answers import DutyRow
from fdd.samples import CHANNELS, PRESSURES, Samples

Column = NDArray[np.float64]

SIGNALS = ("position", "pump_speed", *PRESSURES, "motor_current", "load_force", "oil_temperature")
SIGNED = ("position", "oil_temperature")
PERCENTILES = (5.0, 50.0, 95.0)


def column(samples: Samples, channel: str) -> Column:
    """A channel, (n,), NaN where there is none; the pump's speed is its angle's where only that is there.

    Examples
    --------
    >>> log = Samples([0.0, 0.1, 0.2], {"pump_angle": [0.0, 1.0, 2.0]})
    >>> column(log, "pump_speed").tolist()
    [10.0, 10.0, 10.0]
    """
    if channel == "pump_speed" and not has(samples, channel) and "pump_angle" in samples and len(samples) > 1:
        return np.asarray(np.gradient(samples["pump_angle"], samples.time))
    return samples.get(channel)


def has(samples: Samples, channel: str) -> bool:
    """Whether the channel has any value."""
    return channel in samples and bool(np.isfinite(samples[channel]).any())


def duty_rows(a: Samples, b: Samples) -> list[DutyRow]:
    """Percentiles of the signals that either log has."""
    found = [
        DutyRow(signal=name, unit=CHANNELS[name].unit, a=_percentiles(a, name), b=_percentiles(b, name))
        for name in SIGNALS
    ]
    return [row for row in found if row.a is not None or row.b is not None]


def _percentiles(samples: Samples, name: str) -> tuple[float, float, float] | None:
    values = column(samples, name)
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    low, middle, high = np.percentile(values if name in SIGNED else np.abs(values), PERCENTILES)
    return float(f"{low:.5g}"), float(f"{middle:.5g}"), float(f"{high:.5g}")
