"""Section 5.3, Table 5.1: static friction as the pressure peak of step starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table
from evidence.thesis.friction_modes import MODES, Mode, drive_both, measured_force
from evidence.thesis.runs import PERIOD, VOLT
from fdd.plant.details import Details
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

VOLTS = np.array([0.5, 0.75, *np.arange(1.0, 9.01, 0.5), 10.0])
"""Step sizes; the thesis steps between 0.5 and 10 V."""
_SURE = 2.0 / np.sqrt(2.0 * (VOLTS.size - 1))
"""Twice the relative sampling error of a standard deviation from that many trials."""
_REST = 200
_CREEP_VOLT, _CREEP_TIME = 0.13, 15.0


def peaks(
    mode: Mode,
    units: dict[str, Unit],
    seed: int,
    details: Details | None = None,
    volts: Array = VOLTS,
) -> tuple[Array, Array]:
    """Peak force of a step start at each of `volts`, a trial each: by the sensor and in truth, (20,) N."""
    found = []
    for i, volt in enumerate(volts):
        n = round(min(0.2 / (7.3e-4 * VOLT * volt), 1.0) / PERIOD)
        speed = np.concatenate([np.zeros(_REST), np.full(n, VOLT * volt)])
        out = drive_both(mode, units, speed, seed + i, details or Details())
        measured = float(np.max(measured_force(mode, out)))
        area = 0.5 * (out.unit.cylinder.area_1 + out.unit.cylinder.area_2)
        found.append((measured, area * float(np.max(mode.sign * out.truth["pressure_difference"]))))
    table = np.array(found)
    return table[:, 0], table[:, 1]


def creeping_peaks(mode: Mode, units: dict[str, Unit], seed: int, trials: int = 10) -> Array:
    """Peak force where both pumps start so slowly that the pressure needs seconds to rise, (trials,) N.

    The sensor's noise is averaged over 0.25 s.
    """
    found = []
    for i in range(trials):
        speed = np.full(round(_CREEP_TIME / PERIOD), VOLT * _CREEP_VOLT)
        force = measured_force(mode, drive_both(mode, units, speed, seed + i, Details()))
        found.append(float(np.max(np.convolve(force, np.full(250, 0.004), mode="valid"))))
    return np.array(found)


def _about_line(values: Array) -> float:
    """Standard deviation (N) of the peaks about a straight line over the step's size."""
    left = values - np.polyval(np.polyfit(VOLTS, values, 1), VOLTS)
    return float(np.std(left, ddof=2))


_ALIKE = 5.0
_RISE_HEADS = ("case", "rise (N/V)", "standard deviation (N)")


