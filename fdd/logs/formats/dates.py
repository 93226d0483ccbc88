"""Dates and clock times as loggers write them, to seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.logs.formats.signals import seconds_since
from fdd.samples import Column

_CLOCK = r"(?P<clock>\d{1,2}:\d\d(?::\d\d(?P<part>[.,]\d+)?)?)(?P<half> ?[AaPp][Mm])?"
_DAY = r"(?P<a>\d{1,4})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<c>\d{2,4})"
_STAMP = re.compile(rf"(?:{_DAY})?(?P<gap>[T ]|, )?(?:{_CLOCK})?(?P<zone> ?(?:Z|UTC|[+-]\d\d:?\d\d))?")
DAY_S = 86_400.0


def stamp_kind(cell: str) -> str:
    """Whether a cell is a ``day``, a ``clock`` time, ``both``, or (empty) no stamp.

    Examples
    --------
    >>> [stamp_kind(c) for c in ("04.03.2026 10:15", "10:15:02,5", "2026-03-04", "1.5", "")]
    ['both', 'clock', 'day', '', '']
    """
    found = _STAMP.fullmatch(cell.strip())
    if found is None or not (found["a"] or found["clock"]):
        return ""
    return "clock" if not found["a"] else "both" if found["clock"] else "day"


def stamps_to_seconds(texts: Sequence[str | None]) -> tuple[Column, int, list[str]]:
    """Stamps that are written alike, as seconds since the first.

    Parameters
    ----------
    texts : (n,) stamps; None where one is missing. The first tells how all are written.

    Returns
    -------
    (n,) s, NaN where a stamp is missing or written otherwise; ns since 1970 of the first (0 without a
    date); notes.

    Examples
    --------
    >>> stamps_to_seconds(["04.03.2026 10:15:00,25", "04.03.2026 10:15:01"])[:2]
    (array([0.  , 0.75]), 1772619300250000000)
    >>> stamps_to_seconds(["23:59:59.5", "0:00:00.5"])[0].tolist()
    [0.0, 1.0]
    """
    import pandas as pd

    first = next((t for t in texts if t), "")
    found = _STAMP.fullmatch(first.strip())
    if found is None:
        return np.full(len(texts), np.nan), 0, []
    series = pd.Series(list(texts), dtype="str").str.strip()
    if found["part"] or "," in first:
        series = series.str.replace(",", ".", regex=False)
    if found["a"] is None:
        whole = series if found["clock"].count(":") == 2 else series + ":00"
        elapsed = pd.to_timedelta(whole, errors="coerce").to_numpy()
        seconds = elapsed.astype("timedelta64[ns]").astype(np.float64) * 1e-9
        seconds[np.isnat(elapsed)] = np.nan
        # A clock without a date begins again at midnight.
        back = np.nan_to_num(np.diff(seconds, prepend=seconds[:1])) < -0.5 * DAY_S
        seconds = seconds + DAY_S * np.cumsum(back)
        return seconds - np.nanmin(seconds), 0, []
    notes: list[str] = []
    order = ["%Y", "%m", "%d"]
    if len(found["a"]) != 4:
        day_first, notes = _day_first(found, series)
        order = [*(("%d", "%m") if day_first else ("%m", "%d")), "%y" if len(found["c"]) == 2 else "%Y"]
    seconds, start = seconds_since(_parsed(series, found["mark"].join(order), found))
    return seconds, start, notes


def _parsed(series: Any, day: str, found: re.Match[str]) -> NDArray[np.datetime64]:
    import pandas as pd

    clock, half, zone = (found[name] or "" for name in ("clock", "half", "zone"))
    if clock:
        gap, hour = (found["gap"] or "").replace(",", "."), "%I" if half else "%H"
        clock = f"{gap}{hour}:%M" + (":%S" if clock.count(":") == 2 else "")
    after = f"{' ' * half.startswith(' ')}%p" if half else ""
    after += f"{' ' * zone.startswith(' ')}%z" if zone else ""
    read: Any = None
    # A logger leaves the parts of a second out where they are zero.
    for part in (".%f", "") if ":%S" in clock else ("",):
        tried = pd.to_datetime(series, format=f"{day}{clock}{part}{after}", errors="coerce", utc=bool(zone))
        read = tried if read is None else read.fillna(tried)
    if zone:
        read = read.dt.tz_localize(None)
    return np.asarray(read.to_numpy(), dtype="datetime64[ns]")


def _day_first(found: re.Match[str], series: Any) -> tuple[bool, list[str]]:
    """Whether 4/3 is the fourth of March; a dot is German, a slash tells by a number above twelve."""
    if found["mark"] != "/":
        return True, []
    parts = series.str.extract(r"^(\d{1,2})/(\d{1,2})/").astype("Float64").max()
    if float(parts[0]) > 12 or float(parts[1]) > 12:
        return float(parts[0]) > 12, []
    return False, [f"dates such as {found['a']}/{found['b']}/{found['c']} are read as month/day/year"]
