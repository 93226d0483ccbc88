"""The filter that takes the chatter out of a differentiated encoder (thesis 7.1.1)."""

from __future__ import annotations

import math

from fdd.errors import InputError


def chatter_filter(cutoff: float, period: float) -> tuple[float, float, float, float]:
    """Second-order Butterworth low-pass, discretised with a zero-order hold.

    ``y[k] = b1·u[k-1] + b2·u[k-2] - a1·y[k-1] - a2·y[k-2]``, eqs 7.3 and 7.5. The thesis names
    Tustin's rule (eq. 7.4), but that would give a term without delay; its printed coefficients,
    4.39e-2, -1.514 and 0.61, are the hold's. Its 5.28e-2 is a misprint of 5.18e-2: only with that
    does the filter pass a constant unchanged.

    Parameters
    ----------
    cutoff : rad/s, where the gain is 1/√2; below π/period.
    period : s.

    Returns
    -------
    b1, b2, a1, a2.

    Raises
    ------
    InputError : not positive, or a cut-off at or beyond the Nyquist frequency.

    Examples
    --------
    >>> [round(c, 4) for c in chatter_filter(350.0, 1e-3)]
    [0.0518, 0.0439, -1.5139, 0.6096]
    """
    if not (cutoff > 0.0 and period > 0.0 and cutoff * period < math.pi):
        raise InputError(
            f"cut-off {cutoff:g} rad/s at a period of {period:g} s is not possible",
            mend="use more than 0 and less than π/period",
        )
    # Poles at cutoff·(-1 ± i)/√2; step response 1 - exp(-a)·(cos a + sin a) after one period.
    a = cutoff * period / math.sqrt(2.0)
    fade, cosine, sine = math.exp(-a), math.cos(a), math.sin(a)
    a1, a2 = -2.0 * fade * cosine, fade * fade
    return 1.0 - fade * (cosine + sine), a2 + fade * (sine - cosine), a1, a2
