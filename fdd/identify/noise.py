"""Process and measurement noise of a unit, by the likelihood of its healthy logs.

The log-likelihood of a filter's innovations, ``Σ log N(e; 0, S)``, is that of the log given the
noise (Schweppe 1965, doi 10.1109/TIT.1965.1053737; for the EHA's parameters themselves the volume
balances do better, see `fdd.identify.balance`). It is maximised over what a healthy log can tell:
the noise of position, angle and pressure, and the process noise of force, acceleration and flow.
How fast leakage, air, friction and so on may walk is *not* fitted: a healthy log has no wear in it;
it is a choice of how fast wear is to be followed, and `estimators.eha_noise.Noise` gives the reasons.

A model error is no white noise. The likelihood of single steps sees errors that change within
milliseconds; leakage and bulk modulus are learned from what lasts for seconds. Two rules follow:

* Nothing goes below what `Noise` argues. A calibration run has no gusts and no unknown inertia, so its
  likelihood would have a force noise under which the first of either becomes a change of the oil.
* Flow noise goes up until half-second means of the pressures' innovations scatter as the filter
  says (`fdd.identify.whiteness.slow_excess`), in the worst quarter minute of the logs; the likelihood's own
  flow noise is shown and not used. A pressure sensor of limited bandwidth has errors that last for
  a few samples, and the likelihood of single steps takes those for flow: ten times too much on two rigs
  whose pressures have next to no power above 320 Hz, and then hardly any leakage is observable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from estimators import eha_layout as layout
from estimators.eha_noise import Noise
from fdd.identify.innovations import Innovations, Prepared, innovations, prepare
from fdd.identify.likelihood import LogScaleFit, maximise
from fdd.identify.whiteness import ChannelTest, channel_tests, slow_excess
from fdd.residuals.tracking import noise_of
from fdd.samples import Samples
from fdd.sections import Provenance, si_of
from fdd.unit import Estimation, Unit

Array = NDArray[np.float64]

STRETCHES = 6
"""Pieces of log that the likelihood is taken on."""
STRETCH = 2.0
"""s, each."""
SETTLE = 3.0
"""s at a log's start until the parameters have found their place."""
SKIP = 0.3
"""s at a stretch's start that do not count: until the covariance is that of the new noise."""
DECIMATION = 10
MOST_SECONDS = 120.0
"""Of all logs together that the innovations are tested on; of each at least `PIECE` and what settles."""
PIECE = 15.0
"""s: the slow scatter is to be right in each piece of this length."""
LEAST_MEANS = 15
CONFIDENCE = 0.975
MOST_RAISE = 10.0
"""Times the argued flow noise, at which the volume balance has no say any more: then the model is wrong."""

REASONS = {
    "position": "a step of the encoder; its mounting",
    "angle": "a count of the encoder",
    "pressure": "density of the sensors' noise below 100 Hz",
    "pressure_difference": "density of the sensor's noise below 100 Hz",
    "force": "less would take an unknown load's inertia for a change of the oil",
    "acceleration": "the drive may change its speed by 20 rad/s within a millisecond",
    "flow": "gear ripple, lines and valves: half a percent of the pump's flow",
}
"""Why the argued value is what nothing goes below."""


@dataclass(frozen=True)
class NoiseRow:
    """One number of the filters' noise: what is argued, what the likelihood says, what is used.

    `likelihood` is None where the logs do not tell; `std` is its standard deviation, from the curvature
    and from how far the stretches disagree.
    """

    name: str
    unit: str
    argued: float
    likelihood: float | None
    std: float | None
    used: float
    why: str


