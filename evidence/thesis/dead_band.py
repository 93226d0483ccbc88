"""Table 6.1: the dead band of the motor, and that of motor and actuator.

For the actuator there are two readings: the offset of its velocity over the command, as figure 5.1 plots it,
and the command from which it slides out of rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.friction_modes import MODES, Mode
from evidence.thesis.gain import SPEEDS, speeds_of
from evidence.thesis.leakage import SLOPES, holding_leakage
from evidence.thesis.runs import PERIOD, VOLT, run_speed
from evidence.thesis.whole_eha import with_coulomb_alone, with_friction
from fdd.identification.experiments.gain import SLIDING, dead_band
from fdd.identification.friction import curve
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


def offsets(command: Array, velocity: Array) -> Array:
    """Where the lines through velocity over command meet zero, forward and reverse, (2,) V, both positive."""
    found = []
    for sign in (1.0, -1.0):
        way = sign * command > 0.0
        slope, rest = np.polyfit(command[way], velocity[way], 1)
        found.append(-sign * rest / slope / VOLT)
    return np.array(found)


def measured_offset(unit: Unit, seed: int, trials: int = TRIALS) -> float:
    """Offset (V) in section 5.1's experiment, mean over both directions and the trials."""
    runs = [offsets(SPEEDS, speeds_of(unit, seed + SPEEDS.size * i)[1]) for i in range(trials)]
    return float(np.mean(runs))


def offset_of_equations(unit: Unit, axis: str) -> float:
    """The same offset (V) by eqs 5.3 and 5.12 with the thesis's own numbers, nothing of the plant."""
    area, displacement = unit.cylinder.area_1, unit.pump.displacement

    def steady(mode: Mode, speed: Array) -> Array:
        found = speed * displacement / area
        for _ in range(60):
            leak = SLOPES[axis] * curve(mode.branch, np.maximum(found, 1e-6)) / area
            found = 0.5 * (found + (displacement * speed - leak) / area)
        return found

    forward, reverse = (m for m in MODES if m.axis == axis)
    velocity = np.where(SPEEDS > 0.0, 1.0, -1.0)
    velocity[SPEEDS > 0.0] *= steady(forward, SPEEDS[SPEEDS > 0.0])
    velocity[SPEEDS < 0.0] *= steady(reverse, -SPEEDS[SPEEDS < 0.0])
    return float(np.mean(offsets(SPEEDS, velocity)))


def with_leakage_of(unit: Unit, pump: Unit, share: float = 1.0) -> Unit:
    """The same axis with a share of another one's leakage."""
    changed = unit.model_copy(deep=True)
    changed.pump.cross_port_leakage = share * pump.pump.cross_port_leakage
    changed.pump.case_leakage = share * pump.pump.case_leakage
    return changed


