"""The measured figures as Markdown."""

from __future__ import annotations

import numpy as np

from evidence.machine import load_now, machine
from evidence.plant.convergence import GAINED, Difference
from evidence.plant.measure import Measured
from evidence.plant.robustness import Outcome
from evidence.plant.speed import Work
from fdd import __version__
from fdd.markdown import table

PICTURE = "performance-work.png"
GOAL = 300.0
"""Times real time that one axis with everything on is to run at."""


def report_text(found: Measured) -> str:
    """The whole report.

    Parameters
    ----------
    found : from `evidence.plant.measure.measure`.
    """
    parts = [
        "# Performance and numerics of the plant",
        "",
        f"Made by `python -m evidence plant` of fdd {__version__} on one core of {machine()}; {load_now()}",
        "Times are processor time, medians of repeated runs, after everything is compiled.",
        "",
        *_speed(found),
        *_work(found),
        "## Numerics",
        "",
    ]
    if found.halved:
        parts += _halving(found)
    if found.radau:
        parts += _radau(found)
    if found.wild:
        parts += _wild(found.wild)
    return "\n".join(parts).rstrip() + "\n"


def _speed(found: Measured) -> list[str]:
    rows = [[r.case, f"{r.whole:.0f}", f"{r.integration:.0f}", f"{r.steps:.2f}"] for r in found.real_time]
    single = [r for r in found.real_time if not r.case.startswith("two axes")]
    least = min(single, key=lambda r: r.whole)
    verdict = "met" if least.whole >= GOAL else "missed"
    return [
        "## Speed",
        "",
        "Leakage, ripple, air, friction with bristles, valves, electrics, sensors with noise, a fault "
        f"from 2 s on; {found.plan.speed_duration:g} s runs, {found.plan.repeats} of each.",
        "",
        *table(
            ["case", "whole run, × real time", "integration alone, × real time", "steps per ms"], rows, "lr"
        ),
        f"Goal for one axis, whole run: {GOAL:.0f} × real time; the slowest case, {least.case}, has "
        f"{least.whole:.0f}: {verdict}.",
        "",
    ]


def _work(found: Measured) -> list[str]:
    ours = next(point for point in found.work if point.setting == "refine 1")
    rows = [
        [
            f"{p.solver}, {p.setting}", f"{p.position:.1e}", f"{p.pressure:.1e}", f"{p.cpu:.2g}",
            f"{p.cpu / ours.cpu:.1f}", f"{p.evaluations:.0f}",
        ]
        for p in found.work
    ]  # fmt: skip
    return [
        "## Error over work, beside SciPy's solvers",
        "",
        "All solve the plant's own compiled right-hand side, SciPy's through a thin wrapper, with the "
        "same commands held for each millisecond: a solver starts anew where one may change. Errors are "
        f"rms against steps 64 times as short as usual, {found.plan.work_duration:g} s of random speeds "
        "against a throttle. Radau with the tightest tolerance differs from that reference by "
        f"{found.trust:.1e} Pa. Most of SciPy's time goes into Python between calls, and the evaluations "
        "(Radau's for its Jacobians not counted) say what a compiled one would have to do.",
        "",
        *table(
            [
                "solver", "position (m)", "pressure difference (Pa)", "s per s simulated", "× this plant",
                "evaluations per s",
            ],
            rows, "lr",
        ),
        *_same_error(found.work, ours),
        f"![Error over work]({PICTURE})",
        "",
    ]  # fmt: skip


def _same_error(work: list[Work], ours: Work) -> list[str]:
    """For each peer: the cheapest setting that is no worse than the plant's usual one."""
    lines = []
    for solver in dict.fromkeys(point.solver for point in work if point.solver != ours.solver):
        equal = [
            point
            for point in work
            if point.solver == solver and point.pressure <= ours.pressure and point.position <= ours.position
        ]
        if equal:
            best = min(equal, key=lambda point: point.cpu)
            lines.append(
                f"- {solver} reaches the error of refine 1 at {best.setting}, in "
                f"{best.cpu / ours.cpu:.0f} times its time and {best.evaluations / ours.evaluations:.1f} "
                "times its evaluations."
            )
        else:
            lines.append(f"- {solver} does not reach the error of refine 1 at these tolerances.")
    return [*lines, ""]


def _differences(found: list[Difference]) -> list[str]:
    channels = list(dict.fromkeys(channel for difference in found for channel in difference.rms))
    channels.sort(key=lambda channel: channel in ("pump_angle", GAINED))
    rows = []
    for difference in found:
        cells = [
            f"{difference.rms[c]:.1e} ({difference.most[c]:.1e})" if c in difference.rms else ""
            for c in channels
        ]
        rows.append([difference.case, *cells])
    return table(["case", *channels], rows, "lr")


