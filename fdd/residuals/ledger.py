"""What each hop tells of each balance's coefficients, kept as normal equations.

The information of a hop is that of its rows over their own variance, so a noisy sensor or a gusty minute
speaks more quietly.
What hangs together in time, a load or a slow current, is taken out of rows and columns alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.balances import BALANCES, Balance, Strand
from fdd.residuals.effects import Effects
from fdd.residuals.quantities import Quantities, Scales, settled
from fdd.residuals.rows import COLUMNS, HOP_ROWS, HOP_S, ROW_S, TAIL_ROWS
from fdd.unit import Unit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

HISTORY = 7200
"""Hops whose misfit is remembered: an hour."""
MOST_HOPS = 20
"""Hops whose quantities are worked out at a time: their columns still fit the processor's memory."""
LEAST_ROWS = 12
"""Rows below which a stretch of a hop says too little."""
MEMORY = 0.95
"""Share of the noise's statistics that is kept from hop to hop: ten seconds."""
RECENT_HOPS = 20
"""Hops of that memory where rows themselves are kept."""
MOST_COLOUR = 0.95
"""Correlation of neighbouring rows beyond which ten seconds do not tell it."""
LEAST_NOISE = 0.1
"""Of the unit's usual noise: at standstill an encoder may seem to have none."""
LOAD_S = 1.0
"""s in which a load changes as much as friction does when the piston turns round."""
FIRST_WEIGHT = 100.0
"""Rows that the first guess of a noise counts for."""


def widened(information: Array, vector: Array, std: Array) -> tuple[Array, Array]:
    """What normal equations tell when their coefficients differ by N(0, std²) from those sought; any
    leading axes.

    ``M (I + Q M)⁻¹`` and ``(I + M Q)⁻¹ m``, the likelihood with the difference integrated out, by the
    eigenvalues of
    ``√Q M √Q``: never negative, whatever the sizes of the columns.
    """
    values, vectors = np.linalg.eigh(information * std * std[:, None])
    values = values.clip(0.0)[..., None, :]
    turned = np.swapaxes(vectors, -1, -2)
    wide = (vectors * (values / (1.0 + values))) @ turned / std / std[:, None]
    kept = ((vectors / (1.0 + values)) @ turned @ (vector * std)[..., None])[..., 0] / std
    return wide, kept


class Entry(NamedTuple):
    """What a hop tells of a balance: information (n, n), vector (n,), rows behind it, and their variance."""

    information: Array
    vector: Array
    rows: float
    variance: float


def calibration(gram: Array, noise: Array) -> Array:
    """What to multiply columns (rows, n) with to have the best guess of them without their noise, (n, n).

    Noise in a column draws its coefficient to zero, the more the fewer samples a row has. ``G⁻¹(G - N)``
    takes that back (regression calibration: Carroll et al. 2006, doi 10.1201/9781420010138). What noise
    alone moves becomes 0, and tells nothing.

    Parameters
    ----------
    gram : (n, n), products G of the columns. noise : (n, n), what noise has added to them.

    Examples
    --------
    >>> calibration(np.diag([4.0, 2.0]), np.diag([1.0, 3.0])).round(3).tolist()
    [[0.75, 0.0], [0.0, 0.0]]
    """
    size = np.sqrt(np.diag(gram).clip(1e-300))
    root = np.linalg.cholesky(gram / size / size[:, None] + 1e-9 * np.eye(size.size))
    half = np.linalg.solve(root, noise / size / size[:, None])
    share, turned = np.linalg.eigh(np.linalg.solve(root, half.T))
    lost = np.linalg.solve(root.T, turned * share.clip(0.0, 1.0)) @ (root @ turned).T
    return np.asarray(np.eye(size.size) - lost / size[:, None] * size)