def _changes(axis_a: Unit, axis_b: Unit, seed: int) -> list[tuple[str, ...]]:
    """Both readings with one thing changed at a time."""
    rubbing = axis_b.model_copy(deep=True)
    rubbing.friction = axis_a.friction.model_copy(deep=True)
    cases = {
        "axis A with half its leakage": with_leakage_of(axis_a, axis_a, 0.5),
        "axis A with half its friction": with_friction(axis_a, 0.5),
        "axis A, friction that does not rise towards rest": with_coulomb_alone(axis_a),
        "axis B with axis A's leakage": with_leakage_of(axis_b, axis_a),
        "axis B with axis A's friction": rubbing,
    }
    levels = np.concatenate([np.arange(0.01, 0.06, 0.01), LEVELS[2:]])
    cells: list[tuple[str, ...]] = []
    for name, unit in cases.items():
        from_rest = [sliding(levels, staircase(unit, levels, s, seed)[1], unit) for s in (1.0, -1.0)]
        cells.append((name, f"{measured_offset(unit, seed, 1):.3f}", f"{np.mean(from_rest):.3f}"))
    return cells


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Steady velocities over commands of ±1 to ±10 V, and a climb of small commands, on both axes."""
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
    cells = [("thesis, Table 6.1", "0.06", "0.06")]
    for name, unit in axes.items():
        combined, from_rest = measured_offset(unit, seed), mean_of(bands, name)
        why, gain = _balance(name, unit, from_rest), hydraulic_gain(unit)
        cells += [
            (
                f"thesis's own equations, axis {name}",
                f"{offset_of_equations(unit, name):.3f}",
                _held(unit)[1],
            ),
            (f"axis {name}", f"{combined:.3f}", f"{from_rest:.3f}"),
        ]
        rows += [
            Row(
                f"dead band of motor and actuator, axis {name}", "Table 6.1", COMBINED, combined, "V",
                tolerance=0.01, why="" if name == "A" else why, note=why if name == "A" else "",
            ),
            Row(
                f"the same as a velocity, Dp/A times it, axis {name}", "Table 6.1", 1e3 * COMBINED_VELOCITY,
                1e3 * combined * VOLT * gain, "mm/s", tolerance=1e3 * 0.01 * VOLT * gain,
                why="" if name == "A" else why,
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
        "Table 6.1 gives a dead band of the motor (V) and one of motor and actuator (V, and as a velocity of "
        "the actuator), without saying how they were found. The thesis plots one relation of velocity to "
        "command, figure 5.1; the actuator's dead band is read here as what the line through these steady "
        f"velocities falls short of, at ±1 to ±10 V, both ways, {TRIALS} trials. The motor's, and the "
        f"command from which the actuator slides out of rest, are from commands that climb in steps of "
        f"{HOLD:g} s.",
        rows,
        tables=[
            Table(
                "Both readings (V), and what one change does to them",
                ("case", "offset of the velocity", "sliding out of rest"),
                [*cells, *_changes(axis_a, axis_b, seed)],
            )
        ],
        remarks=[
            "Commands that fall instead of climbing give "
            f"{mean_of(falls, 'A'):.3f} V (A) and {mean_of(falls, 'B'):.3f} V (B) for the second reading: "
            "the pump must hold against the friction of slow motion, not against the break-away alone.",
            "The reading was chosen because it is the one under which the thesis's numbers agree with each "
            "other; which of them its author took is not known.",
        ],
        pictures=[
            Picture(
                "dead_band", "Speed of motor and actuator over small commands that climb out of rest.", draw
            )
        ],
    )


def _held(unit: Unit) -> tuple[str, str]:
    """Both static frictions (N) and the commands (V) that hold them against the leakage, as text."""
    per_newton = holding_leakage(unit) / (unit.cylinder.area_1 * unit.pump.displacement * VOLT)
    statics = unit.friction.forward.static, unit.friction.reverse.static
    volts = " and ".join(f"{MOTOR + per_newton * f:.3f}" for f in statics)
    return " and ".join(f"{f:.0f}" for f in statics), volts


def _balance(name: str, unit: Unit, from_rest: float) -> str:
    """What the other reading gives, and why it cannot be meant."""
    forces, volts = _held(unit)
    text = (
        f"The other reading does not agree: out of rest axis {name} slides from {from_rest:.3f} V. To hold F "
        "newton the pump must make up the leakage, ω = (ξ + C_ep)·F/(A·Dp) with the low side refed (mode 2), "
        f"beyond the motor's own dead band: {forces} N of Table 5.1 need {volts} V before the piston slides. "
        "If 0.06 V were that, the thesis's dead band, leakage and static friction would exclude each other."
    )
    if name == "A":
        return text
    return (
        "Chapter 6 measured axis A alone (6.2); axis B has less leakage and less friction. With axis A's "
        f"leakage and with axis A's friction its dead band rises, see below. {text}"
    )


def mean_of(bands: dict[tuple[str, float], float], name: str) -> float:
    """Mean over both directions of one axis."""
    return 0.5 * (bands[name, 1.0] + bands[name, -1.0])


def hydraulic_gain(unit: Unit) -> float:
    """Dp/A (m/rad)."""
    return unit.pump.displacement / unit.cylinder.area_1