@dataclass(frozen=True)
class NoiseFit:
    """Result of `fit_noise`.

    Attributes
    ----------
    rows : one per number.
    tests : of the innovations with the noise that is used, one per channel.
    likelihood_seconds, tested_seconds : of log.
    gain : log-likelihood per sample that the likelihood's own noise has over the argued one.
    slow : worst slow scatter over its 97.5 % bound, with the argued and with the used noise.
    """

    rows: tuple[NoiseRow, ...]
    tests: tuple[ChannelTest, ...]
    likelihood_seconds: float
    tested_seconds: float
    gain: float
    slow: tuple[float, float]

    @property
    def estimation(self) -> Estimation | None:
        """The numbers above the argued ones as the profile keeps them; None where there is none."""
        raised = [r for r in self.rows if r.used > r.argued]
        if not raised:
            return None
        out = Estimation(**{r.name: float(f"{r.used:.4g}") for r in raised})
        for r in raised:
            by_likelihood = r.name != "flow"
            what, seconds = (
                ("likelihood", self.likelihood_seconds)
                if by_likelihood
                else ("slow scatter of innovations", self.tested_seconds)
            )
            out.provenance[r.name] = Provenance(
                source=f"{what} on {seconds:.0f} s of healthy log", std=r.std if by_likelihood else None
            )
        return out


def fit_noise(logs: Sequence[Samples], unit: Unit) -> NoiseFit | None:
    """Fit the filters' noise to healthy logs.

    Parameters
    ----------
    logs : healthy, as for `fdd.identify.identify_unit`.
    unit : identified from them; its `estimation` is not looked at.

    Returns
    -------
    NoiseFit, or None where no log is longer than `SETTLE` and a stretch.

    Examples
    --------
    >>> fit = fit_noise(logs, unit)  # doctest: +SKIP
    >>> unit.estimation = fit.estimation  # doctest: +SKIP
    """
    plain = unit.model_copy(update={"estimation": None})
    argued = noise_of(plain)
    usable = [log for log in logs if log.duration > SETTLE + STRETCH]
    seconds = max(MOST_SECONDS / max(len(usable), 1), SETTLE + PIECE)
    prepared = [_cut(prepare(log, plain), seconds) for log in usable]
    if not prepared:
        return None
    chambers = prepared[0].tracking.channels.chambers
    prepared = [p for p in prepared if p.tracking.channels.chambers == chambers]
    pieces = stretches(prepared, argued)
    pressure = "pressure" if chambers else "pressure_difference"
    names = ("force", "acceleration", pressure, "flow", "position", "angle")
    free = maximise(lambda n: likelihoods(pieces, n), argued, names)
    told = [n for n in names if n in free.told and n != "flow"]
    used = replace(argued, **{n: max(getattr(free.noise, n), getattr(argued, n)) for n in told})
    before, found = _slow(prepared, argued)
    after = before
    if used != argued:
        after, found = _slow(prepared, used)
    # The scatter falls with flow to the power of 1 to 2, so a step by 1.5 seldom goes too far.
    limit = max(MOST_RAISE * argued.flow, used.flow)
    for _ in range(4):
        if after <= 1.0 or used.flow >= limit:
            break
        used = replace(used, flow=min(used.flow * after ** (1.0 / 1.5), limit))
        after, found = _slow(prepared, used)
    resolution = {c: unit.sensor(c).resolution for c in unit.sensors}
    samples = sum(b.shape[0] for _, _, b in pieces)
    return NoiseFit(
        rows=tuple(_row(n, argued, used, free) for n in names),
        tests=tuple(channel_tests(found, resolution)),
        likelihood_seconds=sum(np.ptp(b[:, layout.TIME]) - SKIP for _, _, b in pieces),
        tested_seconds=sum(len(f) * f.period for f in found),
        gain=(free.value - free.start_value) / samples,
        slow=(before, after),
    )


Stretch = tuple[Prepared, dict[str, Array], Array]


