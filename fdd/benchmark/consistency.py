"""Whether the filters are as good as they claim, run by run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from estimators.consistency import nis_band, squared_distance

Array = NDArray[np.float64]

LONGEST_LAG = 200
"""Records up to which an autocorrelation is followed."""


def correlation_time(series: Array) -> float:
    """Integrated autocorrelation time of a series in samples: ``1 + 2 Σ ρ_k``, at least 1.

    A mean over n samples is worth n over this many independent ones. The sum ends at the first pair of lags
    whose autocorrelations add up to less than nothing (Geyer 1992, initial positive sequence, doi
    10.1214/ss/1177011137).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> white = rng.standard_normal(4000)
    >>> round(correlation_time(white)), round(correlation_time(np.convolve(white, np.ones(8))))
    (1, 8)
    """
    if not np.isfinite(series).all():
        return 1.0
    y = series - series.mean()
    power = float(y @ y)
    if not power > 0.0:
        return 1.0
    total = 0.0
    for lag in range(1, min(LONGEST_LAG, y.size - 2), 2):
        pair = float(y[:-lag] @ y[lag:] + y[: -lag - 1] @ y[lag + 1 :]) / power
        if pair <= 0.0:
            break
        total += pair
    return max(1.0, 1.0 + 2.0 * total)


def nis_of_run(
    records: Array, samples_per_record: int, channels: int, driven: float = 0.0
) -> tuple[float, float, float, float]:
    """Mean NIS of a run over its expectation, with the band that 95 % of consistent runs fall in.

    Parameters
    ----------
    records : of the tracker, (n, RECORD).
    samples_per_record : its decimation.
    channels : degrees of freedom of a sample, `fdd.benchmark.model.tested_channels`.
    driven : what the other channels add to the NIS, `fdd.benchmark.model.encoders_share`.

    Returns
    -------
    mean over `channels`, low and high of the band, and the effective number of samples: how many there are
    over the records' `correlation_time`.
    """
    series = records[:, layout.R_NIS]
    effective = series.size * samples_per_record / correlation_time(series)
    low, high = nis_band(channels, max(int(effective), 1))
    return (float(series.mean()) - driven) / channels, low / channels, high / channels, effective


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
