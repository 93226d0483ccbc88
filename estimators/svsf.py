"""Smooth variable structure filter: keeps hold of the state when the model is wrong.

A Kalman filter trusts its covariances; when the plant changes, it lags. The SVSF instead
forces the measured part of the state into a band around the measurement that is as wide as
the *boundary layer* ``psi``. Per channel, with ``e = z - h(x_prior)``, the posterior error
``e_post`` of the step before, and ``E = |e| + gamma |e_post|``::

    correction  k = E sat(e / psi)      sat(a) = a for |a| <= 1, else sgn(a)
    state       x <- x + H+ k           H+ = P H' (H P H')^-1
    covariance  P <- (I - K H) P (I - K H)' + K R K',   K e = H+ k

Outside the layer the posterior error becomes ``-gamma |e_post| sgn(e)``, whatever the model:
it contracts by ``gamma`` each step. Inside, the correction falls off with the square of ``e``.

Three forms, with the ratio ``r = E / psi`` inside the layer, ``E / |e|`` outside (never a division by a
small ``e``: inside it is ``psi`` that divides)::

    full       m = n   K = H^-1 diag(r)                                     Habibi 2007
    subspace   m <= n  K = P H' (H P H')^-1 diag(r)                         estimators.kernels.svsf_gain
    reduced    m < n   K = T^-1 [diag(r); diag(r_y) A],  A = Phi22 Phi12+   Habibi 2007

In the subspace form ``H+`` carries the correction to unmeasured states through the covariance, as a Kalman
filter would (:func:`estimators.kernels.svsf_gain` shows why no separate Kalman term is left over).
The reduced form sorts the states by a Luenberger-type transform ``T x = [z; y]`` with ``y`` the
unmeasured ones, so that ``H T^-1 = [I 0]``, and splits ``Phi = T F T^-1`` into ``Phi12`` (how
``y`` drives ``z`` in one step) and ``Phi22``. ``Phi12+ e`` is the error of ``y`` that would explain
``e``, ``w = A e`` what became of it, and ``E_y = |w| + gamma |Phi12+ e|`` is set against a layer
``psi_y`` of its own. The covariance is in Joseph form in all.

With ``boundary_layer="variable"`` the layer that minimises the trace of P is computed,
``psi_k = S (H P H')^-1 diag(E)``, and for unmeasured states, where n = 2 m, ``A S P21^-1 diag(E_y)`` with
``P21`` the y rows of ``T P H'``. As long as its diagonal stays below the limit ``psi``, the
gain *is* the Kalman gain; beyond, the gain above, with ``psi`` as the layer, takes over.
``psi_k`` grows as the filter becomes sure of itself, also on a healthy plant: take the limit
from a high quantile of ``psi_k`` over healthy runs, channel by channel, and again after
every change of Q or R.

``psi_k``, ``outside`` and ``chattering`` show that something changed, but they are tests of
single samples: to *detect*, put a CUSUM or a windowed NIS on the innovations.

Sources: Habibi 2007, doi 10.1109/JPROC.2007.893255; covariance: Gadsden and Habibi 2010, 49th
IEEE CDC, 7389-7394; optimal layers: Gadsden and Habibi 2013, doi 10.1115/1.4006628.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.checks import Array, Mask, layer_widths, require_finite
from estimators.ekf import Correction, ExtendedKalmanFilter, Model
from estimators.kernels import svsf_gain
from estimators.linalg import joseph_update, project

# Beyond 1 / sqrt(eps) an inverse leaves less than half of the digits of the error.
CONDITION_LIMIT = 1.0 / float(np.sqrt(np.finfo(float).eps))


@dataclass
class Gain:
    """Gain of one update and what is reported of it; meanings and shapes as in :class:`SVSF`.

    K (n, m) is over the channels used, None where the Kalman gain is to be applied. ``forced``: the measured
    rows are the SVSF's, which contracts what is outside.
    """

    K: Array | None
    psi_k: Array
    outside: Mask
    forced: bool
    form: str = "subspace"
    condition: float = 1.0
    psi_k_y: Array = field(default_factory=lambda: np.empty(0))
    outside_y: Mask = field(default_factory=lambda: np.empty(0, dtype=bool))
    amplification: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Problem:
    """One update, over the channels used: prior P (n, n), H (m, n), R (m, m), innovation e and
    previous posterior error e_post (m,), memory gamma, layer psi (m,), and whether it is variable."""

    P: Array
    H: Array
    R: Array
    e: Array
    e_post: Array
    gamma: float
    psi: Array
    variable: bool


@dataclass
class SVSFCorrection(Correction):
    """What an update of an :class:`SVSF` gives besides: posterior error (m,) and the gain that was found."""

    after: Array
    gain: Gain


class SVSF(ExtendedKalmanFilter):
    """Smooth variable structure filter on the interface of :class:`ExtendedKalmanFilter`.

    Parameters
    ----------
    dim_x, dim_z, dim_u, f, h, F_jacobian, H_jacobian : as in :class:`ExtendedKalmanFilter`.
        There is no ``robust``: an SVSF follows what that would disbelieve.
    psi : boundary layer per channel (m,) or one for all, in the units of z, > 0. A few standard
        deviations of measurement noise plus expected model error; the limit of ``psi_k`` when
        the layer is variable, where infinity gives a plain Kalman filter.
    gamma : memory, 0 <= gamma < 1; smaller converges faster.
    boundary_layer : ``"fixed"``, or ``"variable"`` for the Kalman gain inside the limit.
    form : ``"subspace"``: covariance-weighted, any m. ``"full"``: the original, for m = n.
        ``"reduced"``: Luenberger-type transform, for m < n; with a variable layer for n = 2 m. It
        divides by how far the unmeasured states move the measured ones in *one* step, and
        so multiplies noise by the sample rate: see ``amplification``.
    psi_y : reduced form: layer of the unmeasured states (n - m,) or one for all, in their units.
    unmeasured : reduced form: indices of the n - m states that count as not measured. None: those
        that no channel sees directly.

    Attributes
    ----------
    e_post : (m,) posterior error ``z - h(x)``; a missing channel keeps its last.
    psi_k : (m,) optimal boundary layer of the last update, NaN where a channel was missing. Above ``psi`` a
        variable layer switches.
    outside : (m,) bool, ``|e| > psi`` at the last update.
    switched : True when the last update applied the SVSF's gain and not the Kalman gain.
    chattering : (m,) share of the updates so far with ``outside``, NaN before the first.
    form_used, condition : form of the last update, ``"subspace"`` where the one asked for was not
        applicable (a channel missing, or ``condition``, of the matrix to be inverted, above 7e7).
    psi_k_y, outside_y, amplification : (n - m,) of the reduced form: optimal layer (for n = 2 m);
        correction beyond ``psi_y``; its standard deviation under noise alone, in units of ``psi_y``.

    Raises
    ------
    ValueError : as the base class, and for a psi, gamma, boundary_layer or form that does not fit.

    Examples
    --------
    A constant that jumps by 5 at the sixth sample; the Kalman filter of the same tuning
    still lags by 4.2 at the end, the SVSF by less than its layer:

    >>> import numpy as np
    >>> kf, svsf = ExtendedKalmanFilter(1, 1), SVSF(1, 1, psi=0.5, boundary_layer="variable")
    >>> for filt in (kf, svsf):
    ...     filt.H, filt.Q, filt.R = [[1.0]], 1e-6, 1e-2
    ...     for z in [0.0] * 5 + [5.0] * 1:
    ...         filt.predict()
    ...         filt.update(z)
    >>> round(kf.x.item(), 2), round(svsf.x.item(), 2), svsf.switched, svsf.chattering.round(2).tolist()
    (0.83, 5.0, True, [0.17])
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        psi: ArrayLike,
        gamma: float = 0.1,
        boundary_layer: str = "fixed",
        form: str = "subspace",
        psi_y: ArrayLike | None = None,
        unmeasured: Sequence[int] | None = None,
        f: Model | None = None,
        h: Model | None = None,
        F_jacobian: Model | None = None,
        H_jacobian: Model | None = None,
    ) -> None:
        super().__init__(dim_x, dim_z, dim_u, f=f, h=h, F_jacobian=F_jacobian, H_jacobian=H_jacobian)
        self.psi: Any = psi
        self.psi_y: Any = psi_y
        self.gamma = gamma
        self.boundary_layer, self.form = boundary_layer, form
        self.unmeasured = None if unmeasured is None else [int(i) for i in unmeasured]
        self._check_form()
        self._layers()
        n, m = self.dim_x, self.dim_z
        unseen = n - m if form == "reduced" else 0
        self.e_post = np.zeros(m)
        self.psi_k = np.full(m, np.nan)
        self.outside = np.zeros(m, dtype=bool)
        self.switched = False
        self.form_used, self.condition = form, 1.0
        self.psi_k_y, self.amplification = np.full(unseen, np.nan), np.full(unseen, np.nan)
        self.outside_y = np.zeros(unseen, dtype=bool)
        self.updates, self.times_outside = np.zeros((2, m), dtype=np.int64)

    @property
    def chattering(self) -> Array:
        """Share of the updates of each channel in which it was outside the layer (m,)."""
        share = np.full(self.dim_z, np.nan)
        np.divide(self.times_outside, self.updates, out=share, where=self.updates > 0)
        return share

    def _check_form(self) -> None:
        n, m = self.dim_x, self.dim_z
        if self.boundary_layer not in ("fixed", "variable"):
            raise ValueError(f"boundary_layer is {self.boundary_layer!r}; give 'fixed' or 'variable'")
        if self.form not in ("subspace", "full", "reduced"):
            raise ValueError(f"form is {self.form!r}; give 'subspace', 'full' or 'reduced'")
        if self.form == "full" and m != n:
            raise ValueError(
                f"the full form needs a channel for each state, not {m} for {n}; give 'subspace'"
            )
        if self.form != "reduced":
            if self.psi_y is not None or self.unmeasured is not None:
                raise ValueError(f"psi_y and unmeasured are for the reduced form, not {self.form!r}")
            return
        if not m < n:
            raise ValueError(
                f"the reduced form needs fewer channels than states, not {m} for {n}; give 'full'"
            )
        if self.psi_y is None:
            raise ValueError(f"the reduced form needs psi_y, the layer of the {n - m} unmeasured states")
        if self.boundary_layer == "variable" and n != 2 * m:
            raise ValueError(
                f"the reduced form has an optimal layer for n = 2 m only, not {m} channels for {n} states; "
                "give boundary_layer='fixed', or form='subspace'"
            )
        picked = self.unmeasured
        if picked is not None and (len(set(picked)) != n - m or not set(picked) <= set(range(n))):
            raise ValueError(f"unmeasured is {picked}; give {n - m} different indices below {n}")

    def _layers(self) -> tuple[Array, Array]:
        """Both layers, (m,) and (n - m,), checked, with gamma: all are open to change between updates."""
        layer = layer_widths(self.psi, self.dim_z, "psi", "channels")
        unseen = 0 if self.psi_y is None else self.dim_x - self.dim_z
        layer_y = (
            np.empty(0) if not unseen else layer_widths(self.psi_y, unseen, "psi_y", "unmeasured states")
        )
        if not 0.0 <= self.gamma < 1.0:
            raise ValueError(f"gamma is {self.gamma:g}; give 0 <= gamma < 1")
        if np.isinf([*layer, *layer_y]).any() and self.boundary_layer == "fixed":
            raise ValueError("psi is infinite, which corrects nothing; give a width, or a variable layer")
        return layer, layer_y

    def _gain(self, P: Array, e: Array, H: Array, R: Array, used: Mask) -> Gain:
        layer, layer_y = self._layers()
        problem = Problem(
            P, H, R, e, self.e_post[used], float(self.gamma), layer[used], self.boundary_layer == "variable"
        )
        if self.form == "full":
            return full_gain(problem)
        if self.form == "subspace":
            return subspace_gain(problem)
        unseen = self.dim_x - self.dim_z
        if used.all():
            picked = np.flatnonzero(~H.any(axis=0)) if self.unmeasured is None else np.array(self.unmeasured)
            if picked.size != unseen:
                raise ValueError(
                    f"{picked.size} states are seen by no channel, not {unseen}; name them: unmeasured=[...]"
                )
            gain = reduced_gain(problem, np.asarray(self.F, float), picked, layer_y)
        else:  # T would be another one, with states in y that have no layer
            gain = subspace_gain(problem)
            gain.condition = float("inf")
        if gain.form != "reduced":
            gain.psi_k_y = gain.amplification = np.full(unseen, np.nan)
            gain.outside_y = np.zeros(unseen, dtype=bool)
        return gain

    def _correct(
        self,
        x: Array,
        P: Array,
        y: Array,
        H: Array,
        R: Array,
        used: Mask,
        innovation: Callable[[Array], Array],
    ) -> SVSFCorrection:
        kalman = super()._correct(x, P, y, H, R, used, innovation)
        H_used, R_used = np.ascontiguousarray(H[used]), np.ascontiguousarray(R[np.ix_(used, used)])
        gain = self._gain(P, y[used], H_used, R_used, used)
        if gain.K is not None:
            K = np.ascontiguousarray(gain.K)
            kalman.x, kalman.P = x + K @ y[used], P.copy()
            joseph_update(kalman.P, K, H_used, R_used)
            kalman.K[:, used] = K
        after = innovation(kalman.x)
        require_finite(kalman.x, "the updated state", "state")
        require_finite(after[used], "the posterior error z - h(x)", "used channel")
        return SVSFCorrection(**vars(kalman), after=after, gain=gain)

    def _accept(self, correction: Correction, used: Mask) -> None:
        super()._accept(correction, used)
        assert isinstance(correction, SVSFCorrection)
        gain, m = correction.gain, self.dim_z
        self.e_post = np.where(used, correction.after, self.e_post)
        self.psi_k, self.outside = np.full(m, np.nan), np.zeros(m, dtype=bool)
        self.psi_k[used], self.outside[used] = gain.psi_k, gain.outside
        self.switched = gain.K is not None
        self.form_used, self.condition = gain.form, gain.condition
        self.psi_k_y, self.outside_y, self.amplification = gain.psi_k_y, gain.outside_y, gain.amplification
        self.updates = self.updates + used
        self.times_outside = self.times_outside + self.outside


