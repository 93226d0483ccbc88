"""Derivatives of model functions by central differences: where none is given, and to check those that are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Richardson's extrapolation: the longest step as a share of the state's scale.
LONGEST_STEP = 4e-3
# What rounding inside a function may cost, as a share of the largest term of its row.
ROUNDING = 1e-10


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
    return _differences(function, x, np.cbrt(np.finfo(float).eps) * scale)


def _differences(function: Callable[[Array], ArrayLike], x: Array, steps: Array) -> Array:
    """Central differences (m, n) with these steps (n,)."""
    columns = []
    for i, step in enumerate(steps):
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
    """

    given: Array
    expected: Array
    wrong: NDArray[np.bool_]
    allowed: Array

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
            return f"Jacobian agrees with differences in all {self.wrong.size} entries"
        row, column = self.worst
        places = ", ".join(f"[{i}, {j}]" for i, j in np.argwhere(self.wrong)[:8])
        more = ", ..." if self.wrong.sum() > 8 else ""
        return (
            f"Jacobian is off in {int(self.wrong.sum())} of {self.wrong.size} entries ({places}{more}); "
            f"the worst, [{row}, {column}], is {self.given[row, column]:.10g} "
            f"and by differences {self.expected[row, column]:.10g}"
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

    The numerical one is that of central differences, extrapolated to a step of zero (Richardson), whose
    last correction is its error estimate.

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
    Jacobian is off in 1 of 4 entries ([1, 0]); the worst, [1, 0], is 0.0937... by differences -0.0937...
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
    first, second, third = (
        _differences(lambda v: function(v, *args), at, LONGEST_STEP / halving * size) for halving in (1, 2, 4)
    )
    coarse, fine = (4.0 * second - first) / 3.0, (4.0 * third - second) / 3.0
    expected = (16.0 * fine - coarse) / 15.0
    # Differences cannot see below the rounding of the function's own value.
    row = (np.abs(expected) * size).max(axis=1, initial=0.0)
    rounding = np.maximum(row, np.abs(value))[:, None] / size
    error = 4.0 * np.abs(expected - fine) + ROUNDING * rounding
    allowed = rtol * np.abs(expected) + error + np.finfo(float).tiny
    wrong = ~(np.abs(given - expected) <= allowed)  # NaN is wrong
    return JacobianCheck(given, expected, wrong, allowed)