def _halving(found: Measured) -> list[str]:
    worst = max(difference.worst for difference in found.halved_alone)
    angle = max(difference.rms["pump_angle"] for difference in found.halved_alone)
    gained = max(difference.rms.get(GAINED, 0.0) for difference in found.halved_alone)
    flips = [d for d in found.halved if np.isfinite(d.first_count)]
    return [
        "### Steps half as long",
        "",
        f"{found.plan.halving_duration:g} s of each case, `refine=2` against the usual steps: differences "
        "of the true quantities, rms (largest), over what the sensor cannot see: the rms of its white "
        "noise and of its rounding, LSB/√12. The encoders have no noise, so theirs is LSB/√12 alone: "
        "0.29 µm, and 28 µrad of angle.",
        "",
        "The numerics alone, with a loop that sees the position without the encoder's steps: the worst "
        f"rms is {worst:.1e}. The motor encoder's 65536 counts a turn stand apart: {gained:.1e} of the "
        f"angle gained in a second, {angle:.1e} of the accumulated one, an integral over the whole run "
        "that no loop closes; each corner that a step runs over adds its error.",
        "",
        *_differences(found.halved_alone),
        "With the encoder in the loop a position on the edge between two counts may round to another "
        f"one; in {len(flips)} of {len(found.halved)} cases it did, and from then on the commands differ "
        "by the gain times a count for a millisecond at a time.",
        "",
        *_differences(found.halved),
    ]


def _radau(found: Measured) -> list[str]:
    return [
        "### Beside Radau",
        "",
        f"{found.plan.radau_duration:g} s of each case; SciPy's Radau, relative tolerance 1e-10, absolute "
        "ones a hundredth of the plant's, on the same right-hand side and commands, started anew each "
        "millisecond. Rms (largest), over what the sensor cannot see, as above.",
        "",
        *_differences(found.radau),
    ]


def _two(shares: list[float]) -> str:
    return " / ".join(f"{q:.1e}" for q in np.nanpercentile(shares, (99, 100)))


def _wild(outcomes: list[Outcome]) -> list[str]:
    failed = [outcome for outcome in outcomes if outcome.failures]
    steps = np.array([outcome.steps for outcome in outcomes])
    refused = sum(outcome.refused for outcome in outcomes)
    quantiles = np.nanpercentile(steps, (50, 99, 100))
    beyond = float(np.nanmax([outcome.beyond_stop for outcome in outcomes]))
    return [
        "### Robustness",
        "",
        f"{len(outcomes)} random scenarios of 4 s: units and details as campaigns draw them, every plant "
        "fault by every law and course alone and together with severities up to 1, every load and duty, "
        "valves and by-passes moving, one axis or two with one accumulator or two, a quarter of them the "
        "thesis's of 13 cm³, motors without power, -20 to 110 °C, 0.3 to 2.5 of the charge, 20 to "
        f"110 kPa around it. {refused} more draws were refused by the rig's own rules. Checked of each: "
        "no NaN, absolute pressures above 0, pressures below what accumulator, relief valves and their "
        "flow, load, friction and momentum explain (`evidence.plant.robustness.pressure_bound`), the "
        "piston within its stops and their give, the motor no faster than commands or oil drive it, oil "
        "kept to a millionth, and over the first 0.4 s energy to a hundred-thousandth of what went through "
        "(or of a joule), by the ledger of `evidence.plant.energies`.",
        "",
        *table(
            ["of all runs", "figure"],
            [
                ["outside physics", str(len(failed))],
                ["lowest absolute pressure", f"{np.nanmin([o.lowest_pressure for o in outcomes]):.0f} Pa"],
                ["highest pressure over its bound", f"{np.nanmax([o.highest_share for o in outcomes]):.2f}"],
                ["oil made or lost, 99 %, most", _two([o.oil for o in outcomes])],
                ["energy made or lost, 99 %, most", _two([o.energy for o in outcomes])],
                ["farthest into a stop", f"{1e3 * max(beyond, 0.0):.2f} mm"],
                ["steps per ms, median, 99 %, most", " / ".join(f"{q:.1f}" for q in quantiles)],
            ], "lr",
        ),
        *[f"- seed {outcome.seed}: {'; '.join(outcome.failures)}" for outcome in failed],
        "",
    ]  # fmt: skip
