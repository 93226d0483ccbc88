"""Derivatives of model functions: by differences where none is given, and a check of those that are.

* Central differences, for filters without a Jacobian (:func:`jacobian`).
* Complex step, ``df/dx = Im f(x + i s) / s``, exact to rounding: there is no difference to cancel
  (Martins, Sturdza and Alonso 2003, doi 10.1145/838250.838251).
* Richardson-extrapolated central differences with an error estimate: Ridders 1982,
  doi 10.1016/S0141-1195(82)80057-0.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Ridders: the first step as a share of the state's scale, how fast the steps shrink, and how many.
FIRST_STEP, SHRINK, LEVELS = 0.02, 1.6, 9
COMPLEX_STEP = 1e-30  # of the scale: its square, the error, is far below rounding
# What rounding inside a function may cost, as a share of the largest term of its row.
ROUNDING_COMPLEX, ROUNDING_DIFFERENCES = 1e-13, 1e-10


def jacobian(function: Callable[[Array], ArrayLike], x: Array, P: Array) -> Array:
    """Derivative of ``function`` at ``x`` by central differences.

    Parameters
    ----------
    function : takes a vector (n,), gives m values.
    x : (n,) where.
    P : (n, n) covariance of x; its standard deviations, or ``|x|`` where larger, set the steps.

    Returns
    -------
    (m, n) array; error about 1e-10 of the scale for a smooth function.

    Examples
    --------
    >>> import numpy as np
    >>> jacobian(lambda x: [x[0] * x[1]], np.array([2.0, 3.0]), np.eye(2)).round(9).tolist()
    [[3.0, 2.0]]
    """
    scale = np.maximum(np.abs(x), np.sqrt(np.maximum(np.diag(P), 0.0)))
    scale[scale == 0.0] = 1.0
    columns = []
    for i, step in enumerate(np.cbrt(np.finfo(float).eps) * scale):
        ahead, behind = x.copy(), x.copy()
        ahead[i] += step
        behind[i] -= step
        width = ahead[i] - behind[i]
        upper, lower = np.asarray(function(ahead), float), np.asarray(function(behind), float)
        columns.append((upper.reshape(-1) - lower.reshape(-1)) / width)
    return np.ascontiguousarray(np.stack(columns, axis=1))


@dataclass(frozen=True)
class JacobianCheck:
    """Outcome of :func:`check_jacobian`.

    Attributes
    ----------
    given, expected : (m, n) the analytic Jacobian, and the numerical one it was compared with.
    wrong : (m, n) bool, True where they differ by more than ``allowed``.
    allowed : (m, n) the difference that was let pass: ``rtol`` of the entry, and what the
        numerical derivative itself may be off.
    method : ``"complex step"`` or ``"differences"``.
    """

    given: Array
    expected: Array
    wrong: NDArray[np.bool_]
    allowed: Array
    method: str

    @property
    def correct(self) -> bool:
        """True when no entry is off."""
        return not self.wrong.any()

    @property
    def worst(self) -> tuple[int, int]:
        """Row and column of the entry that is most off, in units of what is allowed."""
        excess = np.abs(self.given - self.expected) / self.allowed
        row, column = np.unravel_index(int(np.argmax(np.nan_to_num(excess, nan=np.inf))), excess.shape)
        return int(row), int(column)

    def require(self) -> None:
        """Raise a ``ValueError`` that names the wrong entries, if there are any."""
        if not self.correct:
            raise ValueError(str(self))

    def __str__(self) -> str:
        if self.correct:
            return f"Jacobian agrees with {self.method} in all {self.wrong.size} entries"
        row, column = self.worst
        places = ", ".join(f"[{i}, {j}]" for i, j in np.argwhere(self.wrong)[:8])
        more = ", ..." if self.wrong.sum() > 8 else ""
        return (
            f"Jacobian is off in {int(self.wrong.sum())} of {self.wrong.size} entries ({places}{more}); "
            f"the worst, [{row}, {column}], is {self.given[row, column]:.10g} "
            f"and by {self.method} {self.expected[row, column]:.10g}"
        )


def check_jacobian(
    function: Callable[..., ArrayLike],
    jacobian: Callable[..., ArrayLike],
    x: ArrayLike,
    *args: Any,
    scale: ArrayLike | None = None,
    rtol: float = 1e-6,
) -> JacobianCheck:
    """Compare an analytic Jacobian with a numerical one, entry by entry.

    The numerical one is the complex step where ``function`` allows it, else Richardson-
    extrapolated differences. Functions with ``abs``, ``maximum`` and the like take complex
    numbers and silently lose the derivative; so the complex step is believed only where the
    differences agree with it.

    Parameters
    ----------
    function : ``function(x, *args)`` gives m values; ``f`` or ``h`` of a filter.
    jacobian : ``jacobian(x, *args)`` gives (m, n).
    x : (n,) where. Try several places: at zero many a wrong entry is right by chance.
    args : the further arguments of both, e.g. ``u, dt``.
    scale : (n,) typical size of each state, e.g. its standard deviation; None: ``|x|``, or 1
        where that is 0. It sets the steps.
    rtol : relative error of an entry that is let pass.

    Returns
    -------
    JacobianCheck : true ``correct``, or which entries are ``wrong``; ``str()`` says it in a line.

    Raises
    ------
    ValueError : shapes that do not fit, a scale that is not positive, a function that gives NaN at x.

    Examples
    --------
    >>> def swing(x, u, dt):
    ...     return [x[0] + dt * x[1], x[1] + dt * (u - 9.81 * np.sin(x[0]))]
    >>> def swing_jacobian(x, u, dt):
    ...     return [[1.0, dt], [dt * 9.81 * np.cos(x[0]), 1.0]]
    >>> print(check_jacobian(swing, swing_jacobian, [0.3, 1.0], 0.0, 0.01))  # doctest: +ELLIPSIS
    Jacobian is off in 1 of 4 entries ([1, 0]); the worst, [1, 0], is 0.0937... by complex step -0.0937...
    """
    at = np.array(x, float).reshape(-1)
    size = np.where(at == 0.0, 1.0, np.abs(at)) if scale is None else np.array(scale, float).reshape(-1)
    if size.size != at.size or not (np.isfinite(size) & (size > 0.0)).all():
        raise ValueError(f"scale is {size}; give a positive size for each of {at.size} states")
    value = np.asarray(function(at.copy(), *args), float).reshape(-1)
    if not np.isfinite(value).all():
        raise ValueError(f"the function gives {value} at x; check it where it is defined")
    given = np.array(jacobian(at.copy(), *args), float)
    if given.size != value.size * at.size:
        raise ValueError(f"the Jacobian has shape {given.shape}; expected is {(value.size, at.size)}")
    given = given.reshape(value.size, at.size)
    expected, error = _extrapolated(lambda v: function(v, *args), at, size)
    # Differences cannot see below the rounding of the function's own value.
    row = (np.abs(expected) * size).max(axis=1, initial=0.0)
    rounding = np.maximum(row, np.abs(value))[:, None] / size
    error = 4.0 * error + ROUNDING_DIFFERENCES * rounding
    method = "differences"
    stepped = _complex_step(lambda v: function(v, *args), at, size, value.size)
    if stepped is not None and (np.abs(stepped - expected) <= error + 1e-7 * np.abs(expected)).all():
        expected, error, method = stepped, ROUNDING_COMPLEX * row[:, None] / size, "complex step"
    allowed = rtol * np.abs(expected) + error + np.finfo(float).tiny
    wrong = ~(np.abs(given - expected) <= allowed)  # NaN is wrong
    return JacobianCheck(given, expected, wrong, allowed, method)


def _complex_step(function: Callable[[Any], ArrayLike], x: Array, scale: Array, rows: int) -> Array | None:
    """Derivative by the complex step; None where the function does not take complex numbers."""
    out = np.empty((rows, x.size))
    for i in range(x.size):
        shifted = x.astype(complex)
        step = COMPLEX_STEP * scale[i]
        shifted[i] += 1j * step
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # a discarded imaginary part is a warning
                value = np.asarray(function(shifted), dtype=complex).reshape(-1)
        except Exception:  # whatever it is (math.sin, a compiled function, ...): not this way
            return None
        if value.size != rows or not np.isfinite(value).all():
            return None
        out[:, i] = value.imag / step
    return out


def _extrapolated(function: Callable[[Array], ArrayLike], x: Array, scale: Array) -> tuple[Array, Array]:
    """Derivative by Ridders' tableau, and its error estimate, per entry; both (m, n)."""
    derivative, error = [], []
    for i in range(x.size):
        best, best_error = None, None
        previous: list[Array] = []
        for level in range(LEVELS):
            step = FIRST_STEP * scale[i] / SHRINK**level
            ahead, behind = x.copy(), x.copy()
            ahead[i] += step
            behind[i] -= step
            width = ahead[i] - behind[i]
            with np.errstate(all="ignore"):  # a long step may leave the domain; a shorter one will not
                upper = np.asarray(function(ahead), float).reshape(-1)
                lower = np.asarray(function(behind), float).reshape(-1)
                row = [(upper - lower) / width]
            if best is None or best_error is None:
                best, best_error = row[0].copy(), np.full(row[0].shape, np.inf)
            for order, coarse in enumerate(previous, start=1):
                factor = SHRINK ** (2 * order)
                finer = (factor * row[-1] - coarse) / (factor - 1.0)
                guess = np.maximum(np.abs(finer - row[-1]), np.abs(finer - coarse))
                better = guess < best_error
                best[better], best_error[better] = finer[better], guess[better]
                row.append(finer)
            previous = row
        assert best is not None and best_error is not None
        derivative.append(best)
        error.append(best_error)
    return np.stack(derivative, axis=1), np.stack(error, axis=1)
