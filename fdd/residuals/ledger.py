"""What each hop tells of each balance's coefficients, kept as normal equations.

The information of a hop is that of its rows over their own variance, so a noisy sensor or a gusty minute
speaks more quietly.
What hangs together in time, a load or a slow current, is taken out of rows and columns alike.
"""

from __future__ import annotations

from dataclasses import replace

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
        self.wander = effects.wander
        self.information: Array = np.asarray(np.linalg.inv(effects.covariance), dtype=np.float64)
        self.vector: Array = self.information @ effects.mean
        self.weight = FIRST_WEIGHT
        known = balance.cumulative and effects.information.any()
        self.least = max((1.0 if known else LEAST_NOISE) * effects.noise, balance.floor) ** 2
        self.variance_sum = FIRST_WEIGHT * effects.noise**2
        self.recent: list[Array] = []
        self.level: Array = np.zeros((1, effects.mean.size + 1))

    def hop(self, strands: list[Strand]) -> tuple[Array, Array, float, float]:
        """Information (n, n), vector (n,), rows and variance that one hop gives.

        Parameters
        ----------
        strands : rows of the hop with `TAIL_ROWS` before them.
        """
        n = strands[0].x.shape[1] if strands else self.vector.size
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
            n = self.vector.size
            return np.zeros((n, n)), np.zeros(n), 0.0, self.variance_sum / self.weight
        if self.balance.lines:
            return self._amplitudes(gram, free)
        if self.balance.cell > 1:
            variance = self._coloured(part)
        else:
            variance = self._variance(gram, free)
        if noise.any():
            turn = calibration(gram[:n, :n], noise)
            gram[:n, :n], gram[:n, n] = turn.T @ gram[:n, :n] @ turn, turn.T @ gram[:n, n]
        information, vector = gram[:n, :n] / variance, gram[:n, n] / variance
        wide, wide_vector = widened(information, vector, self.wander)
        self.information += wide
        self.vector += wide_vector
        return information, vector, free, variance

    @property
    def mean(self) -> Array:
        """Coefficients by all hops so far, (n,)."""
        scale = 1.0 / np.sqrt(np.diag(self.information).clip(1e-300))
        scaled = self.information * scale * scale[:, None]
        return np.asarray(scale * np.linalg.solve(scaled + 1e-9 * np.eye(scale.size), scale * self.vector))

    def _amplitudes(self, gram: Array, free: float) -> tuple[Array, Array, float, float]:
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
        wide, wide_vector = widened(np.diag(1.0 / spread), amplitude / spread, self.wander)
        self.information += wide
        self.vector += wide_vector
        return np.diag(1.0 / spread), amplitude / spread, free, variance

    def _variance(self, gram: Array, free: float) -> float:
        """Mean square of what the hop's best coefficients leave, or the last ten seconds', if more."""
        n = self.vector.size
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
        self.entries: dict[str, list[tuple[Array, Array, float, float]]] = {name: [] for name in BALANCES}
        self.reference = effects
        """What the first of the hops kept is held against: the unit's baseline, or what older hops have
        made of it."""
        self.folded = 0
        self._misfits: list[list[float]] = []

    def sums(self) -> dict[str, tuple[Array, Array, Array, Array]]:
        """Information (h, n, n), vector (h, n), rows (h,) and variance (h,) of each balance."""
        out = {}
        for name, entries in self.entries.items():
            n = len(BALANCES[name].columns)
            out[name] = (
                np.array([e[0] for e in entries]).reshape(-1, n, n),
                np.array([e[1] for e in entries]).reshape(-1, n),
                np.array([e[2] for e in entries]), np.array([e[3] for e in entries]),
            )  # fmt: skip
        return out

    def push(self, first: int, rows: Array) -> None:
        """Take the rows of complete hops (see `RowMaker.push`)."""
        for k in range(len(rows) // HOP_ROWS):
            here = np.concatenate([self.tail, rows[k * HOP_ROWS : (k + 1) * HOP_ROWS]])
            self._hop(first + k, here)
            self.tail = here[-TAIL_ROWS:]

    def _hop(self, index: int, rows: Array) -> None:
        q = Quantities(rows, self.unit, self.scales)
        self.hops.append(index)
        for name, balance in BALANCES.items():
            strands = []
            for s in balance.strands(q):
                good = s.valid & np.isfinite(s.y) & np.isfinite(s.x).all(axis=1)
                strands.append(s._replace(valid=settled(good, balance.settle)))
            self.entries[name].append(self.accounts[name].hop(strands))

        self._misfits = [*self._misfits[-HISTORY + 1 :], [self._misfit(name) for name in BALANCES]]

    def _misfit(self, name: str) -> float:
        """How far the last hop is from the unit's baseline, in what healthy hops are: root mean square over
        coefficients."""
        information, vector, rows, _ = self.entries[name][-1]
        if not rows:
            return float("nan")
        e = self.effects[name]
        wide, wide_vector = widened(information, vector, np.hypot(e.wander, np.sqrt(np.diag(e.covariance))))
        rest = wide_vector - wide @ e.mean
        spread = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
        return float(np.sqrt(np.mean(np.square(spread * rest))))

    def misfits(self) -> tuple[Array, list[str], Array]:
        """Ends of the last hops (m,), balances' names and how badly each closed (m, balances)."""
        seen = np.array(self._misfits).reshape(-1, len(BALANCES))
        ends = np.empty(0)
        if len(seen):
            ends = np.asarray((self._last_hop - np.arange(len(seen))[::-1] + 1) * HOP_S, dtype=np.float64)
        used = np.isfinite(seen).any(axis=0)
        names = [n for n, u in zip(BALANCES, used, strict=True) if u]
        return np.asarray(ends, dtype=np.float64), names, np.asarray(np.nan_to_num(seen[:, used]))

    @property
    def _last_hop(self) -> int:
        return self.hops[-1]

    def fold(self, window: int) -> int:
        """Let hops beyond a window become the reference, a fifth of it at a time; how many have in all.

        A reference made of older hops is what the unit was like then; it may have moved since by what
        coefficients change
        within a healthy log.
        """
        part = window // 5
        while len(self.hops) > window + part:
            for name, e in self.reference.items():
                m, v = (np.array([x[i] for x in self.entries[name][:part]]) for i in (0, 1))
                m, v = widened(m, v, e.wander)
                prior = np.linalg.inv(e.covariance)
                covariance = np.linalg.inv(prior + m.sum(axis=0))
                mean = covariance @ (prior @ e.mean + v.sum(axis=0))
                covariance = 0.5 * (covariance + covariance.T) + np.diag(np.square(e.within))
                self.reference = {**self.reference, name: replace(e, mean=mean, covariance=covariance)}
                self.entries[name] = self.entries[name][part:]
            self.hops = self.hops[part:]
            self.folded += part
        return self.folded

    def state(self) -> dict[str, Array]:
        """Everything as flat named arrays."""
        out: dict[str, Array] = {
            "hops": np.array(self.hops), "tail": self.tail,
            "folded": np.array([self.folded]), "misfits": np.array(self._misfits).reshape(-1, len(BALANCES)),
        }  # fmt: skip
        for name, account in self.accounts.items():
            for k, part in zip("mvrs", self.sums()[name], strict=True):
                out[f"{name}/{k}"] = part
            out |= {
                f"{name}/information": np.array(account.information, dtype=np.float64),
                f"{name}/vector": np.array(account.vector),
            }
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
        self.folded = int(state["folded"][0])
        self._misfits = [[float(x) for x in row] for row in state["misfits"]]
        for name, account in self.accounts.items():
            m, v, r, s = (state[f"{name}/{k}"] for k in "mvrs")
            self.entries[name] = [(m[i], v[i], float(r[i]), float(s[i])) for i in range(len(self.hops))]
            account.information, account.vector = (
                state[f"{name}/information"].copy(),
                state[f"{name}/vector"].copy(),
            )
            account.weight, account.variance_sum = (float(x) for x in state[f"{name}/noise"])
            account.level = state[f"{name}/level"].copy()
            ends = np.cumsum(state[f"{name}/lengths"]).astype(np.int64)
            account.recent = np.split(state[f"{name}/recent"], ends[:-1]) if ends.size else []
            mean, covariance = state[f"{name}/mean"].copy(), state[f"{name}/covariance"].copy()
            self.reference = {
                **self.reference,
                name: replace(self.effects[name], mean=mean, covariance=covariance),
            }
