"""What the thesis built two axes for: two pumps on one cylinder, and one axis carrying a dead one.

Section 4.1 wants the by-pass to "decouple a pump", so that the other one drives with little resistance;
section 4.6.6 has the connect valves join both axes' lines, so that two pumps drive one actuator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Table
from evidence.thesis.position_step import GAIN
from evidence.thesis.runs import PERIOD, VOLT, run_position, run_speed
from fdd.plant.circuit import Circuit, Connect
from fdd.plant.scenario import Partner
from fdd.plant.simulate import Simulation
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

STROKE, FREQUENCY = 0.05, 0.2
"""m and Hz of the sine that the pair follows: at most 63 mm/s, half of what one pump can."""
VOLTS = (2.5, 5.0)
"""Commands at which the speed of one and of two pumps is compared."""
_CYCLES = 2.0
_REST = 200
_TRAVEL = 0.2


@dataclass(frozen=True)
class Speeds:
    """Steady motion at one command: velocity (m/s) and pressure differences of both axes (Pa)."""

    velocity: float
    pressure_a: float
    pressure_b: float


def connected(partner: Unit, drive: bool) -> tuple[tuple[Unit, Partner], Connect]:
    """Axis B's ball valve shut, its cylinder free over its throttle; its pump joins axis A's lines or stands.

    Parameters
    ----------
    partner : axis B.
    drive : whether its pump does what axis A's does, over open connect valves.
    """
    circuit = Circuit.model_validate({"blocked": True, "throttle": 1})
    beside = Partner(unit=partner.name, drive="same" if drive else "still", circuit=circuit)
    return (partner, beside), Connect.model_validate({"line_1": int(drive), "line_2": int(drive)})


def steady(axis_a: Unit, axis_b: Unit, volt: float, *, both: bool, seed: int) -> Speeds:
    """Axis A's cylinder at a constant command, by its own pump or by both, over the last 0.2 s."""
    beside, valves = connected(axis_b, both)
    fastest = 2.0 * VOLT * volt * axis_a.pump.displacement / axis_a.cylinder.area_1
    command = np.concatenate([np.zeros(_REST), np.full(round(_TRAVEL / fastest / PERIOD), VOLT * volt)])
    out = run_speed(axis_a, command, start=-0.1, partner=beside, connect=valves, seed=seed)
    assert out.partner is not None
    last = slice(-200, None)
    velocity = float(np.polyfit(out.samples.time[last], out.samples["position"][last], 1)[0])
    return Speeds(
        velocity,
        *(float(np.mean(axis.samples["pressure_difference"][last])) for axis in (out, out.partner)),
    )


CASES: dict[str, Partner] = {
    "both axes driven": Partner(drive="same"),
    "B without power, by-pass open": Partner.model_validate(
        {"drive": "still", "power": 0, "circuit": {"bypass": 1}}
    ),
    "B without power, by-pass shut": Partner.model_validate({"drive": "still", "power": 0}),
}
"""What axis B does while axis A's loop moves both."""


