"""A unit's healthy baseline: where its residual features lie while nothing is wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.errors import InputError
from fdd.residuals.features import CHANGES, CONTEXT, FEATURE_VERSION, FEATURES
from fdd.residuals.windows import WARM_UP_S, ResidualWindows
from fdd.samples import Samples
from fdd.unit import Baseline, Unit

LEAST_WINDOWS = 5


def add_baseline(unit: Unit, logs: Sequence[Samples]) -> Unit:
    """A copy of the unit with the baseline of these healthy logs.

    The centre is the windows' median. The scale is that of the bulk (median absolute deviation over 0.6745)
    or of the tails (a quarter of the span from 2.3 to 97.7 %), whichever is wider: both are a
    normal distribution's standard deviation, and what a healthy unit does now and then is no fault.

    Parameters
    ----------
    unit : identified profile. logs : the healthy logs that it was identified from.

    Raises
    ------
    InputError : the logs are too short for windows.
    """
    plain = unit.model_copy(deep=True)
    plain.baseline = None
    parts = []
    for log in logs:
        _, features = ResidualWindows(plain).push(log)
        parts.append(features)
    windows = np.concatenate(parts) if parts else np.empty((0, len(FEATURES)))
    if windows.shape[0] < LEAST_WINDOWS:
        raise InputError(
            f"healthy logs give {windows.shape[0]} windows where {LEAST_WINDOWS} are wanted",
            mend=f"record at least {WARM_UP_S + 5:.0f} s of healthy motion",
        )
    centre = np.median(windows, axis=0)
    scale = np.maximum(
        np.median(np.abs(windows - centre), axis=0) / 0.6745,
        np.diff(np.percentile(windows, [2.275, 97.725], axis=0), axis=0)[0] / 4.0,
    )
    context = np.isin(FEATURES, CONTEXT)  # the load of the calibration is no property of the unit
    centre[context] = scale[context] = 0.0
    centre[np.isin(FEATURES, CHANGES)] = 0.0
    out = unit.model_copy(deep=True)
    out.baseline = Baseline(
        features=list(FEATURES),
        centre=[float(f"{v:.6g}") for v in centre],
        scale=[float(f"{v:.6g}") for v in scale],
        windows=int(windows.shape[0]),
        feature_version=FEATURE_VERSION,
    )
    return out