def stretches(prepared: Sequence[Prepared], noise: Noise) -> list[Stretch]:
    """Informative pieces of the logs, each with the tracker's state where it begins.

    Each log is cut into equal parts, and of each part the piece is taken in which pressure and
    velocity vary most: noise shows where something happens, and a standstill is only one of the conditions.

    Returns
    -------
    Of each piece the log, the tracker's state before it, and its (n, COLUMNS) block.
    """
    share = max(STRETCHES // len(prepared), 1)
    out: list[Stretch] = []
    for log in prepared:
        tracker = log.tracker(noise, DECIMATION)
        length = round(STRETCH / log.period)
        first, n = round(SETTLE / log.period), log.block.shape[0]
        parts = int(np.clip((n - first) // length, 1, share))
        edges = np.linspace(first, n, parts + 1).astype(int)
        done = 0
        for low, high in pairwise(edges):
            starts = np.arange(low, max(high - length, low) + 1, max(length // 2, 1))
            start = int(starts[np.argmax([_activity(log.block[s : s + length]) for s in starts])])
            start = max(start, done)
            tracker.push(log.block[done:start])
            out.append((log, tracker.state(), log.block[start : start + length]))
            done = start
    return out


def _activity(block: Array) -> float:
    """How much happens: travel times scatter of the pressures, either of which alone tells half."""
    columns = block[:, [layout.PRESSURE_1, layout.PRESSURE_2, layout.DIFFERENCE]]
    there = np.isfinite(columns).any(axis=0)
    position = block[:, layout.POSITION]
    position = position[np.isfinite(position)]
    if position.size < 2 or not there.any():
        return 0.0
    spread = float(np.nanstd(columns[:, there], axis=0).max())
    return spread * float(np.sum(np.abs(np.diff(position[::20]))))


def likelihoods(pieces: Sequence[Stretch], noise: Noise) -> Array:
    """Log-likelihood of each stretch under this noise; minus infinity where the filter fails."""
    out = np.empty(len(pieces))
    for k, (log, state, block) in enumerate(pieces):
        tracker = log.tracker(noise, DECIMATION)
        tracker.restore(state)
        records = tracker.push(block)
        use = records[:, layout.R_TIME] > block[0, layout.TIME] + SKIP
        out[k] = DECIMATION * np.sum(records[use, layout.R_LOGLIK])
    return np.where(np.isfinite(out), out, -np.inf)


def _cut(log: Prepared, seconds: float) -> Prepared:
    return replace(log, block=log.block[: round(seconds / log.period)])


def _slow(prepared: Sequence[Prepared], noise: Noise) -> tuple[float, list[Innovations]]:
    """Slow scatter of the worst piece over its bound, and the innovations it was found in."""
    found = [innovations(p, noise, SETTLE) for p in prepared]
    worst = 0.0
    for f in found:
        pressures = [i for i, c in enumerate(f.channels) if c.startswith("pressure")]
        pieces = max(round(len(f) * f.period / PIECE), 1)
        for rows in np.array_split(np.arange(len(f)), pieces):
            value, means = slow_excess([f.white[rows, i] for i in pressures], f.period)
            if means >= LEAST_MEANS:
                bound = float(gammaincinv(0.5 * means, CONFIDENCE) / (0.5 * means))
                worst = max(worst, value / bound)
    return worst, found


def _row(name: str, argued: Noise, used: Noise, fit: LogScaleFit) -> NoiseRow:
    base, value = float(getattr(argued, name)), float(getattr(used, name))
    si = si_of(Estimation.model_fields[name])
    told = fit.told.get(name)
    likelihood = None if told is None else float(getattr(fit.noise, name))
    if value <= base:
        said = "the logs do not tell it"
        if likelihood is not None:
            said = (
                "single steps say more, what lasts does not"
                if likelihood > base
                else "the logs alone say less"
            )
        why = f"{said}; argued: {REASONS[name]}"
    elif name != "flow":
        why = "likelihood"
    else:
        why = "slow scatter of the pressures' innovations: flow errors that last"
    return NoiseRow(
        name, "1" if si is None else si.unit, base, likelihood,
        None if told is None or likelihood is None else _positive(told * likelihood), value, why,
    )  # fmt: skip


def _positive(std: float) -> float | None:
    return std if std > 0.0 else None