def follow(axis_a: Unit, axis_b: Unit, partner: Partner, seed: int) -> tuple[Simulation, Array]:
    """Both axes on a sine of set-points by section 7.2's controller on axis A, and that set-point (n,) m."""
    time = np.arange(round(_CYCLES / FREQUENCY / PERIOD)) * PERIOD
    setpoint = STROKE * np.sin(2.0 * np.pi * FREQUENCY * time)
    return run_position(axis_a, setpoint, GAIN, partner=(axis_b, partner), seed=seed), setpoint


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Compare one and two pumps on one cylinder, and what an axis without power costs the other."""
    speed_cells = []
    for volt in VOLTS:
        one, two = (steady(axis_a, axis_b, volt, both=b, seed=seed) for b in (False, True))
        for name, s in (("A's", one), ("both", two)):
            speed_cells.append(
                (
                    f"{volt:g} V", name, f"{1e3 * s.velocity:.1f}", f"{s.velocity / one.velocity:.2f}",
                    f"{1e-6 * s.pressure_a:.2f}", f"{1e-6 * s.pressure_b:.2f}",
                )
            )  # fmt: skip
    runs = {name: follow(axis_a, axis_b, p, seed) for name, p in CASES.items()}
    second = slice(round(1.0 / FREQUENCY / PERIOD), None)
    carry_cells = []
    for name, (out, setpoint) in runs.items():
        assert out.partner is not None
        error = (out.samples["position"] - setpoint)[second]
        carry_cells.append(
            (
                name,
                f"{1e3 * np.sqrt(np.mean(error**2)):.2f}",
                f"{1e3 * np.max(np.abs(error)):.2f}",
                f"{1e-6 * np.max(np.abs(out.truth['pressure_difference'][second])):.2f}",
                f"{1e-6 * np.max(np.abs(out.partner.truth['pressure_difference'][second])):.2f}",
                f"{np.sqrt(np.mean(out.truth['motor_current'][second] ** 2)):.2f}",
                f"{np.ptp(out.partner.truth['pump_angle'][second]) / (2 * np.pi):.1f}",
            )
        )

    ratios = [float(cells[3]) for cells in speed_cells if cells[1] == "both"]
    errors = [float(cells[1]) for cells in carry_cells]
    lag = 2.0 * np.pi * FREQUENCY * STROKE / (GAIN * axis_a.pump.displacement / axis_a.cylinder.area_1)

    def draw(figure: Figure) -> None:
        axes = figure.subplots(3, 1, sharex=True)
        for k, (name, (out, setpoint)) in enumerate(runs.items()):
            assert out.partner is not None
            time = out.samples.time[second]
            wide = 3.0 if k == 0 else 1.2  # the second lies on the first
            position = 1e3 * out.samples["position"][second]
            axes[0].plot(time, position, color=f"C{k}", linewidth=wide, label=name)
            error = (out.samples["position"] - setpoint)[second]
            axes[1].plot(time, 1e3 * error, color=f"C{k}", linewidth=wide)
            for axis, style in ((out, "-"), (out.partner, "--")):
                pressure = 1e-6 * axis.truth["pressure_difference"][second]
                axes[2].plot(time, pressure, style, color=f"C{k}", linewidth=0.6 * wide)
            if k == 0:
                axes[0].plot(time, 1e3 * setpoint[second], "k:", label="set-point")
        axes[2].plot([], [], "k-", label="axis A")
        axes[2].plot([], [], "k--", label="axis B")
        axes[0].set(ylabel="position (mm)")
        axes[1].set(ylabel="error (mm)")
        axes[2].set(ylabel="P1 - P2 (MPa)", xlabel="time (s)")
        axes[2].set_ylim(-4.2, 6.5)
        axes[0].legend(loc="upper right", fontsize=8)
        axes[2].legend(loc="upper right", fontsize=8, ncols=2)

    return Finding(
        "Dual operation",
        "Two axes on one rod are the thesis's purpose, without numbers of its own to hold against. Two "
        "pumps on one cylinder (4.6.6): axis B's ball valve is shut and its throttle open, the connect "
        "valves join its pump to axis A's lines. One axis carried by the other (4.1): axis B's motor is "
        f"without power and axis A's loop (section 7.2's, {GAIN:.0f} (rad/s)/m) follows a sine of "
        f"{1e3 * STROKE:.0f} mm at {FREQUENCY:g} Hz, with B's by-pass open and shut.",
        [],
        tables=[
            Table(
                "Axis A's cylinder, forward, by one pump and by two; B's cylinder rides along",
                ("command", "pumps", "velocity (mm/s)", "over one pump", "A: P1 - P2 (MPa)",
                 "B: P1 - P2 (MPa)"),
                speed_cells,
            ),
            Table(
                "Both cylinders on a sine, second cycle",
                ("axis B", "rms error (mm)", "largest error (mm)", "A: largest P1 - P2 (MPa)",
                 "B: largest P1 - P2 (MPa)", "A: rms current (A)", "B: turns of its pump"),
                carry_cells,
            ),
        ],
        remarks=[
            f"Two pumps double the speed: {ratios[0]:.2f} and {ratios[1]:.2f} times that of one at "
            f"{VOLTS[0]:g} and {VOLTS[1]:g} V. B's throttle, which must pass the oil of its riding cylinder, "
            "takes more pressure at the higher speed, and the pumps leak under it.",
            f"An axis without power costs the loop next to nothing with its by-pass open ({errors[1]:.2f} mm "
            f"rms instead of {errors[0]:.2f} mm; the lag of the loop itself is speed over gain, at most "
            f"{1e3 * lag:.1f} mm). With the by-pass shut its cylinder turns the dead pump and motor "
            "through the oil: pressures reach the relief valves "
            f"({axis_a.accumulator.relief_pressure / 1e6:.2f} MPa), the error {errors[2]:.2f} mm rms.",
        ],
        pictures=[Picture("dual_operation", "One axis carries the other.", draw, height=6.4)],
    )  # fmt: skip
