"""The chambers' oil volumes, as far as the compliance's dependence on position tells them.

The balances of `fdd.identification.volume_steps` know only volume over bulk modulus. But the piston moves
that volume by a known amount, so how compliance changes with position, and how the two chambers
differ at one position, tells two more numbers::

    V1 = V0 ((1 + δ) / g + A1 x / V0),   V2 = V0 ((1 - δ) / g - A2 x / V0)

g, the position gain, and δ, the split. They enter the balance nearly linearly: Gauss-Newton, with the
columns by differences, a Cauchy loss (steps with an unmodelled event would otherwise decide) and a wide
prior.

A dead volume within three of the base's own standard deviations explains g; then the volumes are divided by
it, and bulk modulus becomes absolute up to the area. A g farther off is no volume: hoses or walls then give
with position, or the base is another kind of unit. The volumes stay and g is kept
as the profile's `position_compliance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.identification import Estimate
from fdd.identification.balance import OVERLAP, fit_theta
from fdd.identification.volume_steps import LogBalances, Term
from fdd.unit import Unit

ROUNDS = 4
PRIOR_GAIN, PRIOR_SPLIT = 0.5, 0.15
"""Spread of g about 1 and of δ about 0 before the logs are seen."""
VOLUME_SPREAD = 0.15
"""Relative standard deviation of the dead volume among units of one kind: lines and blocks differ."""
VOLUME_SURE = 3.0
STEP = 0.05
GAIN_LIMITS, SPLIT_LIMIT = (0.3, 3.0), 0.4
MOST_POSITION_COMPLIANCE = 5.0
"""That a profile takes."""
FLOOR_GAIN, FLOOR_SPLIT = 0.03, 0.005
"""What the model leaves out; on simulated units with known volumes g is off by 0.03, δ by 0.003 (median)."""
TELLING = 0.15
"""Standard deviation of g up to which the logs tell it: half of what units differ by."""


@dataclass(frozen=True)
class VolumeFit:
    """Position gain and split of the chambers' volumes, and whether the gain is one of volume."""

    gain: Estimate
    split: Estimate

    @property
    def of_volume(self) -> bool:
        """True where the dead volume explains the gain."""
        spread = float(np.hypot(VOLUME_SPREAD, self.gain.std))
        return abs(float(np.log(self.gain.value))) < VOLUME_SURE * spread

    def applied(self, base: Unit) -> Unit:
        """The profile with these volumes (or this position compliance)."""
        unit = _with_volumes(base, self.gain.value if self.of_volume else 1.0, self.split.value)
        if not self.of_volume:
            swept = base.cylinder.position_compliance * self.gain.value
            unit.cylinder.position_compliance = min(swept, MOST_POSITION_COMPLIANCE)
        return unit


def fit_volumes(logs: LogBalances, base: Unit) -> VolumeFit | None:
    """Position gain and split; None where the logs do not tell the gain, or have it beyond a volume's."""
    gain, split = 1.0, 0.0
    std = np.array([PRIOR_GAIN, PRIOR_SPLIT])
    for _ in range(ROUNDS):
        steps = logs.steps(_with_volumes(base, gain, split))
        theta, sigma = fit_theta(logs, steps, base)
        wider = logs.steps(_with_volumes(base, gain * (1.0 + STEP), split)).m
        # At equal compliance in mid-stroke: only what changes with position is the gain's.
        wider[:, Term.STIFF :] *= 1.0 + STEP
        other = logs.steps(_with_volumes(base, gain, split + STEP)).m
        slopes = ((wider - steps.m) @ theta) / (STEP * gain), ((other - steps.m) @ theta) / STEP
        columns = np.column_stack([steps.m, *slopes])
        residual = steps.y - steps.m @ theta
        weights = 1.0 / (1.0 + (residual / (2.0 * sigma)) ** 2)
        unit = OVERLAP * sigma**2
        pull = np.concatenate([np.full(len(Term), 1e-6), [1.0 / PRIOR_GAIN**2, 1.0 / PRIOR_SPLIT**2]]) * unit
        away = np.concatenate([np.zeros(len(Term)), [1.0 - gain, -split]])
        normal = (columns.T * weights) @ columns + np.diag(pull)
        right = columns.T @ (weights * residual) + pull * away
        scale = np.sqrt(np.diag(normal))
        inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-10)
        change = (inverse @ (right / scale)) / scale
        std = (np.sqrt(np.maximum(np.diag(inverse), 0.0) * unit) / scale)[-2:]
        gain = float(np.clip(gain + change[-2], *GAIN_LIMITS))
        split = float(np.clip(split + change[-1], -SPLIT_LIMIT, SPLIT_LIMIT))
    inside = GAIN_LIMITS[0] < gain < GAIN_LIMITS[1] and abs(split) < SPLIT_LIMIT
    if std[0] > TELLING or not inside:  # at a limit: something else than volume bends the balance
        return None
    return VolumeFit(
        Estimate(gain, float(np.hypot(std[0], FLOOR_GAIN * gain))),
        Estimate(split, float(np.hypot(std[1], FLOOR_SPLIT))),
    )


def _with_volumes(base: Unit, gain: float, split: float) -> Unit:
    unit = base.model_copy(deep=True)
    unit.cylinder.volume_1 *= (1.0 + split) / gain
    unit.cylinder.volume_2 *= (1.0 - split) / gain
    return unit
