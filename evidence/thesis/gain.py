"""Section 5.1: the hydraulic gain, actuator velocity over pump speed without load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row
from evidence.thesis.runs import PERIOD, VOLT, run_speed
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MEASURED, CALCULATED = 3.57e-4, 3.62e-4
"""m/rad, section 5.1."""
IMPLIED_DISPLACEMENT = 5.50e-7
"""m³/rad: what the thesis's 3.62e-4 m/rad, and its flow of 5.76e-5 m³/s at 104.7 rad/s, come from."""
SPEEDS = VOLT * np.array([-10.0, -8.0, -6.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0])
"""rad/s, commanded."""
_TRAVEL = 0.2


def speeds_of(unit: Unit, seed: int) -> tuple[Array, Array]:
    """Steady pump speed (rad/s) and actuator velocity (m/s) at twelve commands, each (12,).

    Slopes of the two encoders over the second half of each stroke.
    """
    pump, actuator = [], []
    for i, speed in enumerate(SPEEDS):
        expected = abs(speed) * unit.pump.displacement / unit.cylinder.area_1
        n = round(min(_TRAVEL / expected, 4.0) / PERIOD)
        command = np.concatenate([np.zeros(100), np.full(n, speed)])
        log = run_speed(unit, command, start=-0.5 * _TRAVEL * np.sign(speed), seed=seed + i).samples
        half = slice(100 + n // 2, None)
        pump.append(np.polyfit(log.time[half], log["pump_angle"][half], 1)[0])
        actuator.append(np.polyfit(log.time[half], log["position"][half], 1)[0])
    return np.array(pump), np.array(actuator)


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Measure the gain of both axes."""
    points = [speeds_of(unit, seed) for unit in (axis_a, axis_b)]
    slopes = [float(np.polyfit(w, v, 1)[0]) for w, v in points]
    smaller = axis_a.model_copy(deep=True)
    smaller.pump.displacement = IMPLIED_DISPLACEMENT
    implied = float(np.polyfit(*speeds_of(smaller, seed), 1)[0])
    ratio = axis_a.pump.displacement / axis_a.cylinder.area_1
    why = (
        "The profile's Dp is Table 4.21's 5.57e-7 m³/rad; the text's 3.62e-4 m/rad implies 5.50e-7, with "
        f"which the same experiment gives {implied:.3g} m/rad."
    )
    rows = [
        Row("gain, axis A, measured", "5.1", 1e4 * MEASURED, 1e4 * slopes[0], "10⁻⁴ m/rad", why=why),
        Row(
            "gain, axis B, measured",
            "5.1",
            1e4 * MEASURED,
            1e4 * slopes[1],
            "10⁻⁴ m/rad",
            why=why,
            note="The thesis measured axis A.",
        ),
        Row("gain, calculated Dp/A", "5.1, Table 4.21", 1e4 * CALCULATED, 1e4 * ratio, "10⁻⁴ m/rad", why=why),
    ]

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for (w, v), name, marker in zip(points, ("axis A", "axis B"), ("o", "x"), strict=True):
            left.plot(w, 1e3 * v, marker, label=f"plant, {name}")
            right.plot(w, 1e4 * v / w, marker, label=f"plant, {name}")
        line = np.array([-330.0, 330.0])
        left.plot(line, 1e3 * MEASURED * line, "k--", linewidth=1.0, label="thesis, slope 3.57e-4 m/rad")
        left.set(xlabel="pump speed (rad/s)", ylabel="actuator velocity (mm/s)")
        right.axhline(1e4 * MEASURED, color="k", linestyle="--", linewidth=1.0, label="thesis, measured 3.57")
        right.axhline(
            1e4 * CALCULATED, color="k", linestyle=":", linewidth=1.0, label="thesis, calculated 3.62"
        )
        right.axhline(1e4 * ratio, color="C2", linewidth=1.0, label=f"Dp/A of Table 4.21: {1e4 * ratio:.2f}")
        right.set(xlabel="pump speed (rad/s)", ylabel="velocity over pump speed (10⁻⁴ m/rad)")
        left.legend()
        right.set_ylim(3.1, 3.7)
        right.legend(loc="lower left")

    return Finding(
        "Hydraulic gain",
        "Section 5.1 commands pump speeds without load and takes the slope of actuator velocity over "
        "pump speed. Here: twelve speeds of ±31 to ±314 rad/s (±1 to ±10 V), strokes of up to 200 mm, "
        "both velocities from the encoders over the second half of each stroke, a straight line through "
        "all points.",
        rows,
        remarks=[
            "Single ratios fall short at low speed, the slope hardly does: leakage under the friction's "
            "pressure takes away a flow that depends little on speed, and so shifts the line rather than "
            "tilting it."
        ],
        pictures=[Picture("gain", "Actuator velocity over pump speed, as figure 5.1.", draw)],
    )
