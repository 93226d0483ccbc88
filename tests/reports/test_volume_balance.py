"""The least-squares fit of the volume balance that `examples/rig_estimates.py` has beside the filters."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from fdd.residuals.tracking import Channels, Tracking
from fdd.unit import Unit
from reports.estimators.cases import ALL

BALANCE = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "volume_balance.py"))
Window, fit_balance = BALANCE["Window"], BALANCE["fit_balance"]


def exact_window(model, leakage, air, gain, n=3000):
    """Signals that keep both chambers' balances by fine sums of the differentials themselves."""
    fine = 8
    t = np.arange(n * fine) / fine * 1e-3
    x = 30.0 * np.sin(2.0 * np.pi * 0.4 * t)
    p1 = 1.2 + 0.4 * np.sin(2.0 * np.pi * 0.9 * t + 1.0) + 0.2 * np.sin(2.0 * np.pi * 3.1 * t)
    v1 = model.volume_1 + model.area_1 * x
    v2 = model.volume_2 - model.area_2 * x
    exponent = model.polytropic_index

    atmosphere, of_air = 0.101325, 1e-3 * air * 0.101325 ** (1.0 / exponent)

    def compliance(p):
        return model.stiff_compliance + of_air / (exponent * (p + atmosphere) ** (1.0 + 1.0 / exponent))

    def compressed(p):
        """Integral of the compliance over pressure."""
        return model.stiff_compliance * p - of_air * (p + atmosphere) ** (-1.0 / exponent)

    # Chamber 1 says how far the pump turned, chamber 2's pressure follows from that.
    h = 1.0 / fine
    p2, angle, accumulator = np.empty_like(t), np.zeros_like(t), 0.2
    p2[0] = 3.3
    dx, dp1 = np.diff(x), np.diff(p1)
    middle1, middle_v1 = 0.5 * (p1[1:] + p1[:-1]), 0.5 * (v1[1:] + v1[:-1])
    stored1 = middle_v1 * compliance(middle1) * dp1
    for k in range(t.size - 1):
        drop = middle1[k] - p2[k]
        leak1 = (
            leakage * (model.cross_port_leakage * drop + model.case_leakage * (middle1[k] - accumulator)) * h
        )
        leak2 = leakage * (-model.cross_port_leakage * drop + model.case_leakage * (p2[k] - accumulator)) * h
        denser = 0.5 * (compressed(middle1[k]) - compressed(p2[k]))
        pumped = (model.area_1 * dx[k] + leak1 + stored1[k]) / (1.0 - denser)
        angle[k + 1] = angle[k] + pumped / (model.displacement * (1.0 + gain))
        inflow = model.area_2 * dx[k] - pumped * (1.0 + denser) - leak2
        p2[k + 1] = p2[k] + inflow / (0.5 * (v2[k] + v2[k + 1]) * compliance(p2[k]))
    at = slice(None, None, fine)
    return Window(x[at], angle[at], p1[at], p2[at], np.full(n, accumulator))


def test_least_squares_finds_exact_data():
    model = Tracking(Unit.load("axis_a"), Channels(ALL), 1e-3).model
    window = exact_window(model, 1.7, 5.0, 2e-3)
    assert window.pressure_2.min() > 0.23
    assert fit_balance(window, model) == pytest.approx((1.7, 5.0), rel=5e-3)
    assert fit_balance(window, model, sealed=True) == pytest.approx((1.7, 5.0), rel=5e-3)