def _rise(mode: Mode, units: dict[str, Unit], seed: int, as_is: Array) -> list[tuple[str, ...]]:
    """Rise and spread of one mode's peaks with one thing changed at a time."""
    lighter = {name: unit.model_copy(deep=True) for name, unit in units.items()}
    for unit in lighter.values():
        unit.cylinder.moving_mass *= 0.1
    alike, _ = peaks(mode, units, seed, volts=np.full(VOLTS.size, _ALIKE))
    cases = {
        "a tenth of the piston's mass": peaks(mode, lighter, seed)[0],
        "no resistance of the seal to quick changes": peaks(mode, units, seed, Details(seal_damping=0.0))[0],
        "the friction's lag 10 ms": peaks(mode, units, seed, Details(friction_memory=0.01))[0],
    }

    def cells(name: str, values: Array) -> tuple[str, ...]:
        return name, f"{np.polyfit(VOLTS, values, 1)[0]:.1f}", f"{np.std(values, ddof=1):.1f}"

    return [
        cells("as it is", as_is),
        (f"all steps of {_ALIKE:g} V", "", f"{np.std(alike, ddof=1):.1f}"),
        *(cells(name, values) for name, values in cases.items()),
    ]


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Repeat the step starts of all four modes."""
    units = {"A": axis_a, "B": axis_b}
    both = {m.name: peaks(m, units, seed + 1000 * k) for k, m in enumerate(MODES)}
    found = {name: measured for name, (measured, _) in both.items()}
    noise = float(np.mean([np.mean(measured - true) for measured, true in both.values()]))
    creeping = {m.name: creeping_peaks(m, units, seed + 1000 * k + 500) for k, m in enumerate(MODES)}
    plain, _ = peaks(MODES[0], units, seed, Details(breakaway=0.0))
    steepest = max(MODES, key=lambda m: float(np.polyfit(VOLTS, found[m.name], 1)[0]))
    rise = _rise(steepest, units, seed + 1000 * MODES.index(steepest), found[steepest.name])
    drawn = {name: unit.friction.trial_spread for name, unit in units.items()}
    rows, cells = [], []
    for mode in MODES:
        values, slow = found[mode.name], creeping[mode.name]
        why = f"A slow start ({_CREEP_VOLT:g} V) peaks at {slow.mean():.0f} N."
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
                why=f"{VOLTS.size} trials: their standard deviation is itself uncertain by "
                f"{50.0 * _SURE:.0f} %. The plant's peaks rise with the step (see below); about the line "
                f"through them they spread by {_about_line(values):.1f} N, and twenty steps of "
                f"{_ALIKE:g} V by {rise[1][2]} N. The plant draws a "
                f"factor of standard deviation {drawn[mode.axis]:.2f} on each trial's friction.",
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
            axes.plot(
                np.full(slow.size, _CREEP_VOLT), slow, "C3x", label=f"plant, slow starts ({_CREEP_VOLT:g} V)"
            )
            axes.set_title(f"axis {mode.name}", fontsize=10)
            axes.set_ylim(0.0, 650.0)
        axes.legend(fontsize=8, loc="lower right")
        figure.supxlabel("step (V)", fontsize=10)
        figure.supylabel("peak force (N)", fontsize=10)

    slopes = {name: float(np.polyfit(VOLTS, values, 1)[0]) for name, values in found.items()}
    lower = [float(found[m.name].mean() - creeping[m.name].mean()) for m in MODES]
    at_slowest = float(MODES[0].branch.coulomb + 359.1 * np.exp(-((0.011 / 0.026) ** 0.590)))
    return Finding(
        "Static friction",
        "Section 5.3 steps both pumps, which drive one cylinder together, to 0.5 to 10 V (0.011 to 0.22 "
        "m/s) and takes the highest pressure of each trial times the area as the static friction. Here: "
        "twenty steps in each of the four modes, each a trial of its own, by the differential pressure "
        "sensor. The two pumps count as one on one shaft, their coupled cylinder left out: with the connect "
        "valves the plant's dual rig would carry the other cylinder along, and its seals with it.",
        rows,
        tables=[
            Table(
                "Static friction (N), mean ± standard deviation over trials",
                ("mode", "thesis", "plant, steps of 0.5 to 10 V", f"plant, slow starts of {_CREEP_VOLT:g} V"),
                cells,
            ),
            Table(f"Where the peaks' rise with the step comes from, {steepest.name}", _RISE_HEADS, rise),
        ],
        remarks=[
            "Eqs 5.8 to 5.12 alone do not give these peaks: eq. 5.14 has "
            f"{at_slowest:.0f} N at 0.011 m/s, the slowest start, and less at every faster one, yet figure "
            "5.8 shows peaks near 510 N at all speeds. In the plant the seals bend without sliding until "
            f"they carry {100 * Details().breakaway:.0f} % of their steady friction, and the friction's "
            f"curve follows the sliding {1e3 * Details().friction_memory:.0f} ms late. The first of these "
            "was chosen by this table, so its means are no test of the plant; that one number serves four "
            "modes and all speeds is. Without it (eq. 5.9 as it stands) the starts of A forward peak at "
            f"{plain.mean():.0f} ± {np.std(plain, ddof=1):.0f} N.",
            f"The peaks rise with the step, by {min(slopes.values()):.0f} to {max(slopes.values()):.0f} N/V "
            "by a straight line through each mode's trials; figure 5.8 shows no rise. The means meet Table "
            "5.1 all the same, the flatness over speed does not. Most of it is the force that the "
            "thesis's own piston mass takes to reach its speed within milliseconds: see the second table.",
            f"Starts at {_CREEP_VOLT:g} V, so slow that the pressure needs seconds to rise, peak at "
            f"{min(lower):.0f} to {max(lower):.0f} N less than the steps (crosses in the picture).",
            f"Of each peak {noise:.0f} N are the pressure sensor's noise, on average: a maximum takes its "
            "crests.",
        ],
        pictures=[
            Picture(
                "static_friction", "Peak force over the size of the step, as figure 5.8.", draw, height=5.4
            )
        ],
    )
