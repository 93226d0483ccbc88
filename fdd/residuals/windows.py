"""From blocks of samples to windows of features: the part of the pipeline before the classifier.

The first half second is held back to see which channels there are and how fast they come.
Windows lie on a fixed grid from the first sample's time, so they do not depend on how the
samples were cut into blocks.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators import eha_layout as layout
from estimators.observability import Observability, Observed
from fdd.errors import InputError
from fdd.residuals.features import (
    FEATURE_VERSION,
    FEATURES,
    HOP,
    REFERENCE_WINDOWS,
    RESIDUALS,
    WINDOW,
    WINDOW_FEATURES,
    window_features,
)
from fdd.residuals.tracking import METHODS, OBSERVABLE, Channels, Tracking, new_watch, watched
from fdd.samples import CHANNELS, Samples, missing_required
from fdd.unit import Unit

Array = NDArray[np.float64]

HELD_BACK_S = 0.5
WARM_UP_S = 4.0
"""Windows that end earlier only let the filters settle."""
_COMMAND, _CURRENT = layout.COLUMNS, layout.COLUMNS + 1


class ResidualWindows:
    """Run the estimators over blocks and give each full window's features.

    Parameters
    ----------
    unit : profile; features are relative to its baseline, where it has one.
    keep : keep all records of both estimators for trajectories.

    Examples
    --------
    >>> windows = ResidualWindows(Unit.load("axis_a"))
    >>> times, features = windows.push(Samples([0.0], {"position": [0.0]}))
    >>> times.size, features.shape
    (0, (0, 38))
    """

    def __init__(self, unit: Unit, *, keep: bool = False) -> None:
        self.unit = unit
        self.keep = keep
        self.tracking: Tracking | None = None
        self.first_time = np.nan
        self.last_time = np.nan
        self.count = 0
        self._centre = baseline_centre(unit)[: len(WINDOW_FEATURES)]
        self._held: list[Samples] = []
        self._hops = 0
        self._first = np.empty((0, len(RESIDUALS)))
        self._rows = np.empty((0, layout.COLUMNS + 2))
        self._records = {m: np.empty((0, layout.RECORD)) for m in METHODS}
        self._kept: dict[str, list[Array]] = {m: [] for m in METHODS}
        self.last_records = {m: np.empty((0, layout.RECORD)) for m in METHODS}
        self._watch = new_watch()
        self._unwatched: list[Array] = []

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that carry data; empty until enough samples came."""
        return () if self.tracking is None else self.tracking.channels.names

    @property
    def _next_end(self) -> float:
        """End of the next window."""
        return float(self.first_time + WINDOW + HOP * self._hops)

    @property
    def model(self) -> Array:
        """Parameters of the reduced model."""
        assert self.tracking is not None
        return self.tracking.model

    def push(self, samples: Samples) -> tuple[Array, Array]:
        """Take the next block.

        Returns
        -------
        times, features : (m,) ends of the windows that it filled, (m, k) their features.

        Raises
        ------
        InputError : time that does not go on from the last block, or channels that do not
            suffice for a diagnosis.
        """
        nothing = np.empty(0), np.empty((0, len(FEATURES)))
        if not len(samples):
            return nothing
        if samples.time[0] <= self.last_time:
            raise InputError(
                f"channel time: block starts at {samples.time[0]:.6f} s, after {self.last_time:.6f} s",
                mend="push blocks in time order, each sample once",
            )
        if np.isnan(self.first_time):
            self.first_time = float(samples.time[0])
        self.last_time = float(samples.time[-1])
        self.count += len(samples)
        if self.tracking is None:
            self._held.append(samples)
            samples = Samples.concatenate(self._held)
            enough = np.flatnonzero(samples.time - self.first_time >= HELD_BACK_S)
            if not enough.size:
                self._held = [samples]
                return nothing
            # Decide on exactly the held-back span, whatever block brought its end.
            head = samples.rows(0, int(enough[0]) + 1)
            channels = Channels.of(head)
            require_channels(channels.names)
            self.tracking = Tracking(self.unit, channels, float(np.median(np.diff(head.time))))
            self._held = []
        block = self.tracking.block(samples)
        for method, records in self.tracking.push(block).items():
            if records.size:
                self._records[method] = np.concatenate([self._records[method], records])
                self.last_records[method] = records[-1:]
                if self.keep:
                    self._kept[method].append(records)
                if method == "ekf":
                    self._unwatched.append(records)
        if len(self._unwatched) > 30:  # single records, as they come live, cost as much as hundreds
            self._catch_up()
        extra = np.column_stack([samples.get("command"), samples.get("motor_current")])
        self._rows = np.concatenate([self._rows, np.column_stack([block, extra])])
        return self._full_windows()

    def _full_windows(self) -> tuple[Array, Array]:
        assert self.tracking is not None
        ends: list[float] = []
        features: list[Array] = []
        times, records = self._rows[:, layout.TIME], self._records["ekf"]
        # A window is full once a record at or past its end is there.
        while records.size and records[-1, layout.R_TIME] >= self._next_end:
            end = self._next_end
            after = records[np.searchsorted(records[:, layout.R_TIME], end), layout.R_TIME]
            # Over a hole in the log the grid is skipped, not walked.
            self._hops += max(1, math.ceil((after - end) / HOP))
            lo, hi = np.searchsorted(times, [end - WINDOW, end])
            rlo, rhi = np.searchsorted(records[:, layout.R_TIME], [end - WINDOW, end])
            # A hole in the log leaves too little to speak of.
            whole = WINDOW / self.tracking.period
            if end - self.first_time < WARM_UP_S or hi - lo < 0.5 * whole or rhi == rlo:
                continue
            rows = self._rows[lo:hi]
            raw = window_features(
                records[rlo:rhi], rows[:, : layout.COLUMNS], rows[:, _COMMAND], rows[:, _CURRENT],
                self.unit, self.tracking.model, self.tracking.channels,
            )  # fmt: skip
            ends.append(end)
            features.append(self._with_changes(raw - self._centre))
        self._forget()
        return np.array(ends), np.array(features).reshape(-1, len(FEATURES))

    def _with_changes(self, window: Array) -> Array:
        """A window's features and their change since the log's first windows."""
        residuals = window[: len(RESIDUALS)]
        if self._first.shape[0] < REFERENCE_WINDOWS:
            self._first = np.concatenate([self._first, residuals[None, :]])
            return np.concatenate([window, np.zeros(len(RESIDUALS))])
        return np.concatenate([window, residuals - self._first.mean(axis=0)])

    def _forget(self) -> None:
        """Drop rows and records that no later window needs."""
        start = self._next_end - WINDOW
        cut = int(np.searchsorted(self._rows[:, layout.TIME], start))
        if cut:
            self._rows = self._rows[cut:].copy()
        for m in METHODS:
            cut = int(np.searchsorted(self._records[m][:, layout.R_TIME], start))
            if cut:
                self._records[m] = self._records[m][cut:].copy()

    def records(self) -> dict[str, Array]:
        """All records so far of each estimator, (n, RECORD).

        Raises
        ------
        ValueError : made with ``keep=False``.
        """
        if not self.keep:
            raise ValueError("records were not kept: make it with keep=True")
        return {m: np.concatenate(p) if p else np.empty((0, layout.RECORD)) for m, p in self._kept.items()}

    def observed(self) -> dict[str, Observed]:
        """What the EKF's last record tells of each tracked quantity, (1,) each."""
        self._catch_up()
        return self._watch.latest()

    def observed_throughout(self) -> dict[str, Observed]:
        """What all records so far of the EKF told of each tracked quantity, (n,) each.

        Raises
        ------
        ValueError : made with ``keep=False``.
        """
        records = self.records()["ekf"]
        if not records.size:
            nothing: dict[str, Array] = {name: np.empty(0) for name in OBSERVABLE}
            return new_watch().push(np.empty(0), nothing, nothing)
        return self._watched(new_watch(), records)

    def _catch_up(self) -> None:
        if self._unwatched:
            self._watched(self._watch, np.concatenate(self._unwatched))
            self._unwatched = []

    def _watched(self, watch: Observability, records: Array) -> dict[str, Observed]:
        assert self.tracking is not None
        tracker = self.tracking.trackers["ekf"]
        return watched(watch, records, self.unit, tracker.model, tracker.noise)

    def state(self) -> dict[str, Array]:
        """The whole state as flat named arrays."""
        self._catch_up()
        scalars = {
            "first_time": self.first_time, "last_time": self.last_time, "count": self.count,
            "hops": self._hops, "keep": self.keep, "feature_version": FEATURE_VERSION,
            "unit": self.unit.name, "channels": list(self.channels) or None,
            "period": None if self.tracking is None else self.tracking.period,
        }  # fmt: skip
        out: dict[str, Array] = {"windows": packed(scalars), "rows": self._rows, "first": self._first}
        if self._held:
            joined = Samples.concatenate(self._held)
            out["held/time"] = joined.time
            out.update({f"held/{n}": joined[n] for n in joined.channels})
        for m in METHODS:
            out[f"records/{m}"] = self._records[m]
            out[f"last/{m}"] = self.last_records[m]
            if self._kept[m]:
                out[f"kept/{m}"] = np.concatenate(self._kept[m])
        out.update({f"watch/{k}": v for k, v in self._watch.state().items()})
        if self.tracking is not None:
            for m, arrays in self.tracking.state().items():
                out.update({f"tracker/{m}/{k}": v for k, v in arrays.items()})
        return {k: np.array(v) for k, v in out.items()}

    def restore(self, state: dict[str, Array]) -> None:
        """Go on from a state that `state` gave for the same unit.

        Raises
        ------
        InputError : a state of another version or unit.
        """
        scalars = unpacked(state["windows"])
        if scalars["feature_version"] != FEATURE_VERSION:
            raise InputError("saved state of another version of fdd", mend="start anew")
        if scalars["unit"] != self.unit.name:
            raise InputError(
                f"saved state of unit {scalars['unit']!r}, not {self.unit.name!r}", mend="start anew"
            )
        self.first_time, self.last_time = scalars["first_time"], scalars["last_time"]
        self.count, self._hops, self.keep = scalars["count"], scalars["hops"], scalars["keep"]
        self._rows, self._first = state["rows"].copy(), state["first"].copy()
        held = {k.removeprefix("held/"): v for k, v in state.items() if k.startswith("held/")}
        self._held = [Samples(held.pop("time"), held)] if held else []
        for m in METHODS:
            self._records[m] = state[f"records/{m}"].copy()
            self.last_records[m] = state[f"last/{m}"].copy()
            self._kept[m] = [state[f"kept/{m}"].copy()] if f"kept/{m}" in state else []
        self._unwatched = []
        self._watch.restore({k.removeprefix("watch/"): v for k, v in state.items() if k.startswith("watch/")})
        self.tracking = None
        if scalars["channels"] is not None:
            self.tracking = Tracking(self.unit, Channels(tuple(scalars["channels"])), scalars["period"])
            self.tracking.restore(
                {
                    m: {k.split("/")[2]: v for k, v in state.items() if k.startswith(f"tracker/{m}/")}
                    for m in METHODS
                }
            )


