"""What of the pumped oil moves the piston."""

from __future__ import annotations


def volumetric_efficiency(displacement: float, pump_speed: float, leakage: float, pressure: float) -> float:
    """A·ẋ / (D_p·ω) of the thesis's eq. 5.4, as a share: 1 - L_T·p/(D_p·ω) with A·ẋ from eq. 5.3.

    Parameters
    ----------
    displacement : m³/rad. pump_speed : rad/s, not zero. leakage : L_T, m³/(s·Pa). pressure : Pa, difference
        that the pump works against.

    Returns
    -------
    1 without leakage; negative where more leaks than is pumped.

    Examples
    --------
    Axis A at 1000 rpm and 3.36 MPa, D_p of the thesis's 5.76e-5 m³/s:

    >>> round(volumetric_efficiency(5.50e-7, 104.7, 6.52e-12, 3.36e6), 3)
    0.62
    """
    return 1.0 - leakage * pressure / (displacement * pump_speed)
