"""Compiled normal equations of frames: sums of products over regression rows, then weights by the rows'
residual variance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.linalg import cholesky, cholesky_solve
from fdd.residuals.compiled import njit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

RIDGE = 1e-6
"""Ridge penalty on columns scaled to one: collinear columns share the effect."""


@njit()
def add_rows(
    y: Array, x: Array, ok: Flags, noisy: Array, tail: int, least: int, summed: bool,
    gram: Array, noise: Array, rows: Array,
) -> None:  # fmt: skip
    """Add each frame's regression rows to its normal equations.

    Rows themselves; or, `summed`, their running sums over each unbroken stretch less their mean, in which
    pressure noise does not add up, without the first one, which the mean makes redundant.

    Parameters
    ----------
    y, x, ok : (tail + rows,), (tail + rows, n) and (tail + rows,): rows of a block, the valid ones.
    noisy : (tail + rows, 2, n) noise that the columns have in these sums, or (0, 2, n).
    tail : rows before the first frame. least : fewest rows of a stretch, or of a frame, that count.
    gram, noise, rows : (frames, n + 1, n + 1) of columns and y, (frames, n, n) and (frames,); added to.
    """
    frames, n = noise.shape[0], x.shape[1]
    size = (y.size - tail) // frames
    part = np.empty((size, n + 1))
    for h in range(frames):
        first, last = tail + h * size, tail + (h + 1) * size
        before = rows[h]
        count = inside = 0
        for k in range(first, last + 1):
            if k < last and ok[k]:
                inside += 1
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
        if noisy.shape[0] and rows[h] > before:
            share = (rows[h] - before) / inside
            for k in range(first, last):
                if ok[k]:
                    for c in range(2):
                        for i in range(n):
                            for j in range(n):
                                noise[h, i, j] += share * noisy[k, c, i] * noisy[k, c, j]


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


@njit()
def weight_equations(
    gram: Array, noise: Array, rows: Array, mean: Array, least: float, lowest: float, memory: float,
    usual: Array, information: Array, vector: Array, variance: Array,
) -> None:  # fmt: skip
    """Divide frames' normal equations by the variance of their rows (weighted least squares).

    The variance is the mean square residual of a frame's own least squares, or that of the last seconds, if
    more.

    Parameters
    ----------
    gram, noise, rows : of `add_rows`. mean : (n,) coefficients of the healthy unit.
    least : fewest rows of a frame that count. lowest : lower bound of the variance.
    memory : share of `usual` that is kept from frame to frame.
    usual : (2,) sum of squares and of weights so far; goes on.
    information, vector, variance : (frames, n, n), (frames, n) and (frames,), filled.
    """
    n = mean.size
    scaled, root, best, scale = np.empty((n, n)), np.zeros((n, n)), np.empty((1, n)), np.empty(n)
    for h in range(rows.size):
        if rows[h] < least:
            rows[h] = 0.0
            information[h], vector[h], variance[h] = 0.0, 0.0, usual[0] / usual[1]
            continue
        g = gram[h]
        seen = 0
        for i in range(n):
            scale[i] = 1.0 / np.sqrt(max(g[i, i], 1e-300))
            seen += g[i, i] > 0.0
        for i in range(n):
            for j in range(n):
                scaled[i, j] = g[i, j] * scale[i] * scale[j]
            scaled[i, i] += RIDGE
            best[0, i] = g[i, n] * scale[i]
        cholesky(scaled, root)
        cholesky_solve(root, best)
        left = g[n, n]
        for i in range(n):
            left -= g[i, n] * scale[i] * best[0, i]
        left = max(left, 1e-12 * g[n, n])
        free = max(rows[h] - seen, 0.3 * rows[h])
        usual[0] = memory * usual[0] + left
        usual[1] = memory * usual[1] + free
        variance[h] = max(left / free, usual[0] / usual[1], lowest)
        # Errors in variables attenuate the coefficients: what they take from the healthy unit's is put back.
        for i in range(n):
            back = g[i, n]
            for j in range(n):
                back += noise[h, i, j] * mean[j]
                information[h, i, j] = g[i, j] / variance[h]
            vector[h, i] = back / variance[h]
