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
With fewer channels than states, ``H+`` carries the correction to the others through the
covariance, as a Kalman filter would (:func:`estimators.kernels.svsf_gain` shows why no
separate Kalman term is left over). That is ``form="subspace"``; the published ``"full"`` and
``"reduced"`` forms are in :mod:`estimators.svsf_forms`. The covariance is in Joseph form in all.

With ``boundary_layer="variable"`` the layer that minimises the trace of P is computed,
``psi_k = S (H P H')^-1 diag(E)``. As long as its diagonal stays below the limit ``psi``, the
gain *is* the Kalman gain; beyond, the gain above, with ``psi`` as the layer, takes over.
``psi_k`` grows as the filter becomes sure of itself, also on a healthy plant: take the limit
from a high quantile of ``psi_k`` over healthy runs, channel by channel, and again after
every change of Q or R.

``psi_k``, ``outside`` and ``chattering`` show that something changed, but they are tests of
single samples: to *detect*, put a CUSUM or a windowed NIS on the innovations.

Sources: Habibi 2007, doi 10.1109/JPROC.2007.893255; covariance: Gadsden and Habibi 2010, 49th
IEEE CDC, 7389-7394; optimal layer: Gadsden and Habibi 2013, doi 10.1115/1.4006628.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.checks import Array, Mask, layer_widths, require_finite
from estimators.ekf import Correction, ExtendedKalmanFilter, Model
from estimators.linalg import joseph_update
from estimators.square_root import ud_covariance, ud_transform
from estimators.svsf_forms import Gain, Problem, full_gain, reduced_gain, subspace_gain

Counts = NDArray[np.int64]

# A posterior error below this share of the innovation is rounding, and has no sign.
SIGN_FLOOR = 1e-12


@dataclass
class SVSFCorrection(Correction):
    """What an update of an :class:`SVSF` gives besides: the channels used, their innovation and
    posterior error (m,), and the gain that was found."""

    used: Mask | None = None
    e: Array | None = None
    after: Array | None = None
    gain: Gain | None = None


class SVSF(ExtendedKalmanFilter):
    """Smooth variable structure filter on the interface of :class:`ExtendedKalmanFilter`.

    Parameters
    ----------
    dim_x, dim_z, dim_u, f, h, F_jacobian, H_jacobian, square_root : as in :class:`ExtendedKalmanFilter`.
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
    psi_k : (m,) optimal boundary layer of the last update, NaN where a channel was missing.
    layer_ratio : (m,) ``psi_k / psi``; above 1 a variable layer switches.
    outside, exceeded : (m,) bool, ``|e| > psi`` and ``psi_k > psi`` at the last update.
    switched : True when the last update applied the SVSF's gain and not the Kalman gain.
    chattering, alternation, switching : (m,) shares so far, NaN before the first: updates with
        ``outside``; posterior errors of the other sign than the one before (1/2 for white
        noise, 1 for a channel that chatters at every sample); updates with ``exceeded``.
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

    _STATE = (
        *ExtendedKalmanFilter._STATE,
        "psi", "psi_y", "gamma", "e_post", "psi_k", "outside", "exceeded", "switched", "form_used",
        "condition", "psi_k_y", "outside_y", "amplification", "updates", "times_outside",
        "times_exceeded", "signs", "sign_pairs", "times_alternated",
    )  # fmt: skip
    _OPTIONAL = (*ExtendedKalmanFilter._OPTIONAL, "psi_y")

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
        square_root: bool = False,
    ) -> None:
        super().__init__(
            dim_x,
            dim_z,
            dim_u,
            f=f,
            h=h,
            F_jacobian=F_jacobian,
            H_jacobian=H_jacobian,
            square_root=square_root,
        )
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
        self.outside, self.exceeded = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool)
        self.switched = False
        self.form_used, self.condition = form, 1.0
        self.psi_k_y, self.amplification = np.full(unseen, np.nan), np.full(unseen, np.nan)
        self.outside_y = np.zeros(unseen, dtype=bool)
        counts = [np.zeros(m, dtype=np.int64) for _ in range(6)]
        self.updates, self.times_outside, self.times_exceeded = counts[:3]
        self.signs, self.sign_pairs, self.times_alternated = counts[3:]

    @property
    def chattering(self) -> Array:
        """Share of the updates of each channel in which it was outside the layer (m,)."""
        return _share(self.times_outside, self.updates)

    @property
    def alternation(self) -> Array:
        """Share of the updates of each channel whose posterior error changed sign (m,)."""
        return _share(self.times_alternated, self.sign_pairs)

    @property
    def switching(self) -> Array:
        """Share of the updates of each channel whose optimal layer exceeded its limit (m,)."""
        return _share(self.times_exceeded, self.updates)

    @property
    def layer_ratio(self) -> Array:
        """Optimal layer over the layer, ``psi_k / psi`` (m,); NaN where a channel was missing."""
        return np.asarray(self.psi_k / self._layers()[0])

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
            picked = self._unmeasured(H)
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

    def _unmeasured(self, H: Array) -> NDArray[np.intp]:
        if self.unmeasured is not None:
            return np.array(self.unmeasured, dtype=np.intp)
        return np.flatnonzero(~H.any(axis=0)).astype(np.intp)

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
        result = SVSFCorrection(**vars(kalman), used=used, e=y)
        if used.all():
            H_used, R_used = H, R
        else:
            H_used, R_used = H[used], np.ascontiguousarray(R[np.ix_(used, used)])
        gain = result.gain = self._gain(P, y[used], H_used, R_used, used)
        if gain.K is not None:
            K = np.ascontiguousarray(gain.K)
            result.x, result.P = x + K @ y[used], P.copy()
            if self.square_root:
                U, D = self._factors(P)
                if not ud_transform(U, D, np.eye(self.dim_x) - K @ H_used, K, R_used):
                    raise ValueError("R is not positive; give a covariance")
                ud_covariance(U, D, result.P)
                result.U, result.D = U, D
            else:
                joseph_update(result.P, K, H_used, R_used)
            result.K[:, used] = K
        result.after = innovation(result.x)
        require_finite(result.x, "the updated state", "state")
        require_finite(result.after[used], "the posterior error z - h(x)", "used channel")
        return result

    def _accept(self, correction: Correction) -> None:
        super()._accept(correction)
        assert isinstance(correction, SVSFCorrection)
        used, e, after, gain = correction.used, correction.e, correction.after, correction.gain
        assert used is not None and e is not None and after is not None and gain is not None
        m = self.dim_z
        self.e_post = np.where(used, after, self.e_post)
        self.psi_k, self.outside, self.exceeded = np.full(m, np.nan), np.zeros(m, bool), np.zeros(m, bool)
        self.psi_k[used], self.outside[used] = gain.psi_k, gain.outside
        self.exceeded[used] = gain.exceeded
        self.switched = gain.K is not None
        self.form_used, self.condition = gain.form, gain.condition
        self.psi_k_y, self.outside_y, self.amplification = gain.psi_k_y, gain.outside_y, gain.amplification
        self.updates = self.updates + used
        self.times_outside = self.times_outside + self.outside
        self.times_exceeded = self.times_exceeded + self.exceeded
        # Outside the layer the posterior error is -gamma |e_post| sgn(e), be it down to rounding.
        e, after = np.where(used, e, 0.0), np.where(used, after, 0.0)
        sign = np.where(np.abs(after) > SIGN_FLOOR * np.abs(e), np.sign(after), 0.0)
        if gain.forced:
            sign = np.where(self.outside, -np.sign(e), sign)
        self.sign_pairs = self.sign_pairs + (sign * self.signs != 0)
        self.times_alternated = self.times_alternated + (sign * self.signs < 0)
        self.signs = np.where(sign != 0.0, sign, self.signs).astype(np.int64)


def _share(part: Counts, whole: Counts) -> Array:
    share = np.full(whole.shape, np.nan)
    np.divide(part, whole, out=share, where=whole > 0)
    return share