def require_channels(names: tuple[str, ...]) -> None:
    """Refuse a set of channels that no diagnosis can be made from.

    Raises
    ------
    InputError : says which channel is missing.
    """
    missing = missing_required(names)
    if missing:
        raise InputError(
            f"no usable data for {', '.join(missing)}",
            mend=f"map a column to each (channels: {', '.join(CHANNELS)})",
        )


def baseline_centre(unit: Unit) -> Array:
    """Location of the unit's healthy features, zeros without a baseline of this version."""
    return _of_baseline(unit, "centre")


def baseline_spread(unit: Unit) -> Array:
    """Scale of the unit's healthy features, zeros without a baseline of this version."""
    return _of_baseline(unit, "scale")


def _of_baseline(unit: Unit, what: str) -> Array:
    if unit.baseline is None or unit.baseline.feature_version != FEATURE_VERSION:
        return np.zeros(len(FEATURES))
    known = dict(zip(unit.baseline.features, getattr(unit.baseline, what), strict=True))
    return np.array([known.get(n, 0.0) for n in FEATURES])


def unpacked(data: Array) -> dict[str, Any]:
    """JSON scalars that a state carries as bytes."""
    found: dict[str, Any] = json.loads(bytes(np.asarray(data, dtype=np.uint8)).decode())
    return found


def packed(scalars: dict[str, Any]) -> Array:
    """JSON scalars as bytes, to travel among a state's arrays."""
    return np.frombuffer(json.dumps(scalars).encode(), dtype=np.uint8)