class Account:
    """One balance's bookkeeping: noise, colour and coefficients so far.

    Parameters
    ----------
    balance : which. effects : its coefficients' prior mean and spread, and first guess of its noise.
    """

    def __init__(self, balance: Balance, effects: Effects) -> None:
        self.balance = balance
        self.size = effects.mean.size
        self.weight = FIRST_WEIGHT
        known = balance.cumulative and effects.information.any()
        self.least = max((1.0 if known else LEAST_NOISE) * effects.noise, balance.floor) ** 2
        self.variance_sum = FIRST_WEIGHT * effects.noise**2
        self.recent: list[Array] = []
        self.level: Array = np.zeros((1, effects.mean.size + 1))

    def hop(self, strands: Sequence[Strand]) -> Entry:
        """What one hop tells.

        Parameters
        ----------
        strands : rows of the hop with `TAIL_ROWS` before them.
        """
        n = strands[0].x.shape[1]
        gram, noise, free = np.zeros((n + 1, n + 1)), np.zeros((n, n)), 0.0
        rows = self._levels if self.balance.cumulative else self._cells
        for y, x, ok, noisy in strands:
            before = free
            for part in rows(y, x, ok):
                gram += part.T @ part
                free += part.shape[0]
            if noisy is not None and free > before:
                inside = noisy[-HOP_ROWS:][ok[-HOP_ROWS:]].reshape(-1, n)
                noise += 2.0 * (free - before) / len(inside) * (inside.T @ inside)
        if free < LEAST_ROWS // self.balance.cell:
            none = np.zeros((self.size, self.size))
            return Entry(none, np.zeros(self.size), 0.0, self.variance_sum / self.weight)
        if self.balance.lines:
            return self._amplitudes(gram, free)
        if self.balance.cell > 1:
            variance = self._coloured(part)
        else:
            variance = self._variance(gram, free)
        if noise.any():
            turn = calibration(gram[:n, :n], noise)
            gram[:n, :n], gram[:n, n] = turn.T @ gram[:n, :n] @ turn, turn.T @ gram[:n, n]
        return Entry(gram[:n, :n] / variance, gram[:n, n] / variance, free, variance)

    def _amplitudes(self, gram: Array, free: float) -> Entry:
        """Amplitudes of lines, whatever their phase: a lost count turns the shaft's angle, but not them."""
        lines = self.balance.lines
        n = gram.shape[0] - 1
        scale = 1.0 / np.sqrt(np.diag(gram)[:n].clip(1e-300))
        inverse = (
            np.linalg.inv(gram[:n, :n] * scale * scale[:, None] + 1e-6 * np.eye(n)) * scale * scale[:, None]
        )
        size = inverse @ gram[:n, n]
        variance = max((gram[n, n] - size @ gram[:n, n]) / max(free - n, 0.3 * free), self.least)
        pairs = np.hypot(size[0 : 4 * lines + 2 : 2], size[1 : 4 * lines + 2 : 2])
        # A line's own height over those half an order beside it, which are as high as unrest alone makes it.
        lower, upper = pairs[lines:-1], pairs[lines + 1 :]
        amplitude = pairs[:lines] - 0.5 * (lower + upper)
        beside = 0.25 * (np.square(lower) + np.square(upper))
        self.variance_sum = MEMORY * self.variance_sum + float(beside.mean())
        self.weight = MEMORY * self.weight + 1.0
        spread = variance * np.diag(inverse)[: 2 * lines].reshape(lines, 2).mean(axis=1)
        spread = np.maximum(spread, np.maximum(beside, self.variance_sum / self.weight))
        return Entry(np.diag(1.0 / spread), amplitude / spread, free, variance)

    def _variance(self, gram: Array, free: float) -> float:
        """Mean square of what the hop's best coefficients leave, or the last ten seconds', if more."""
        n = self.size
        scale = 1.0 / np.sqrt(np.diag(gram)[:n].clip(1e-300))
        seen = np.diag(gram)[:n] > 0.0
        scaled = gram[:n, :n] * scale * scale[:, None] + 1e-6 * np.eye(n)
        b = gram[:n, n] * scale
        rest = max(gram[n, n] - b @ np.linalg.solve(scaled, b), 1e-12 * gram[n, n])
        own = rest / max(free - seen.sum(), 0.3 * free)
        self.variance_sum = MEMORY * self.variance_sum + rest
        self.weight = MEMORY * self.weight + max(free - seen.sum(), 0.3 * free)
        return float(max(own, self.variance_sum / self.weight, self.least))

    def _coloured(self, rows: Array) -> float:
        """Variance that rows would have that err independently and tell as much.

        It is the mean square of what the best coefficients of the last ten seconds leave, times
        (1 + ρ)/(1 - ρ) of a first-order autoregression.

        What a law leaves out (a load's own dynamics) hangs together over many cells, and a hop has too few
        to tell.
        """
        self.recent = [*self.recent[-RECENT_HOPS + 1 :], rows]
        joined = np.concatenate(self.recent)
        x, y = joined[:, :-1], joined[:, -1]
        scale = 1.0 / np.sqrt(np.square(x).sum(axis=0).clip(1e-300))
        scaled = x * scale
        left = y - scaled @ np.linalg.solve(scaled.T @ scaled + 1e-6 * np.eye(scale.size), scaled.T @ y)
        square = max(float(left @ left), 1e-300)
        rho = min(max(float(left[1:] @ left[:-1]) / square, 0.0), MOST_COLOUR)
        free = max(y.size - scale.size, 0.3 * y.size)
        return max(square / free * (1.0 + rho) / (1.0 - rho), self.least)

    def _levels(self, y: Array, x: Array, ok: Flags) -> list[Array]:
        """Running sums of each unbroken stretch, less their mean: pressure noise does not add up in them."""
        inside = np.flatnonzero(ok[-HOP_ROWS:]) + y.size - HOP_ROWS
        out = []
        for stretch in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
            if stretch.size >= LEAST_ROWS:
                level = np.cumsum(np.column_stack([x[stretch], y[stretch]]), axis=0)
                out.append((level - level.mean(axis=0))[1:])
        return out

    def _cells(self, y: Array, x: Array, ok: Flags) -> list[Array]:
        """Rows of the hop, or the means of cells of them, less what changes slowly."""
        joined = np.column_stack([x, y])
        joined[~ok] = 0.0
        cell = self.balance.cell
        if cell > 1:  # a law that holds over tens of milliseconds must not be whitened up to where it fails
            joined = joined.reshape(-1, cell, joined.shape[1]).mean(axis=1)
            ok = np.asarray(ok.reshape(-1, cell).all(axis=1))
            joined[~ok] = 0.0
        hop, least = HOP_ROWS // cell, max(LEAST_ROWS // cell, 1)
        if (
            self.balance.lines
        ):  # slow currents are no vibration; a line keeps its amplitude, as its columns do
            joined, ok = np.diff(joined, axis=0), ok[1:] & ok[:-1]
        inside = joined[-hop:][ok[-hop:]]
        if cell > 1:
            inside = self._passed(inside)
        return [inside] if inside.shape[0] >= least else []

    def _passed(self, rows: Array) -> Array:
        """Cells over what went before them: a load that changes slowly is no friction.

        The prediction error of a random walk under white noise, in which all columns take part alike.
        """
        if not rows.size:
            return rows
        if not self.level.any():
            self.level = -rows[:1]  # as if it had always been so
        decay = 1.0 - self.balance.cell * ROW_S / LOAD_S
        out = np.empty_like(rows)
        for k in range(rows.shape[0]):  # ten rows a hop: importing scipy.signal would take as long as a log
            out[k] = rows[k] + self.level[0]
            self.level = decay * out[k : k + 1] - rows[k : k + 1]
        return out


