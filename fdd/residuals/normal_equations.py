"""Normal equations of a balance's regression, frame by frame, and the marginal ones where coefficients are
random effects.

A frame is weighted by the variance of its own rows, so a noisy sensor or a gusty minute counts for less.
Correlated errors, of a load or a slow current, are filtered out of the left side and the columns alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fdd.residuals.balances import Balance, RegressionBlock
from fdd.residuals.bins import BIN_S, FRAME_BINS, TAIL_BINS
from fdd.residuals.compiled import Array, Flags, njit
from fdd.residuals.effects import Effects
from fdd.restorable import Restorable

RIDGE = 1e-6
"""Ridge penalty on columns scaled to one: collinear columns share the effect."""
LEAST_ROWS = 12
"""Fewest rows of a stretch of a frame that count."""
MEMORY = 0.95
"""Forgetting factor of the noise's statistics from frame to frame: a time constant of ten seconds."""
RECENT_FRAMES = 20
"""Frames of that memory where rows themselves are kept: ten seconds, whether a machine moves or stands."""
MOST_COLOUR = 0.95
"""Upper bound of the lag-one correlation of rows: ten seconds do not determine a larger one."""
NOISE_FLOOR = 0.1
"""Lower bound of the noise over the unit's usual one: at standstill an encoder may show none."""
LOAD_S = 1.0
"""s, time constant of the high-pass against a load: in it that changes as much as friction at a reversal."""
FIRST_WEIGHT = 100.0
"""Rows that the initial noise counts for."""


def marginalised(information: Array, vector: Array, std: Array) -> tuple[Array, Array]:
    """Normal equations with a random effect marginalised: their coefficients differ by N(0, Q = diag(std²))
    from those sought.

    Information (…, n, n) ``M (I + Q M)⁻¹`` and vector (…, n) ``(I + M Q)⁻¹ m``, by the eigenvalues of
    ``√Q M √Q``, which keeps the information positive semidefinite however unequal the columns' scales are.
    """
    values, vectors = np.linalg.eigh(information * std * std[:, None])
    values = values.clip(0.0)[..., None, :]
    turned = np.swapaxes(vectors, -1, -2)
    wide = (vectors * (values / (1.0 + values))) @ turned / std / std[:, None]
    kept = ((vectors / (1.0 + values)) @ turned @ (vector * std)[..., None])[..., 0] / std
    return wide, kept


class NormalEquations(NamedTuple):
    """Of a balance in one frame: information (n, n) ``XᵀX/σ²`` and vector (n,) ``Xᵀy/σ²``, the number of rows
    behind them, and their variance σ²."""

    information: Array
    vector: Array
    rows: float
    variance: float


