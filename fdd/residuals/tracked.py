"""Both estimators over blocks of samples, and the observability of what they estimate.

The first samples are held back to find the channels and the sampling period; samples before all required
channels have values are skipped.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.observability import Observability, Observed
from fdd.errors import InputError
from fdd.residuals.bins import STOP_S
from fdd.residuals.compiled import Array
from fdd.residuals.tracking import METHODS, OBSERVABLE, Tracking, channels_of, new_watch, watched
from fdd.restorable import Restorable
from fdd.samples import CHANNELS, Samples, missing_required
from fdd.unit import Unit

HELD_BACK = 500
"""Samples that channels and period are found from; of a time one early row might be all."""


class Tracked(Restorable):
    """Run the estimators over blocks and keep what they say.

    Parameters
    ----------
    unit : profile. keep : keep all records of both estimators for trajectories.
    """

    STATE = (
        "keep", "lost", "_last", "_held", "last_records", "_kept", "_unwatched", "_watch", "_setup",
        "tracking",
    )  # fmt: skip

    def __init__(self, unit: Unit, *, keep: bool = False) -> None:
        self.unit = unit
        self.keep = keep
        self.tracking: Tracking | None = None
        self._held: list[Samples] = []
        self._kept: dict[str, list[layout.Records]] = {m: [] for m in METHODS}
        self.last_records: dict[str, layout.Records] = {m: np.empty(0, layout.RECORD) for m in METHODS}
        self._watch = new_watch()
        self._unwatched: list[layout.Records] = []
        self.lost = False
        """Whether a filter diverged: it is not used until the axis has stopped."""
        self._last = np.nan

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that carry data; empty until enough samples came."""
        return () if self.tracking is None else self.tracking.channels

    @property
    def model(self) -> eha.Parameters:
        """Parameters of the reduced model."""
        assert self.tracking is not None
        return self.tracking.model

    def push(self, samples: Samples) -> None:
        """Take the next block.

        Raises InputError: channels that do not suffice for a diagnosis.
        """
        if not len(samples):
            return
        before = float(samples.time[0] if np.isnan(self._last) else self._last)
        self._last = float(samples.time[-1])
        if self._last - before <= STOP_S:
            self._track(samples)
            return
        stops = np.flatnonzero(np.diff(samples.time, prepend=before) > STOP_S).tolist()
        for a, b in pairwise(sorted({0, *stops, len(samples)})):
            if self.lost and self.tracking is not None and a in stops:
                self._catch_up()
                self.tracking = Tracking(self.unit, self.tracking.channels, self.tracking.period)
                self.lost = False
            self._track(samples.rows(a, b))

    def _track(self, samples: Samples) -> None:
        """Take samples between which the axis does not stop."""
        if self.tracking is None:
            samples = Samples.concatenate([*self._held, samples])
            while self.tracking is None and len(samples) >= HELD_BACK:
                if missing := missing_required(samples.channels):
                    raise InputError(
                        f"no usable data for {', '.join(missing)}",
                        mend=f"map a column to each (channels: {', '.join(CHANNELS)})",
                    )
                head = samples.rows(0, HELD_BACK)  # by number, whatever block brought the last of them
                channels = channels_of(head)
                if missing_required(channels):  # not yet, or not to be trusted
                    samples = samples.rows(HELD_BACK, len(samples))
                else:
                    self.tracking = Tracking(self.unit, channels, float(np.median(np.diff(head.time))))
            if self.tracking is None:
                self._held = [samples]
                return
            self._held = []
        fresh = self.tracking.push(self.tracking.block(samples))
        # Both keep the same times: where one lost the motion, neither is believed.
        sane = np.logical_and.reduce([layout.finite(r) for r in fresh.values()])
        self.lost |= not bool(sane.all())
        for method, records in fresh.items():
            records = records[sane]
            if records.size:
                self.last_records[method] = records[-1:]
                if self.keep:
                    self._kept[method].append(records)
                if method == "ekf":
                    self._unwatched.append(records)
        if len(self._unwatched) > 30:  # single records, as they come live, cost as much as hundreds
            self._catch_up()

    def records(self) -> dict[str, layout.Records]:
        """All records so far of each estimator, (n,) of `layout.RECORD`.

        Raises ValueError: made with ``keep=False``.
        """
        if not self.keep:
            raise ValueError("records were not kept: make it with keep=True")
        return {m: np.concatenate(p) if p else np.empty(0, layout.RECORD) for m, p in self._kept.items()}

    def observed(self) -> dict[str, Observed]:
        """Observability of each tracked quantity by the EKF's last record, (1,) each."""
        self._catch_up()
        return self._watch.latest()

    def observed_throughout(self) -> dict[str, Observed]:
        """Observability of each tracked quantity over all records of the EKF, (n,) each.

        Raises ValueError: made with ``keep=False``.
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

    def _watched(self, watch: Observability, records: layout.Records) -> dict[str, Observed]:
        assert self.tracking is not None
        tracker = self.tracking.trackers["ekf"]
        return watched(watch, records, self.unit, tracker.model, tracker.noise)

    def state(self) -> dict[str, Array]:
        """See `Restorable`; what waits or is kept in many parts is worked or joined first."""
        self._catch_up()
        self._kept = {m: [np.concatenate(parts)] if parts else [] for m, parts in self._kept.items()}
        return super().state()

    @property
    def _setup(self) -> tuple[tuple[str, ...], float] | None:
        """Channels and period of the estimators, of which they are made again."""
        return None if self.tracking is None else (self.channels, self.tracking.period)

    @_setup.setter
    def _setup(self, setup: tuple[tuple[str, ...], float] | None) -> None:
        self.tracking = None if setup is None else Tracking(self.unit, *setup)