class Ledger:
    """All balances of an axis, hop by hop.

    Parameters
    ----------
    unit : profile. effects : balance name to the effects of this unit.
    """

    def __init__(self, unit: Unit, effects: dict[str, Effects]) -> None:
        self.unit = unit
        self.scales = Scales.of(unit)
        self.effects = effects
        self.accounts = {name: Account(b, effects[name]) for name, b in BALANCES.items()}
        self.tail = np.full((TAIL_ROWS, len(COLUMNS)), np.nan)
        self.hops: list[int] = []
        self.entries: dict[str, list[Entry]] = {name: [] for name in BALANCES}
        self._wide: dict[str, list[tuple[Array, Array]]] = {name: [] for name in BALANCES}
        self.reference = effects
        """What the first of the hops kept is held against: the unit's baseline, or what older hops have
        made of it."""
        self.folded = self.taken = 0
        """Hops that became the reference, and all that ever came."""
        self._misfits: list[list[float]] = []

    def sums(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """Information (h, n, n), vector (h, n), rows (h,) and variance (h,) of each balance."""
        out = {}
        for name, entries in self.entries.items():
            n = len(BALANCES[name].columns)
            m, v, rows, variance = (np.array([e[i] for e in entries]) for i in range(4))
            out[name] = m.reshape(-1, n, n), v.reshape(-1, n), rows, variance
        return out

    def widened(self) -> dict[str, tuple[Array, Array]]:
        """Information (h, n, n) and vector (h, n), widened by what wanders from hop to hop, of each balance
        that tells anything."""
        out = {}
        for name in BALANCES:
            wide = self._widened(name)
            if any(e.rows for e in self.entries[name]):
                out[name] = np.array([m for m, _ in wide]), np.array([v for _, v in wide])
        return out

    def _widened(self, name: str) -> list[tuple[Array, Array]]:
        """Of every hop, worked out once."""
        wide = self._wide[name]
        fresh = self.entries[name][len(wide) :]
        if fresh:
            information, vector = np.array([e[0] for e in fresh]), np.array([e[1] for e in fresh])
            wide.extend(zip(*widened(information, vector, self.reference[name].wander), strict=True))
        return wide

    def push(self, first: int, rows: Array) -> None:
        """Take the rows of complete hops (see `RowMaker.push`); nothing depends on how many at a time."""
        for start in range(0, len(rows), MOST_HOPS * HOP_ROWS):
            here = np.concatenate([self.tail, rows[start : start + MOST_HOPS * HOP_ROWS]])
            self._take(first + start // HOP_ROWS, here)
            self.tail = here[-TAIL_ROWS:]

    def _take(self, first: int, rows: Array) -> None:
        """Hops from an index on: rows with `TAIL_ROWS` before them."""
        q = Quantities(rows, self.unit, self.scales)
        count = (len(rows) - TAIL_ROWS) // HOP_ROWS
        self.hops += range(first, first + count)
        self.taken += count
        misfits = np.full((count, len(BALANCES)), np.nan)
        for b, (name, balance) in enumerate(BALANCES.items()):
            strands = []
            for s in balance.strands(q):
                good = s.valid & np.isfinite(s.y) & np.isfinite(s.x).all(axis=1)
                strands.append(s._replace(valid=settled(good, balance.settle)))
            account = self.accounts[name]
            for k in range(0, count * HOP_ROWS, HOP_ROWS):
                hop = slice(k, k + TAIL_ROWS + HOP_ROWS)
                self.entries[name].append(account.hop([s.part(hop) for s in strands]))
            misfits[:, b] = self._misfit(name, self.entries[name][-count:])
        self._misfits = [*self._misfits, *misfits.tolist()][-HISTORY:]

    def _misfit(self, name: str, entries: list[Entry]) -> Array:
        """How far hops are from the unit's baseline, in what healthy hops are: root mean square over
        coefficients, (h,); NaN of those that tell nothing."""
        e = self.effects[name]
        spread = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
        information, vector, rows = (np.array([x[i] for x in entries]) for i in range(3))
        wide, kept = widened(information, vector, spread)
        rest = spread * (kept - wide @ e.mean)
        return np.where(rows > 0.0, np.sqrt(np.mean(np.square(rest), axis=1)), np.nan)

    def misfits(self) -> tuple[Array, list[str], Array]:
        """Ends of the last hops (m,), balances' names and how badly each closed (m, balances)."""
        seen = np.array(self._misfits).reshape(-1, len(BALANCES))
        ends = np.empty(0)
        if len(seen):
            ends = np.asarray((self.hops[-1] - np.arange(len(seen))[::-1] + 1) * HOP_S, dtype=np.float64)
        used = np.isfinite(seen).any(axis=0)
        names = [n for n, u in zip(BALANCES, used, strict=True) if u]
        return np.asarray(ends, dtype=np.float64), names, np.asarray(np.nan_to_num(seen[:, used]))

    def fold(self, window: int, sick: Sequence[tuple[float, float]] = ()) -> int:
        """Let hops beyond a window become the reference, a fifth of it at a time; how many have in all.

        A reference made of older hops is what the unit was like then; it may have moved since by what
        coefficients change within a healthy log. What came while a fault stood is no reference: of that the
        latest hops are kept, and some from before it to hold them against.

        Parameters
        ----------
        sick : s, when faults began and ended; inf for those that stand.
        """
        part = window // 5
        while len(self.hops) > window + part:
            at = HOP_S * np.array(self.hops)
            faulty, before = np.zeros((2, at.size), dtype=np.bool_)
            for onset, end in sick:
                faulty |= (onset <= at) & (at < end)
                before |= np.isinf(end) & (onset - part * HOP_S <= at) & (at < onset)
            healthy = np.flatnonzero(~before & ~faulty)[:part]
            if healthy.size and not faulty[: healthy[0]].any():
                self._learn(healthy)
                self.folded += healthy.size
            else:
                healthy = np.flatnonzero(~before)[:part]
            self._drop(healthy if healthy.size else np.arange(part))
        return self.folded

    def _learn(self, places: NDArray[np.int64]) -> None:
        """Take hops into the reference."""
        for name, e in self.reference.items():
            wide = self._widened(name)
            prior = np.linalg.inv(e.covariance)
            covariance = np.linalg.inv(prior + sum(wide[k][0] for k in places))
            mean = covariance @ (prior @ e.mean + sum(wide[k][1] for k in places))
            covariance = 0.5 * (covariance + covariance.T) + np.diag(np.square(e.within))
            self.reference = {**self.reference, name: replace(e, mean=mean, covariance=covariance)}

    def forget(self, start: float, end: float) -> None:
        """Leave out the hops of a stretch of time, s."""
        at = HOP_S * np.array(self.hops)
        self._drop(np.flatnonzero((start <= at) & (at < end)))

    def _drop(self, places: NDArray[np.int64]) -> None:
        gone = set(places.tolist())
        kept = [k for k in range(len(self.hops)) if k not in gone]
        for name in BALANCES:
            wide = self._widened(name)
            self.entries[name] = [self.entries[name][k] for k in kept]
            self._wide[name] = [wide[k] for k in kept]
        self.hops = [self.hops[k] for k in kept]

    def state(self) -> dict[str, Array]:
        """Everything as flat named arrays."""
        out: dict[str, Array] = {
            "hops": np.array(self.hops), "tail": self.tail,
            "folded": np.array([self.folded, self.taken]),
            "misfits": np.array(self._misfits).reshape(-1, len(BALANCES)),
        }  # fmt: skip
        for name, account in self.accounts.items():
            for k, part in zip("mvrs", self.sums()[name], strict=True):
                out[f"{name}/{k}"] = part
            out[f"{name}/noise"] = np.array([account.weight, account.variance_sum])
            out[f"{name}/level"] = account.level
            out[f"{name}/lengths"] = np.array([len(r) for r in account.recent])
            out[f"{name}/recent"] = np.concatenate(account.recent) if account.recent else np.empty((0, 0))
            out[f"{name}/mean"], out[f"{name}/covariance"] = (
                self.reference[name].mean,
                self.reference[name].covariance,
            )
        return {k: np.array(v) for k, v in out.items()}

    def restore(self, state: dict[str, Array]) -> None:
        """Go on from what `state` gave for the same unit."""
        self.hops = [int(h) for h in state["hops"]]
        self.tail = state["tail"].copy()
        self.folded, self.taken = (int(x) for x in state["folded"])
        self._misfits = [[float(x) for x in row] for row in state["misfits"]]
        for name, account in self.accounts.items():
            m, v, r, s = (state[f"{name}/{k}"] for k in "mvrs")
            self.entries[name] = [Entry(m[i], v[i], float(r[i]), float(s[i])) for i in range(len(self.hops))]
            self._wide[name] = []
            account.weight, account.variance_sum = (float(x) for x in state[f"{name}/noise"])
            account.level = state[f"{name}/level"].copy()
            ends = np.cumsum(state[f"{name}/lengths"]).astype(np.int64)
            account.recent = np.split(state[f"{name}/recent"], ends[:-1]) if ends.size else []
            mean, covariance = state[f"{name}/mean"].copy(), state[f"{name}/covariance"].copy()
            self.reference = {
                **self.reference,
                name: replace(self.effects[name], mean=mean, covariance=covariance),
            }
