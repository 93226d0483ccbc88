"""The volume balance fitted by least squares over a window: the offline fit that an online filter must not
lose to.

Oil that the pump brings and the piston does not take has leaked or is compressed. For chamber 1, with D the
pump's displacement, g its relative error, θ the pump's angle, x the position and A the area::

    D (1 + g) ∫ (1 − ε) dθ − A₁ x = L ∫ q₁ dt + ∫ V₁/β dp₁ + constant
    q₁ = c_x (p₁ − p₂) + c_e (p₁ − p_acc),    ε = ½ ∫ dp/β from p₂ to p₁

and alike for chamber 2; ε is there because the pump moves its displacement at the ports' mean density. With
``1/β = 1/β_stiff + α c(p)`` (thesis eqs 5.20 and 5.21) this is linear in leakage L (over the healthy), free
air α, gain error g and a constant for each stretch in which no check valve fed the chamber. Nothing here is
shared with the estimators but the unit's numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from estimators.eha import model as eha

Array = NDArray[np.float64]

MARGIN = 0.03
"""MPa above the accumulator below which a chamber may be fed."""
SHORTEST = 100
"""Samples of the shortest stretch that counts."""
ATMOSPHERE = 0.101325


@dataclass(frozen=True)
class Window:
    """Signals of one window, (n,) each, in the model's units.

    position (mm), angle (rad), pressure_1, pressure_2, accumulator (MPa), period (ms).
    """

    position: Array
    angle: Array
    pressure_1: Array
    pressure_2: Array
    accumulator: Array
    period: float = 1.0

    @classmethod
    def of_difference(cls, position: Array, angle: Array, difference: Array, accumulator: float) -> Window:
        """Where only the difference is measured: the low side taken at the accumulator's charge."""
        high = np.full(position.size, accumulator)
        return cls(
            position, angle, high + np.maximum(difference, 0.0), high - np.minimum(difference, 0.0), high
        )


def fit_balance(
    window: Window, q: eha.Parameters, *, relief: float = np.inf, sealed: bool = False
) -> tuple[float, float]:
    """Leakage and free air that fit a window best.

    `window`: signals. `q`: parameter array of `estimators.eha.model.parameters`. `relief`: MPa of difference
    from which the relief valves may open: left out too. `sealed`: no chamber is ever fed; else stretches near
    the accumulator's pressure are left out.

    Gives leakage over the healthy one, and free air in ‰; NaN where the window tells nothing.
    """
    area = 0.5 * (q.area_1 + q.area_2)
    drop = window.pressure_1 - window.pressure_2
    shut = np.abs(drop) < relief
    air_1, air_2 = (_air_integral(p, q.polytropic_index) for p in (window.pressure_1, window.pressure_2))
    denser = 0.5 * q.displacement * q.stiff_compliance * _integral(drop, window.angle)
    denser_air = 0.5e-3 * q.displacement * _integral(air_1 - air_2, window.angle)
    parts = []
    for sign, volume, pressure, own_area in (
        (1.0, q.volume_1 + q.area_1 * window.position, window.pressure_1, q.area_1),
        (-1.0, q.volume_2 - q.area_2 * window.position, window.pressure_2, q.area_2),
    ):
        leak = q.cross_port_leakage * sign * drop + q.case_leakage * (pressure - window.accumulator)
        leaked = _integral(leak) * window.period
        pumped = sign * q.displacement * window.angle
        stiff = q.stiff_compliance * _stored(volume, pressure)
        air = 1e-3 * _stored(volume, _air_integral(pressure, q.polytropic_index))
        balance = pumped - denser - sign * own_area * window.position - stiff
        free = shut if sealed else shut & (pressure > window.accumulator + MARGIN)
        columns = np.column_stack([balance, leaked, air + denser_air, -pumped])
        edges = np.flatnonzero(np.diff(free.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        parts += [columns[a:b] - columns[a:b].mean(axis=0) for a, b in edges if b - a >= SHORTEST]
    if not parts:
        return np.nan, np.nan
    table = np.concatenate(parts) / area
    scale = np.sqrt((table[:, 1:] ** 2).mean(axis=0))
    if not (scale > 0.0).all():
        return np.nan, np.nan
    fit, _, rank, _ = np.linalg.lstsq(table[:, 1:] / scale, table[:, 0], rcond=1e-10)
    if rank < 3:
        return np.nan, np.nan
    found = fit / scale
    return float(found[0]), float(found[1])


def _integral(values: Array, over: Array | None = None) -> Array:
    """Running integral over another signal, or over the samples, (n,)."""
    return np.asarray(cumulative_trapezoid(values, over, initial=0.0))


def _stored(volume: Array, inner: Array) -> Array:
    """``∫ V d(inner)`` along the run, by parts so that noise of `inner` is not differentiated."""
    return volume * inner - _integral(inner, volume)


def _air_integral(pressure: Array, n: float) -> Array:
    """Integral of c(p) over gauge pressure (MPa): a polytropic gas's volume, negative."""
    absolute = np.maximum(pressure + ATMOSPHERE, 0.1 * ATMOSPHERE)
    return np.asarray(-(ATMOSPHERE ** (1.0 / n)) * absolute ** (-1.0 / n))