def correction_ratio(size: Array, error: Array, layer: Array) -> Array:
    """Share of ``error`` to be corrected, ``size sat(error / layer) / error``, without dividing by 0.

    Examples
    --------
    >>> correction_ratio(np.array([0.5, 3.0, 0.1]), np.array([0.5, -2.0, 0.0]), np.ones(3)).tolist()
    [0.5, 1.5, 0.1]
    """
    return np.asarray(size / np.maximum(np.abs(error), layer))


def scaled_condition(A: Array) -> float:
    """Condition number of a matrix whose rows and columns have been scaled, so that units drop out.

    Examples
    --------
    >>> round(scaled_condition(np.diag([1e-12, 1e6])), 6), scaled_condition(np.zeros((1, 1)))
    (1.0, inf)
    """
    balanced = np.array(A, float)
    for axis in (0, 1) * 6:  # Sinkhorn's scaling: rows and columns of the same length
        length = np.sqrt((balanced**2).sum(axis=axis, keepdims=True))
        if not (length > 0.0).all() or not np.isfinite(length).all():
            return float("inf")
        balanced = balanced / length
    values = np.linalg.svd(balanced, compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")


def subspace_gain(problem: Problem) -> Gain:
    """SVSF in the measured subspace, the covariance carries it to the others."""
    p = problem
    n, m = p.P.shape[0], p.e.size
    K, psi_k, outside = np.empty((n, m)), np.empty(m), np.empty(m, dtype=bool)
    PHt, HPHt = np.empty((n, m)), np.empty((m, m))
    project(p.P, p.H, PHt, HPHt)
    switched = m > 0 and svsf_gain(
        PHt, HPHt, p.R, p.e, p.e_post, p.gamma, p.psi, p.variable, K, psi_k, outside
    )
    return Gain(K if switched else None, psi_k, outside, switched)


def full_gain(problem: Problem) -> Gain:
    """The original form: as many channels as states, no covariance in the gain.

    Where H cannot be inverted, or a channel is missing, the subspace form takes over, of which it
    is a special case: ``P H' (H P H')^-1 = H^-1``.
    """
    p, gain = problem, subspace_gain(problem)
    square = p.H.shape[0] == p.H.shape[1]
    gain.condition = scaled_condition(p.H) if square else float("inf")
    if gain.condition > CONDITION_LIMIT:
        return gain
    gain.form = "full"
    # A fixed layer needs no covariance; the variable one says through the subspace gain when to switch.
    if gain.K is not None or not p.variable:
        size = np.abs(p.e) + p.gamma * np.abs(p.e_post)
        gain.forced = True
        gain.K = np.asarray(np.linalg.solve(p.H, np.diag(correction_ratio(size, p.e, p.psi))), float)
    return gain


def reduced_gain(problem: Problem, F: Array, unmeasured: NDArray[np.intp], psi_y: Array) -> Gain:
    """Luenberger-type transform for fewer channels than states; the blocks of the gain switch separately.

    Parameters
    ----------
    problem : the update.
    F : (n, n) transition of the step that led to it.
    unmeasured : (n - m,) indices of the states y.
    psi_y : (n - m,) their boundary layer (limit, when variable), in their units.

    Returns
    -------
    Gain : of the subspace form where T or Phi12 is not well conditioned (:data:`CONDITION_LIMIT`).
    """
    p, gain = problem, subspace_gain(problem)
    n, m = p.P.shape[0], p.e.size
    T = np.vstack([p.H, np.eye(n)[unmeasured]])
    gain.condition = scaled_condition(T)
    if gain.condition > CONDITION_LIMIT:
        return gain
    Phi = T @ F @ np.linalg.inv(T)
    Phi12, Phi22 = Phi[:m, m:], Phi[m:, m:]
    gain.condition = max(gain.condition, scaled_condition(Phi12))
    if gain.condition > CONDITION_LIMIT:
        return gain
    gain.form = "reduced"
    backward = np.linalg.pinv(Phi12)
    A = Phi22 @ backward
    w = A @ p.e
    size = np.abs(p.e) + p.gamma * np.abs(p.e_post)
    size_y = np.abs(w) + p.gamma * np.abs(backward @ p.e)
    S = p.H @ p.P @ p.H.T + p.R
    PHt = T @ p.P @ p.H.T  # measured rows, then unmeasured ones
    gain.outside_y = np.abs(w) > psi_y
    gain.amplification = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", A, S, A), 0.0)) / psi_y
    gain.psi_k_y = _optimal_layer(A, S, PHt[m:], size_y)
    upper: Array = np.diag(correction_ratio(size, p.e, p.psi))
    lower: Array = correction_ratio(size_y, w, psi_y)[:, None] * A
    if p.variable:
        # As above: where no optimal layer exists, there is nothing to compare, and Kalman's gain stands.
        exists = bool(np.isfinite(gain.psi_k_y).all())
        switched_y = exists and bool((np.abs(gain.psi_k_y) > psi_y).any())
        if not gain.forced and not switched_y:
            return gain
        kalman: Array = np.asarray(np.linalg.solve(S, PHt.T).T, float)
        upper = upper if gain.forced else kalman[:m]
        lower = lower if switched_y else kalman[m:]
    else:
        gain.forced = True
    gain.K = np.asarray(np.linalg.solve(T, np.vstack([upper, lower])), float)
    return gain


def _optimal_layer(A: Array, S: Array, P21: Array, size: Array) -> Array:
    """Diagonal of ``A S P21^-1 diag(size)``; NaN unless n = 2 m, infinite where y and z are uncorrelated."""
    if P21.shape[0] != P21.shape[1]:
        return np.full(size.size, np.nan)
    if scaled_condition(P21) > CONDITION_LIMIT:
        return np.full(size.size, np.inf)
    return np.asarray(np.diag(A @ S @ np.linalg.inv(P21)) * size)
