"""Section 5.3, Table 5.1: static friction as the pressure peak of step starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fdd.plant.details import Details
from fdd.prototype.findings import Finding, Picture, Row, Table
from fdd.prototype.friction_modes import MODES, Mode, drive_both, measured_force
from fdd.prototype.runs import PERIOD, VOLT
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

VOLTS = np.array([0.5, 0.75, *np.arange(1.0, 9.01, 0.5), 10.0])
"""Step sizes; the thesis steps between 0.5 and 10 V."""
LONG_MEMORY = 0.1
"""s, lag of the friction curve in the demonstration: five times the plant's."""
_SURE = 2.0 / np.sqrt(2.0 * (VOLTS.size - 1))
"""Twice the relative sampling error of a standard deviation from that many trials."""
_REST = 200
_CREEP_VOLT, _CREEP_TIME = 0.13, 15.0


def peaks(
    mode: Mode, units: dict[str, Unit], seed: int, details: Details | None = None
) -> tuple[Array, Array]:
    """Peak force of a step start at each of `VOLTS`, a trial each: by the sensor and in truth, (20,) N."""
    found = []
    for i, volt in enumerate(VOLTS):
        n = round(min(0.2 / (7.3e-4 * VOLT * volt), 1.0) / PERIOD)
        speed = np.concatenate([np.zeros(_REST), np.full(n, VOLT * volt)])
        out = drive_both(mode, units, speed, seed + i, details or Details())
        measured = float(np.max(measured_force(mode, out)))
        area = 0.5 * (out.unit.cylinder.area_1 + out.unit.cylinder.area_2)
        found.append((measured, area * float(np.max(mode.sign * out.truth["pressure_difference"]))))
    table = np.array(found)
    return table[:, 0], table[:, 1]


def creeping_peaks(mode: Mode, units: dict[str, Unit], seed: int, trials: int = 10) -> Array:
    """Peak force where both pumps start so slowly that the piston creeps before it breaks away, (trials,) N.

    The sensor's noise is averaged over 0.25 s: the pressure needs seconds to rise.
    """
    found = []
    for i in range(trials):
        speed = np.full(round(_CREEP_TIME / PERIOD), VOLT * _CREEP_VOLT)
        force = measured_force(mode, drive_both(mode, units, speed, seed + i, Details()))
        found.append(float(np.max(np.convolve(force, np.full(250, 0.004), mode="valid"))))
    return np.array(found)


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Repeat the step starts of all four modes."""
    units = {"A": axis_a, "B": axis_b}
    both = {m.name: peaks(m, units, seed + 1000 * k) for k, m in enumerate(MODES)}
    found = {name: measured for name, (measured, _) in both.items()}
    noise = float(np.mean([np.mean(measured - true) for measured, true in both.values()]))
    creeping = {m.name: creeping_peaks(m, units, seed + 1000 * k + 500) for k, m in enumerate(MODES)}
    lagging, _ = peaks(MODES[0], units, seed, Details(friction_memory=LONG_MEMORY))
    rows, cells = [], []
    for mode in MODES:
        values, slow = found[mode.name], creeping[mode.name]
        why = (
            f"The peaks are those of eq. 5.12 at the speed of the start, not at rest: a start that creeps "
            f"({_CREEP_VOLT:g} V) peaks at {slow.mean():.0f} ± {np.std(slow, ddof=1):.0f} N. See below."
        )
        rows.append(
            Row(
                f"static friction, {mode.name}", "Table 5.1", mode.static, float(values.mean()), "N",
                tolerance=mode.spread, why=why,
            )
        )  # fmt: skip
        spread = float(np.std(values, ddof=1))
        rows.append(
            Row(
                f"its spread over trials, {mode.name}", "Table 5.1", mode.spread, spread, "N",
                tolerance=_SURE * mode.spread,
                why=f"Relative to the peak it is {100.0 * spread / values.mean():.1f} % where the thesis "
                f"has {100.0 * mode.spread / mode.static:.1f} %: the plant draws a factor, and its peaks "
                "are lower.",
            )
        )  # fmt: skip
        cells.append(
            (
                mode.name,
                f"{mode.static:.1f} ± {mode.spread:.1f}",
                f"{values.mean():.1f} ± {np.std(values, ddof=1):.1f}",
                f"{slow.mean():.1f} ± {np.std(slow, ddof=1):.1f}",
            )
        )

    def draw(figure: Figure) -> None:
        for axes, mode in zip(figure.subplots(2, 2, sharex=True, sharey=True).flat, MODES, strict=True):
            low, high = mode.static - mode.spread, mode.static + mode.spread
            axes.axhspan(low, high, color="0.88", label="thesis, mean ± standard deviation")
            axes.axhline(mode.static, color="k", linestyle="--", linewidth=1.0)
            axes.plot(VOLTS, found[mode.name], "o", label="plant, step starts")
            slow = creeping[mode.name]
            axes.plot(np.full(slow.size, _CREEP_VOLT), slow, "C3x", label="plant, creeping starts")
            axes.set_title(f"axis {mode.name}", fontsize=10)
            axes.set_ylim(0.0, 650.0)
        axes.legend(fontsize=8, loc="lower right")
        figure.supxlabel("step (V)", fontsize=10)
        figure.supylabel("peak force (N)", fontsize=10)

    at_slowest = float(MODES[0].branch.coulomb + 359.1 * np.exp(-((0.011 / 0.026) ** 0.590)))
    return Finding(
        "Static friction",
        "Section 5.3 steps both pumps, which drive one cylinder together, to 0.5 to 10 V (0.011 to 0.22 "
        "m/s) and takes the highest pressure of each trial times the area as the static friction. Here: "
        "twenty steps in each of the four modes, each a trial of its own, by the differential pressure "
        "sensor; the two pumps count as one on one shaft.",
        rows,
        tables=[
            Table(
                "Static friction (N), mean ± standard deviation over trials",
                ("mode", "thesis", "plant, steps of 0.5 to 10 V", f"plant, creeping at {_CREEP_VOLT:g} V"),
                cells,
            )
        ],
        remarks=[
            "The thesis's curve and its peaks exclude each other without a memory of rest: eq. 5.14 "
            f"gives {at_slowest:.0f} N at 0.011 m/s, the slowest start, and less at every faster one, yet "
            "figure 5.8 shows peaks near 510 N at all speeds. A friction that keeps its resting value "
            "for a while after the piston has begun to move would join the two. The plant has such a lag "
            f"of {1e3 * Details().friction_memory:.0f} ms, an assumption; with {1e3 * LONG_MEMORY:.0f} ms "
            f"the starts of A forward peak at {lagging.mean():.0f} ± {np.std(lagging, ddof=1):.0f} N. The "
            "thesis gives no number for it, so nothing was tuned.",
            f"Of each peak {noise:.0f} N are the pressure sensor's noise, on average: a maximum takes its "
            "crests.",
        ],
        pictures=[
            Picture(
                "static_friction", "Peak force over the size of the step, as figure 5.8.", draw, height=5.4
            )
        ],
    )
