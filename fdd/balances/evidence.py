"""How strongly the balances speak for each fault, over every onset.

A change ``δ`` of a balance's coefficients from an onset on, with everything that held before it integrated out, has a Gaussian
likelihood with information ``S`` and vector ``s``. By sums over hops each onset costs the same:

    S = Σφ²M - (ΣφM)(P⁻¹ + ΣM)⁻¹(ΣφM),   s = Σφm - (ΣφM)(P⁻¹ + ΣM)⁻¹(P⁻¹b + Σm)

φ is the fault's course in time after the onset (step or ramp), P and b the unit's own prior. A healthy unit's coefficients change as
well, by N(0, R): that is integrated out too, alike for all hypotheses. What is left is a ratio of likelihoods for each fault's columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from fdd.balances.effects import Effects
from fdd.balances.ledger import widened

Array = NDArray[np.float64]
Sums = tuple[Array, Array, Array, Array]

RAMP_HOPS = 24
"""Hops over which a ramp grows to its full size: 12 s."""
COURSES = ("step", "ramp")


@dataclass
class Changes:
    """Of one balance: information (k, n, n) and vector (k, n) of a change at each onset, with and without model error."""

    information: Array
    vector: Array
    sharp_information: Array
    sharp_vector: Array


def _course(hops: int, onset: int, course: str) -> Array:
    since = np.arange(hops) - onset
    if course == "ramp":
        return np.clip((since + 0.5) / RAMP_HOPS, 0.0, 1.0)
    return (since >= 0).astype(np.float64)


def changes(entries: dict[str, Sums], all_effects: dict[str, Effects], onsets: Array, course: str) -> dict[str, Changes]:
    """Changes of all balances at each onset (indices of hops)."""
    out = {}
    for name, (information, vector, rows, _) in entries.items():
        if not rows.any():
            continue
        effects = all_effects[name]
        m, v = widened(information, vector, effects.wander)
        h = len(rows)
        phi = np.array([_course(h, int(t), course) for t in onsets])
        prior = np.linalg.inv(effects.covariance)
        total, total_v = prior + m.sum(axis=0), prior @ effects.mean + v.sum(axis=0)
        one = np.tensordot(phi, m, axes=1)
        two = np.tensordot(phi**2, m, axes=1)
        one_v = phi @ v
        gained = one @ np.linalg.inv(total)
        s = two - gained @ one
        sv = one_v - gained @ total_v
        s = _positive_all(0.5 * (s + np.swapaxes(s, 1, 2)))
        wide, wide_v = widened(s, sv, effects.within)
        out[name] = Changes(wide, wide_v, s, sv)
    return out


def _positive_all(information: Array) -> Array:
    """Without what rounding makes negative, in the scale of each one's columns."""
    scale = np.sqrt(np.abs(np.diagonal(information, axis1=1, axis2=2)).clip(1e-300))
    outer = scale[:, :, None] * scale[:, None, :]
    values, vectors = np.linalg.eigh(information / outer)
    return np.asarray((vectors * values.clip(0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2) * outer)


def log_ratio(information: Array, vector: Array, scale: Array, signed: bool) -> tuple[Array, Array, Array]:
    """Log of the likelihood ratio of an amplitude ~ N(0, scale²) against none, its mean and covariance.

    Parameters
    ----------
    information : (k, q, q), vector : (k, q), of the amplitude. scale : (q,). signed : amplitudes are positive (q = 1).
    """
    post = information + np.diag(1.0 / scale**2)
    cov = np.linalg.inv(post)
    mean = (cov @ vector[..., None])[..., 0]
    _, logdet = np.linalg.slogdet(post * (scale * scale[:, None]))
    out = 0.5 * np.einsum("ki,ki->k", vector, mean) - 0.5 * logdet
    if signed:
        out = out + np.log(2.0) + log_ndtr(mean[:, 0] / np.sqrt(cov[:, 0, 0]))
    return out, mean, cov