class RegressionAccumulator(Restorable):
    """Accumulates one balance's regression: normal equations, noise variance, correlation of errors. Of the
    effects it takes the coefficients' mean and the initial noise."""

    STATE = ("weight", "variance_sum", "recent", "seen", "level", "phasors")

    def __init__(self, balance: Balance, effects: Effects) -> None:
        self.balance = balance
        self.mean = effects.mean
        self.size = effects.mean.size
        self.weight = FIRST_WEIGHT / balance.bins_per_row
        known = balance.cumulative and effects.information.any()
        self.least = max((1.0 if known else NOISE_FLOOR) * effects.noise, balance.floor) ** 2
        self.usual = effects.noise**2
        self.variance_sum = self.weight * self.usual
        self.recent: list[Array] = []
        self.seen = 0
        self.level: Array = np.zeros((1, effects.mean.size + 1))
        # Of the lines so far, by sense of turning, as cosine and sine.
        self.phasors: Array = np.zeros((2, balance.lines, 2))

    def equations(self, blocks: Sequence[RegressionBlock]) -> list[NormalEquations]:
        """Normal equations of one frame or more, whose rows the blocks hold with `TAIL_BINS` before them."""
        count = (blocks[0].y.size - TAIL_BINS) // FRAME_BINS
        if self.balance.lines or self.balance.bins_per_row > 1:
            [(y, x, ok, _)] = blocks
            frames = (slice(k * FRAME_BINS, (k + 1) * FRAME_BINS + TAIL_BINS) for k in range(count))
            return [
                self._frame_equations(self._rows(y[f], x[f], ok[f]), x[f][-FRAME_BINS:, -1]) for f in frames
            ]
        n = self.size
        gram, noise, rows = np.zeros((count, n + 1, n + 1)), np.zeros((count, n, n)), np.zeros(count)
        for y, x, ok, noisy in blocks:
            before = rows.copy()
            y, x = np.ascontiguousarray(y), np.ascontiguousarray(x)
            add_rows(y, x, ok, TAIL_BINS, LEAST_ROWS, self.balance.cumulative, gram, rows)
            if noisy is not None:
                valid = ok[TAIL_BINS:]
                share = (rows - before) / valid.reshape(count, -1).sum(axis=1).clip(1)
                part = (noisy[TAIL_BINS:] * valid[:, None, None]).reshape(count, -1, n)
                noise += share[:, None, None] * (np.swapaxes(part, 1, 2) @ part)
        return self._weighted(gram, noise, rows)

    def _weighted(self, gram: Array, noise: Array, rows: Array) -> list[NormalEquations]:
        """What `add_rows` summed up, divided by the variance of each frame's rows (weighted least squares).

        That is the mean square residual of the frame's own least squares, or of the last seconds', if more.
        """
        information, moment, square = gram[:, :-1, :-1], gram[:, :-1, -1], gram[:, -1, -1]
        diagonal = np.einsum("hii->hi", information)
        scale = 1.0 / np.sqrt(diagonal.clip(1e-300))
        scaled = information * scale[:, :, None] * scale[:, None] + RIDGE * np.eye(self.size)
        best = np.linalg.solve(scaled, (moment * scale)[..., None])[..., 0]
        left = np.maximum(square - np.sum(moment * scale * best, axis=1), 1e-12 * square).tolist()
        free = np.maximum(rows - np.count_nonzero(diagonal, axis=1), 0.3 * rows).tolist()
        # Errors in variables attenuate the coefficients: what they take from the healthy unit's is put back.
        vector = moment + noise @ self.mean
        out = []
        for h, count in enumerate(rows.tolist()):
            if count < LEAST_ROWS:
                out.append(self._nothing())
                continue
            self.variance_sum = MEMORY * self.variance_sum + left[h]
            self.weight = MEMORY * self.weight + free[h]
            variance = max(left[h] / free[h], self.variance_sum / self.weight, self.least)
            out.append(NormalEquations(information[h] / variance, vector[h] / variance, count, variance))
        return out

    def _nothing(self) -> NormalEquations:
        """Of a frame without enough rows."""
        none = np.zeros((self.size, self.size))
        return NormalEquations(none, np.zeros(self.size), 0.0, self.variance_sum / self.weight)

    def _frame_equations(self, rows: Array, sense: Array) -> NormalEquations:
        """Normal equations of one frame whose rows are means of several bins, or spectral lines, whose last
        column has the sense of turning."""
        n, free = rows.shape[1] - 1, float(rows.shape[0])
        if not self.balance.lines:  # also without rows, or what moves seldom would remember for minutes
            self.recent = [*self.recent[1 - RECENT_FRAMES :], rows]
        if free < LEAST_ROWS // self.balance.bins_per_row:
            return self._nothing()
        gram = rows.T @ rows
        if self.balance.lines:
            return self._amplitudes(gram, int(np.nanmean(sense) > 0.0), free)
        self.seen += 1
        variance = self._coloured(free)
        return NormalEquations(gram[:n, :n] / variance, gram[:n, n] / variance, free, variance)

    def _amplitudes(self, gram: Array, sense: int, free: float) -> NormalEquations:
        """Normal equations of the lines' amplitudes, in phase with the frames before in this sense.

        A line keeps its phase to the shaft's angle. Noise and vibration of another frequency, as stick-slip,
        do not: their amplitude in that phase has mean zero, where their modulus has not (synchronous
        averaging: Braun 1975, Acustica 32, 69). A count that the encoder loses shifts the phase, and is
        forgotten within `MEMORY`.
        """
        lines = self.balance.lines
        n = gram.shape[0] - 1
        inverse = _ridge_inverse(gram[:n, :n])
        size = inverse @ gram[:n, n]
        variance = float(max((gram[n, n] - size @ gram[:n, n]) / max(free - n, 0.3 * free), self.least))
        now, before = size[: 2 * lines].reshape(lines, 2), self.phasors[sense].copy()
        self.phasors[sense] = MEMORY * before + now
        spread = variance * np.diag(inverse)[: 2 * lines].reshape(lines, 2).mean(axis=1)
        self.variance_sum = MEMORY * self.variance_sum + float(spread.mean())
        self.weight = MEMORY * self.weight + 1.0
        if not before.any():
            return self._nothing()
        amplitude = np.sum(before * now, axis=1) / np.hypot(before[:, 0], before[:, 1])
        spread = np.maximum(spread, self.variance_sum / self.weight)
        return NormalEquations(np.diag(1.0 / spread), amplitude / spread, free, variance)

    def _coloured(self, rows: float) -> float:
        """Effective variance of rows with errors of a first-order autoregression.

        It is the mean square residual of the last ten seconds' least squares, times (1 + ρ)/(1 - ρ). The
        model error of a law (a load's own dynamics) is correlated over more rows than a frame has. What
        happened longer ago is not fitted with them: a fault since then would pass for noise.
        """
        joined = np.concatenate(self.recent)
        x, y = joined[:, :-1], joined[:, -1]
        left = y - x @ (_ridge_inverse(x.T @ x) @ (x.T @ y))
        square = max(float(left @ left), 1e-300)
        rho = float(left[1:] @ left[:-1]) / square
        # Bias of the lag-one correlation of few rows (doi 10.1093/biomet/41.3-4.390).
        rho += (1.0 + 3.0 * rho) / y.size
        rho = min(max(rho, 0.0), MOST_COLOUR)
        free = max(y.size - x.shape[1], 0.0)
        found = square / max(free, 0.3 * y.size) * (1.0 + rho) / (1.0 - rho)
        # Few rows tell little of their noise: the unit's usual, or the log's so far if more, counts as some.
        count = FIRST_WEIGHT / self.balance.bins_per_row
        usual = max(self.usual, self.variance_sum / self.weight)
        variance = (free * found + count * usual) / (free + count)
        if fresh := free * rows / y.size:  # else what is known would fade to nothing
            self.variance_sum = MEMORY * self.variance_sum + fresh * found
            self.weight = MEMORY * self.weight + fresh
        return max(variance, self.least)

    def _rows(self, y: Array, x: Array, ok: Flags) -> Array:
        """Rows of a frame, means of `Balance.bins_per_row` bins, less what is slow; none if too few."""
        joined = np.column_stack([x, y])
        bins_per_row = self.balance.bins_per_row
        if bins_per_row > 1:  # the law holds over tens of ms: whitening must not reach where it fails
            joined = joined.reshape(-1, bins_per_row, joined.shape[1]).mean(axis=1)
            ok = np.asarray(ok.reshape(-1, bins_per_row).all(axis=1))
        frame, least = FRAME_BINS // bins_per_row, max(LEAST_ROWS // bins_per_row, 1)
        if self.balance.lines:  # slow currents are no vibration; columns and left side are filtered alike
            joined, ok = np.diff(joined, axis=0), ok[1:] & ok[:-1]
        inside = joined[-frame:][ok[-frame:]]
        if bins_per_row > 1:
            inside = self._passed(inside)
        return inside if inside.shape[0] >= least else inside[:0]

    def _passed(self, rows: Array) -> Array:
        """High-pass filter against a load that changes slowly.

        It is the prediction error of a random walk under white noise, applied to left side and columns alike.
        """
        if not rows.size:
            return rows
        if not self.level.any():
            self.level = -rows[:1]  # as if it had always been so
        decay = 1.0 - self.balance.bins_per_row * BIN_S / LOAD_S
        out = np.empty_like(rows)
        for k in range(rows.shape[0]):  # ten rows a frame: importing scipy.signal would take as long as a log
            out[k] = rows[k] + self.level[0]
            self.level = decay * out[k : k + 1] - rows[k : k + 1]
        return out


