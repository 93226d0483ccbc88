"""Weighted normal equations of one balance's regression, frame by frame.

A frame is weighted by the variance of its own rows, so a noisy sensor or a gusty minute counts for less.
Correlated errors, of a load or a slow current, are filtered out of the left side and the columns alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.balances import Balance, RegressionBlock
from fdd.residuals.bins import BIN_S, FRAME_BINS, TAIL_BINS
from fdd.residuals.effects import Effects
from fdd.residuals.normal_equations import NormalEquations
from fdd.residuals.sums import RIDGE, add_rows, weight_equations

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_ROWS = 12
"""Fewest rows of a stretch of a frame that count."""
MEMORY = 0.95
"""Forgetting factor of the noise's statistics from frame to frame: a time constant of ten seconds."""
RECENT_FRAMES = 20
"""Frames of that memory where rows themselves are kept."""
MOST_COLOUR = 0.95
"""Upper bound of the lag-one correlation of rows: ten seconds do not determine a larger one."""
NOISE_FLOOR = 0.1
"""Lower bound of the noise over the unit's usual one: at standstill an encoder may show none."""
LOAD_S = 1.0
"""s, time constant of the high-pass filter against a load: in it the load changes as much as friction does
when the piston reverses."""
FIRST_WEIGHT = 100.0
"""Rows that the initial noise counts for."""


class RegressionAccumulator:
    """Accumulates one balance's regression: normal equations, noise variance, correlation of errors.

    Parameters
    ----------
    balance : which. effects : prior mean and spread of its coefficients, and initial noise.
    """

    def __init__(self, balance: Balance, effects: Effects) -> None:
        self.balance = balance
        self.mean = effects.mean
        self.size = effects.mean.size
        self.weight = FIRST_WEIGHT
        known = balance.cumulative and effects.information.any()
        self.least = max((1.0 if known else NOISE_FLOOR) * effects.noise, balance.floor) ** 2
        self.usual = effects.noise**2
        self.variance_sum = FIRST_WEIGHT * self.usual
        self.recent: list[Array] = []
        self.level: Array = np.zeros((1, effects.mean.size + 1))
        # Of the lines so far, by sense of turning, as cosine and sine.
        self.phasors: Array = np.zeros((2, balance.lines, 2))

    def equations(self, blocks: Sequence[RegressionBlock]) -> list[NormalEquations]:
        """Normal equations of frames.

        Parameters
        ----------
        blocks : rows of one frame or more, with `TAIL_BINS` before them.
        """
        count = (blocks[0].y.size - TAIL_BINS) // FRAME_BINS
        if self.balance.lines or self.balance.bins_per_row > 1:
            starts = range(0, count * FRAME_BINS, FRAME_BINS)
            return [
                self._frame_equations([s.part(slice(k, k + TAIL_BINS + FRAME_BINS)) for s in blocks])
                for k in starts
            ]
        n = self.size
        gram, noise, rows = np.zeros((count, n + 1, n + 1)), np.zeros((count, n, n)), np.zeros(count)
        for y, x, ok, noisy in blocks:
            noisy = np.empty((0, 2, n)) if noisy is None else np.ascontiguousarray(noisy)
            y, x = np.ascontiguousarray(y), np.ascontiguousarray(x)
            add_rows(y, x, ok, noisy, TAIL_BINS, LEAST_ROWS, self.balance.cumulative, gram, noise, rows)
        information, vector, variance = np.empty((count, n, n)), np.empty((count, n)), np.empty(count)
        usual = np.array([self.variance_sum, self.weight])
        weight_equations(
            gram, noise, rows, self.mean, LEAST_ROWS, self.least, MEMORY, usual, information, vector, variance
        )
        self.variance_sum, self.weight = usual.tolist()
        return [*map(NormalEquations, information, vector, rows.tolist(), variance.tolist())]

    def _frame_equations(self, blocks: Sequence[RegressionBlock]) -> NormalEquations:
        """Normal equations of one frame whose rows are means of several bins, or spectral lines."""
        n = blocks[0].x.shape[1]
        parts = [self._rows(y, x, ok) for y, x, ok, _ in blocks]
        rows = np.concatenate(parts) if len(parts) > 1 else parts[0]
        free = float(rows.shape[0])
        if free < LEAST_ROWS // self.balance.bins_per_row:
            none = np.zeros((self.size, self.size))
            return NormalEquations(none, np.zeros(self.size), 0.0, self.variance_sum / self.weight)
        gram = rows.T @ rows
        if self.balance.lines:
            return self._amplitudes(gram, int(np.nanmean(blocks[0].x[-FRAME_BINS:, -1]) > 0.0), free)
        variance = self._coloured(rows)
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
        scale = 1.0 / np.sqrt(np.diag(gram)[:n].clip(1e-300))
        inverse = (
            np.linalg.inv(gram[:n, :n] * scale * scale[:, None] + RIDGE * np.eye(n)) * scale * scale[:, None]
        )
        size = inverse @ gram[:n, n]
        variance = max((gram[n, n] - size @ gram[:n, n]) / max(free - n, 0.3 * free), self.least)
        now, before = size[: 2 * lines].reshape(lines, 2), self.phasors[sense].copy()
        self.phasors[sense] = MEMORY * before + now
        spread = variance * np.diag(inverse)[: 2 * lines].reshape(lines, 2).mean(axis=1)
        self.variance_sum = MEMORY * self.variance_sum + float(spread.mean())
        self.weight = MEMORY * self.weight + 1.0
        if not before.any():
            none = np.zeros((self.size, self.size))
            return NormalEquations(none, np.zeros(self.size), 0.0, variance)
        amplitude = np.sum(before * now, axis=1) / np.hypot(before[:, 0], before[:, 1])
        spread = np.maximum(spread, self.variance_sum / self.weight)
        return NormalEquations(np.diag(1.0 / spread), amplitude / spread, free, variance)

    def _coloured(self, rows: Array) -> float:
        """Effective variance of rows with errors of a first-order autoregression.

        It is the mean square residual of the last ten seconds' least squares, times (1 + ρ)/(1 - ρ). The
        model error of a law (a load's own dynamics) is correlated over more rows than a frame has.
        """
        self.recent = [*self.recent[-RECENT_FRAMES + 1 :], rows]
        joined = np.concatenate(self.recent)
        x, y = joined[:, :-1], joined[:, -1]
        scale = 1.0 / np.sqrt(np.square(x).sum(axis=0).clip(1e-300))
        scaled = x * scale
        left = y - scaled @ np.linalg.solve(scaled.T @ scaled + RIDGE * np.eye(scale.size), scaled.T @ y)
        square = max(float(left @ left), 1e-300)
        rho = float(left[1:] @ left[:-1]) / square
        rho += (
            1.0 + 3.0 * rho
        ) / y.size  # bias of the lag-one correlation of few rows (doi 10.1093/biomet/41.3-4.390)
        rho = min(max(rho, 0.0), MOST_COLOUR)
        free = max(y.size - scale.size, 0.3 * y.size)
        found = square / free * (1.0 + rho) / (1.0 - rho)
        # The log's first frames determine their noise badly: the unit's usual one counts as some rows.
        usual = FIRST_WEIGHT / self.balance.bins_per_row
        return max((free * found + usual * self.usual) / (free + usual), self.least)

    def _rows(self, y: Array, x: Array, ok: Flags) -> Array:
        """Regression rows of the frame, means of `Balance.bins_per_row` bins, less what changes slowly; none
        if they are too few."""
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
