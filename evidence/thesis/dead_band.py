"""Table 6.1: the commands below which the motor, and with it the actuator, does not move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row
from evidence.thesis.leakage import holding_leakage
from evidence.thesis.runs import PERIOD, VOLT, run_speed
from fdd.identification.experiments.gain import SLIDING, dead_band
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
TURNING = 1e-4
"""rad/s: more than two counts of the encoder in 2 s."""


def staircase(unit: Unit, levels: Array, sign: float, seed: int) -> tuple[Array, Array]:
    """Mean motor speed (rad/s) and actuator velocity (m/s) along `sign` at each level (V), from encoders."""
    rows = round(HOLD / PERIOD)
    command = sign * VOLT * np.repeat(levels, rows)
    log = run_speed(unit, command, start=-0.01 * sign, seed=seed).samples
    ends = rows * np.arange(1, levels.size + 1) - 1
    starts = ends - round(_MEAN / PERIOD)
    motor, actuator = (sign * (log[c][ends] - log[c][starts]) / _MEAN for c in ("pump_angle", "position"))
    return np.asarray(motor), np.asarray(actuator)


def sliding(levels: Array, velocity: Array, unit: Unit) -> float:
    """Dead band (V) of motor and actuator; below break-away the piston creeps as its seals bend."""
    return dead_band(levels, velocity, velocity > SLIDING * hydraulic_gain(unit) * VOLT * levels)


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Climb small commands on both axes, both ways."""
    turns = np.mean([staircase(axis_a, MOTOR_LEVELS, s, seed)[0] for s in (1.0, -1.0)], axis=0)
    motor = dead_band(MOTOR_LEVELS, turns, turns > TURNING)
    axes = {"A": axis_a, "B": axis_b}
    climbs = {
        (name, sign): np.array([staircase(unit, LEVELS, sign, seed + i)[1] for i in range(TRIALS)])
        for name, unit in axes.items()
        for sign in (1.0, -1.0)
    }
    bands = {
        key: float(np.mean([sliding(LEVELS, v, axes[key[0]]) for v in climb]))
        for key, climb in climbs.items()
    }
    falls = {
        (name, sign): sliding(LEVELS[::-1], staircase(axes[name], LEVELS[::-1], sign, seed)[1], axes[name])
        for name, sign in bands
    }
    rows = [
        Row(
            "dead band of the motor", "Table 6.1", MOTOR, motor, "V", tolerance=1e-4, digits=2,
            note="The plant's drive has this dead band at its input as an assumption taken from Table 6.1; "
            "the row shows that the experiment finds it again. The tolerance is one level of the staircase.",
        ),
    ]  # fmt: skip
    for name, unit in axes.items():
        combined = mean_of(bands, name)
        why, gain = _balance(name, unit), hydraulic_gain(unit)
        rows += [
            Row(
                f"dead band of motor and actuator, axis {name}", "Table 6.1", COMBINED, combined, "V",
                tolerance=0.01, why=why,
            ),
            Row(
                f"the same as a velocity, Dp/A times it, axis {name}", "Table 6.1", 1e3 * COMBINED_VELOCITY,
                1e3 * combined * VOLT * gain, "mm/s", tolerance=1e3 * 0.01 * VOLT * gain, why=why,
            ),
        ]  # fmt: skip

    def draw(figure: Figure) -> None:
        left, *right = figure.subplots(1, 3)
        left.plot(1e3 * MOTOR_LEVELS, 1e3 * turns, "o-", label="plant")
        left.plot(1e3 * MOTOR_LEVELS, 1e3 * VOLT * MOTOR_LEVELS, "k:", linewidth=1.0, label="no dead band")
        left.axvline(1e3 * MOTOR, color="k", linestyle="--", linewidth=1.0, label="thesis, 1.1 mV")
        left.set(xlabel="command (mV)", ylabel="motor speed (mrad/s)", title="motor, axis A")
        for one, (name, unit) in zip(right, axes.items(), strict=True):
            for s, way, marker in ((1.0, "forward", "o"), (-1.0, "reverse", "s")):
                label = f"{way}: {bands[name, s]:.3f} V"
                one.plot(LEVELS, 1e3 * climbs[name, s].mean(axis=0), marker, label=label)
            free = 1e3 * hydraulic_gain(unit) * VOLT * LEVELS
            one.plot(LEVELS, free, "k:", linewidth=1.0, label="no dead band")
            one.axvline(COMBINED, color="k", linestyle="--", linewidth=1.0, label="thesis, 0.06 V")
            one.set(xlabel="command (V)", ylabel="velocity (mm/s)", title=f"motor and actuator, axis {name}")
            one.set_ylim(-0.1, 5.0)
        left.set_ylim(-3.0, 140.0)
        for one in (left, *right):
            one.legend(fontsize=8, loc="upper left")

    return Finding(
        "Dead band",
        "Table 6.1 gives the commands from which motor and actuator move, without saying how they were "
        f"found, nor on which axis. Here commands climb in steps of {HOLD:g} s, without load, both ways, "
        f"{TRIALS} trials; a dead band is where the line through the speeds at which motor or actuator "
        "move meets zero.",
        rows,
        remarks=[
            "Axis B, which leaks less, comes nearer to the thesis than axis A. Commands that fall instead "
            f"of climbing give {mean_of(falls, 'A'):.3f} V (A) and {mean_of(falls, 'B'):.3f} V (B): the "
            "pump must hold against the friction of slow motion, not against the break-away alone."
        ],
        pictures=[Picture("dead_band", "Speed of motor and actuator over small commands.", draw)],
    )


def _balance(name: str, unit: Unit) -> str:
    """Why the pump needs more than the thesis's 0.06 V."""
    per_newton = holding_leakage(unit) / (unit.cylinder.area_1 * unit.pump.displacement * VOLT)
    statics = unit.friction.forward.static, unit.friction.reverse.static
    forces = " and ".join(f"{f:.0f}" for f in statics)
    volts = " and ".join(f"{MOTOR + per_newton * f:.3f}" for f in statics)
    return (
        "To hold F newton the pump must make up the leakage, ω = (ξ + C_ep)·F/(A·Dp) with the low side refed "
        f"(mode 2), beyond the motor's own dead band: {forces} N of Table 5.1 (axis {name}) "
        f"need {volts} V before the piston slides; 0.06 V hold only {(COMBINED - MOTOR) / per_newton:.0f} N. "
        "So the thesis's dead band, leakage and static friction exclude each other."
    )


def mean_of(bands: dict[tuple[str, float], float], name: str) -> float:
    """Mean over both directions of one axis."""
    return 0.5 * (bands[name, 1.0] + bands[name, -1.0])


def hydraulic_gain(unit: Unit) -> float:
    """Dp/A (m/rad)."""
    return unit.pump.displacement / unit.cylinder.area_1
