"""Whether the filters are as good as they claim, run by run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.consistency import nis_band, squared_distance
from estimators.eha import layout

Array = NDArray[np.float64]

LEAST_TESTED = 0.05
"""Channels, mean over a run, below which its NIS says nothing."""
LONGEST_LAG = 200
"""Records up to which an autocorrelation is followed."""


def correlation_time(series: Array) -> float:
    """Integrated autocorrelation time of a series in samples: ``1 + 2 Σ ρ_k``, at least 1.

    A mean over n samples is worth n over this many independent ones. The sum ends where the lag is five times
    what it has come to (Sokal 1997, doi 10.1007/978-1-4899-0319-8_6), since beyond it only noise is added.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> white = rng.standard_normal(40_000)
    >>> round(correlation_time(white)), round(correlation_time(np.convolve(white, np.ones(4))))
    (1, 4)
    """
    if not np.isfinite(series).all():
        return 1.0
    y = series - series.mean()
    power = float(y @ y)
    time = 1.0
    for lag in range(1, min(LONGEST_LAG, y.size - 1)):
        if not power > 0.0 or lag > 5.0 * time:
            break
        time += 2.0 * float(y[:-lag] @ y[lag:]) / power
    return max(1.0, time)


def nis_of_run(
    records: layout.Records, samples_per_record: int, channels: float, driven: float = 0.0
) -> tuple[float, float, float, float]:
    """Mean NIS of a run over its expectation, with the band that 95 % of consistent runs fall in.

    Parameters
    ----------
    records : of the tracker, (n, RECORD).
    samples_per_record : its decimation.
    channels : degrees of freedom of a sample, `evidence.estimators.model.tested_channels`.
    driven : what the other channels add to the NIS, `evidence.estimators.model.encoders_share`.

    Returns
    -------
    mean over `channels`, low and high of the band, and the effective number of samples: how many there are
    over the records' `correlation_time`.
    """
    series = records["nis"]
    effective = series.size * samples_per_record / correlation_time(series)
    if channels < LEAST_TESTED:
        return float("nan"), float("nan"), float("nan"), effective
    degrees = max(int(effective * channels), 1)
    low, high = nis_band(1, degrees)
    return (float(series.mean()) - driven) / channels, low, high, effective


def nees(error: Array, covariance: Array) -> float:
    """Normalised squared error of one estimate; NaN where the covariance is none.

    Examples
    --------
    >>> nees(np.array([2.0, 0.0]), np.diag([4.0, 1.0]))
    1.0
    """
    try:
        return float(squared_distance(error, covariance))
    except ValueError:
        return float("nan")
