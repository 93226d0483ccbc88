"""Table 6.1: the commands below which the motor, and with it the actuator, does not move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fdd.prototype.findings import Finding, Picture, Row
from fdd.prototype.runs import PERIOD, VOLT, run_speed
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOTOR, COMBINED, COMBINED_VELOCITY = 0.0011, 0.06, 6.82e-4
"""V, V and m/s: Table 6.1."""
MOTOR_LEVELS = np.array([0.0, 2e-4, 4e-4, 6e-4, 8e-4, 9e-4, 1e-3, 1.1e-3, 1.2e-3, 1.4e-3, 1.6e-3, 2e-3, 3e-3])
LEVELS = np.array(
    [0.02, 0.04, 0.06, 0.08, 0.10, 0.11, 0.12, 0.13, 0.14, 0.16, 0.18, 0.20, 0.22, 0.24, 0.26, 0.28]
)
"""V, each held."""
HOLD = 5.0
"""s per level; the mean over the last 2 s counts, when the pressure has followed (L_T·β/V_o is about 1/s)."""
TRIALS = 3
_MEAN = 2.0


def staircase(unit: Unit, levels: Array, sign: float, seed: int) -> tuple[Array, Array]:
    """Mean motor speed (rad/s) and actuator velocity (m/s) along `sign` at each level (V), from encoders."""
    rows = round(HOLD / PERIOD)
    command = sign * VOLT * np.repeat(levels, rows)
    log = run_speed(unit, command, start=-0.01 * sign, seed=seed).samples
    ends = rows * np.arange(1, levels.size + 1) - 1
    starts = ends - round(_MEAN / PERIOD)
    motor, actuator = (sign * (log[c][ends] - log[c][starts]) / _MEAN for c in ("pump_angle", "position"))
    return np.asarray(motor), np.asarray(actuator)


def motor_dead_band(levels: Array, speed: Array) -> float:
    """Largest level (V) at which the motor turns at less than half the demanded speed, 0 for none.

    Examples
    --------
    >>> motor_dead_band(np.array([0.0, 1.0, 2.0]), VOLT * np.array([0.0, 0.1, 2.0]))
    1.0
    """
    stands = speed < 0.5 * VOLT * levels
    return float(levels[stands].max()) if stands.any() else 0.0


def sliding_dead_band(levels: Array, velocity: Array, gain: float) -> float:
    """Where the line through the sliding piston's velocity meets zero (V).

    Below break-away the piston creeps as its seals bend; it counts as sliding from a third of the velocity
    that the pump's gain would give.

    Parameters
    ----------
    levels, velocity : (n,) V and m/s.
    gain : m/rad.

    Returns
    -------
    V; NaN where it slides at fewer than three levels.

    Examples
    --------
    >>> v = np.array([0.0, 0.0, 1.0, 2.0, 3.0, 4.0]) * 1e-3
    >>> round(sliding_dead_band(np.arange(1.0, 7.0), v, 1e-3 / VOLT), 6)
    2.0
    """
    slides = velocity > gain * VOLT * levels / 3.0
    if np.count_nonzero(slides) < 3:
        return float("nan")
    slope, offset = np.polyfit(levels[slides], velocity[slides], 1)
    return float(-offset / slope)


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Climb small commands on axis A, both ways."""
    gain = axis_a.pump.displacement / axis_a.cylinder.area_1
    turns = np.mean([staircase(axis_a, MOTOR_LEVELS, s, seed)[0] for s in (1.0, -1.0)], axis=0)
    motor = motor_dead_band(MOTOR_LEVELS, turns)
    climbs = {
        s: np.array([staircase(axis_a, LEVELS, s, seed + i)[1] for i in range(TRIALS)]) for s in (1.0, -1.0)
    }
    bands = {s: float(np.mean([sliding_dead_band(LEVELS, v, gain) for v in c])) for s, c in climbs.items()}
    combined = float(np.mean(list(bands.values())))
    area, displacement = axis_a.cylinder.area_1, axis_a.pump.displacement
    volt_per_newton = axis_a.pump.total_leakage / (area * displacement * VOLT)
    statics = axis_a.friction.forward.static, axis_a.friction.reverse.static
    predicted = [volt_per_newton * f for f in statics]
    why = (
        f"To hold F newton the pump must make up the leakage, ω = L_T·F/(A·Dp): {statics[0]:.0f} and "
        f"{statics[1]:.0f} N of Table 5.1 need {predicted[0]:.3f} and {predicted[1]:.3f} V before the "
        f"piston slides; 0.06 V holds only {COMBINED / volt_per_newton:.0f} N, so the thesis's dead band, "
        "leakage and static friction exclude each other."
    )
    rows = [
        Row(
            "dead band of the motor", "Table 6.1", MOTOR, motor, "V", tolerance=1e-4,
            why="The plant's velocity loop integrates: it turns the motor at any demand.",
            note="The tolerance is one level of the staircase.", digits=2,
        ),
        Row("dead band of motor and actuator", "Table 6.1", COMBINED, combined, "V", tolerance=0.01, why=why),
        Row(
            "the same as a velocity, Dp/A times it", "Table 6.1", 1e3 * COMBINED_VELOCITY,
            1e3 * combined * VOLT * gain, "mm/s", tolerance=1e3 * 0.01 * VOLT * gain, why="As above.",
        ),
    ]  # fmt: skip

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        left.plot(1e3 * MOTOR_LEVELS, 1e3 * turns, "o-", label="plant")
        left.plot(1e3 * MOTOR_LEVELS, 1e3 * VOLT * MOTOR_LEVELS, "k:", linewidth=1.0, label="no dead band")
        left.axvline(1e3 * MOTOR, color="k", linestyle="--", linewidth=1.0, label="thesis, 1.1 mV")
        left.set(xlabel="command (mV)", ylabel="motor speed (mrad/s)", title="motor")
        for s, name, marker in ((1.0, "forward", "o"), (-1.0, "reverse", "s")):
            right.plot(LEVELS, 1e3 * climbs[s].mean(axis=0), marker, label=f"plant, {name}: {bands[s]:.3f} V")
        right.plot(LEVELS, 1e3 * gain * VOLT * LEVELS, "k:", linewidth=1.0, label="no dead band")
        right.axvline(COMBINED, color="k", linestyle="--", linewidth=1.0, label="thesis, 0.06 V")
        right.set(xlabel="command (V)", ylabel="actuator velocity (mm/s)", title="motor and actuator, axis A")
        left.legend()
        right.legend()

    return Finding(
        "Dead band",
        "Table 6.1 gives the commands from which motor and actuator move, without saying how they were "
        f"found. Here commands climb in steps of {HOLD:g} s, without load, both ways, {TRIALS} trials; "
        "the motor counts as turning from half the demanded speed on, and the actuator's dead band is "
        "where the line through its sliding velocities meets zero.",
        rows,
        pictures=[Picture("dead_band", "Speed of motor and actuator over small commands.", draw)],
    )