def _ridge_inverse(gram: Array) -> Array:
    """Inverse of ``XᵀX`` (n, n) with a ridge penalty on columns scaled to one."""
    scale = 1.0 / np.sqrt(np.diag(gram).clip(1e-300))
    inverse = np.linalg.inv(gram * scale * scale[:, None] + RIDGE * np.eye(scale.size))
    return np.asarray(inverse * scale * scale[:, None])


@njit()
def add_rows(
    y: Array, x: Array, ok: Flags, tail: int, least: int, summed: bool, gram: Array, rows: Array
) -> None:
    """Add each frame's regression rows to its normal equations.

    Rows themselves; or, `summed`, their running sums over each unbroken stretch less their mean, in which
    pressure noise does not add up, without the first one, which the mean makes redundant.

    Parameters
    ----------
    y, x, ok : (tail + rows,), (tail + rows, n) and (tail + rows,): rows of a block, the valid ones.
    tail : rows before the first frame. least : fewest rows of a stretch, or of a frame, that count.
    gram, rows : (frames, n + 1, n + 1) of columns and y, and (frames,); added to.
    """
    frames, n = rows.size, x.shape[1]
    size = (y.size - tail) // frames
    part = np.empty((size, n + 1))
    for h in range(frames):
        first, last = tail + h * size, tail + (h + 1) * size
        count = 0
        for k in range(first, last + 1):
            if k < last and ok[k]:
                part[count, :n], part[count, n] = x[k], y[k]
                if summed and count:
                    part[count] += part[count - 1]
                count += 1
            if k == last or (summed and not ok[k]):
                if count >= least:
                    if summed:
                        _take_means_out(part, count)
                    begin = 1 if summed else 0
                    _add_products(part, begin, count, gram[h])
                    rows[h] += count - begin
                count = 0


@njit()
def _take_means_out(part: Array, count: int) -> None:
    """Take each column's mean out of the first rows. Numba's own mean would load SciPy's linear algebra."""
    for j in range(part.shape[1]):
        mean = 0.0
        for k in range(count):
            mean += part[k, j]
        mean /= count
        for k in range(count):
            part[k, j] -= mean


@njit()
def _add_products(part: Array, begin: int, end: int, gram: Array) -> None:
    """Add ``part[begin:end]' part[begin:end]`` to a symmetric matrix."""
    n = part.shape[1]
    for k in range(begin, end):
        for i in range(n):
            for j in range(n):
                gram[i, j] += part[k, i] * part[k, j]
