"""Smooth variable structure filter: keeps hold of the state when the model is wrong.

It forces the measured part of the state into a band around the measurement, the *boundary layer* ``psi``. Per
channel, with ``e = z - h(x_prior)``, the posterior error ``e_post`` of the step before, and
``E = |e| + gamma |e_post|``::

    correction  k = E sat(e / psi)      sat(a) = a for |a| <= 1, else sgn(a)
    state       x <- x + H+ k           H+ = P H' (H P H')^-1
    covariance  P <- (I - K H) P (I - K H)' + K R K',   K e = H+ k

Outside the layer the posterior error becomes ``-gamma |e_post| sgn(e)``, whatever the model:
it contracts by ``gamma`` each step. Inside, the correction falls off with the square of ``e``.
``H+`` carries the correction to unmeasured states through the covariance, as a Kalman filter would; where as
many channels as states are measured it is ``H^-1``, Habibi's original gain.

With ``boundary_layer="variable"`` the gain *is* the Kalman gain as long as the layer that minimises the trace
of P, ``psi_k = S (H P H')^-1 diag(E)``, stays below the limit ``psi``. It grows as the filter becomes sure of
itself, also on a healthy plant: the README says how to choose the limit.

Sources: Habibi 2007, doi 10.1109/JPROC.2007.893255; covariance: Gadsden and Habibi 2010, 49th
IEEE CDC, 7389-7394; optimal layers: Gadsden and Habibi 2013, doi 10.1115/1.4006628.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators.ekf import ExtendedKalmanFilter, Model, require_finite
from estimators.kernels import svsf_gain
from estimators.linalg import Array, Mask, joseph_update, project


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

    Attributes
    ----------
    e_post : (m,) posterior error ``z - h(x)``; a missing channel keeps its last.
    psi_k : (m,) optimal boundary layer of the last update, NaN where a channel was missing. Above ``psi`` a
        variable layer switches.
    outside : (m,) bool, ``|e| > psi`` at the last update.
    switched : True when the last update applied the SVSF's gain and not the Kalman gain.
    chattering : (m,) share of the updates so far with ``outside``, NaN before the first.

    Raises ValueError: as the base class, and for a psi, gamma or boundary_layer that does not fit.

    Examples
    --------
    A constant that jumps by 5 at the sixth sample, which the Kalman filter of the same tuning hardly follows:

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
        self, dim_x: int, dim_z: int, dim_u: int = 0, *, psi: ArrayLike, gamma: float = 0.1,
        boundary_layer: str = "fixed", f: Model | None = None, h: Model | None = None,
        F_jacobian: Model | None = None, H_jacobian: Model | None = None,
    ) -> None:  # fmt: skip
        super().__init__(dim_x, dim_z, dim_u, f=f, h=h, F_jacobian=F_jacobian, H_jacobian=H_jacobian)
        if boundary_layer not in ("fixed", "variable"):
            raise ValueError(f"boundary_layer is {boundary_layer!r}; give 'fixed' or 'variable'")
        self.psi: Any = psi
        self.gamma, self.boundary_layer = gamma, boundary_layer
        self._layer()
        m = self.dim_z
        self.e_post = np.zeros(m)
        self.psi_k = np.full(m, np.nan)
        self.outside = np.zeros(m, dtype=bool)
        self.switched = False
        self.updates, self.times_outside = np.zeros((2, m), dtype=np.int64)

    @property
    def chattering(self) -> Array:
        """Share of the updates of each channel in which it was outside the layer (m,)."""
        share = np.full(self.dim_z, np.nan)
        np.divide(self.times_outside, self.updates, out=share, where=self.updates > 0)
        return share

    def _layer(self) -> Array:
        """The layer (m,), checked, with gamma: both are open to change between updates."""
        given, m = np.asarray(self.psi, float), self.dim_z
        layer = np.full(m, float(given)) if given.ndim == 0 else given.reshape(-1).copy()
        if layer.size != m:
            raise ValueError(f"psi has {layer.size} values; give one, or one for each of {m} channels")
        if not (layer > 0.0).all():
            raise ValueError(f"psi is {layer[~(layer > 0.0)][0]:g}; a boundary layer is more than 0")
        if not 0.0 <= self.gamma < 1.0:
            raise ValueError(f"gamma is {self.gamma:g}; give 0 <= gamma < 1")
        if np.isinf(layer).any() and self.boundary_layer == "fixed":
            raise ValueError("psi is infinite, which corrects nothing; give a width, or a variable layer")
        return layer

    def _corrected(
        self, x: Array, P: Array, y: Array, H: Array, R: Array, used: Mask,
        innovation: Callable[[Array], Array],
    ) -> dict[str, Any]:  # fmt: skip
        found = super()._corrected(x, P, y, H, R, used, innovation)
        e, H_used = y[used], np.ascontiguousarray(H[used])
        R_used = np.ascontiguousarray(R[np.ix_(used, used)])
        n, m = self.dim_x, e.size
        K, psi_k, outside = np.empty((n, m)), np.empty(m), np.empty(m, dtype=bool)
        PHt, HPHt = np.empty((n, m)), np.empty((m, m))
        project(P, H_used, PHt, HPHt)
        layer, variable = self._layer()[used], self.boundary_layer == "variable"
        switched = m > 0 and svsf_gain(
            PHt, HPHt, R_used, e, self.e_post[used], float(self.gamma), layer, variable, K, psi_k, outside
        )
        if switched:
            found["x"], found["P"] = x + K @ e, P.copy()
            joseph_update(found["P"], K, H_used, R_used)
            found["K"][:, used] = K
        after = innovation(found["x"])
        require_finite(found["x"], "the updated state", "state")
        require_finite(after[used], "the posterior error z - h(x)", "used channel")
        layers, beyond = np.full(self.dim_z, np.nan), np.zeros(self.dim_z, dtype=bool)
        layers[used], beyond[used] = psi_k, outside
        return found | {
            "e_post": np.where(used, after, self.e_post), "psi_k": layers, "outside": beyond,
            "switched": switched, "updates": self.updates + used,
            "times_outside": self.times_outside + beyond,
        }  # fmt: skip
