"""The benchmark's figures as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evidence.estimators.cases import MINIMUM, WINDOW
from evidence.estimators.measure import PEER_DURATION, Measured, PeerOutcome
from evidence.estimators.peers import PEERS
from evidence.estimators.pictures import PICTURES
from evidence.estimators.run import WORLDS
from evidence.estimators.speed_section import speed_lines
from evidence.estimators.steps import STEP_CASE
from evidence.estimators.summary import ABSOLUTE, Accuracy, accuracy, coverage, goals
from evidence.estimators.trajectory import QUANTITIES
from evidence.machine import machine
from fdd import __version__
from fdd.markdown import table
from fdd.residuals.tracking import METHODS

_WORLD = {
    "matched": "Matched world: data from the filters' own model",
    "plant": "Plant world: data from the faulty-plant simulator",
}
SHOWN = 12
"""Shortfalls that are listed for each goal."""


def report_text(found: Measured) -> str:
    """The whole report.

    Parameters
    ----------
    found : from `evidence.estimators.measure.measure`.
    """
    parts = ["# How well the EHA estimators do", "", *_intro(found), *_goals(found)]
    for world in WORLDS:
        if any(at == world for at, _ in found.runs):
            parts += [f"## {_WORLD[world]}", "", *_accuracy(found, world), *_coverage(found, world)]
    parts += [*_steps(found), *_still(found), *_peers(found), *speed_lines(found.speed)]
    return "\n".join(parts).rstrip() + "\n"


def _intro(found: Measured) -> list[str]:
    plan = found.plan
    return [
        f"Made by `python -m evidence estimators` of fdd {__version__} on {machine()}, "
        f"seed {plan.seed}. {plan.runs} runs of {plan.duration:g} s for each of {len(plan.cases)} cases, in "
        "two worlds; each run draws another unit, other noise and another duty.",
        "",
        "**Matched world.** Position follows a duty; pressures, parameters and measurements are drawn from "
        "the very model and noise that the filters assume, parameters walking at random as they allow. "
        "Nothing is wrong with the model here, so consistency and the bound can be taken at their word.",
        "",
        "**Plant world.** The faulty-plant simulator with its bristles, ripple, line losses, valves and "
        "quantised sensors. The unit differs from the profile that the filters have as their initial spread "
        "says. Its parameters stand still, so an error may well be below a bound that lets them walk.",
        "",
        f"Errors are counted at five times in the last {WINDOW:g} s, where a filter calls the quantity "
        "observable. **Bound**: the posterior Cramér-Rao bound of the same data (Tichavský, Muravchik and "
        "Nehorai 1998, doi 10.1109/78.668800), with Jacobians at the true run and the model's process "
        "noise, taken run by run and averaged as variances. Friction enters it as it enters the filters, by "
        f"the mean force of 20 ms of settled sliding. **Least squares**: the volume balance over the "
        f"{WINDOW:g} s before each of these times, gain free; the two chambers' balances, or for the "
        f"minimum set that of the high side with the other at the accumulator's charge. The minimum set is "
        f"{', '.join(MINIMUM).replace('_', ' ')}.",
        "",
    ]


def _goals(found: Measured) -> list[str]:
    lines = ["## Goals", ""]
    for world in WORLDS:
        if not any(at == world for at, _ in found.runs):
            continue
        lines += [f"### {world.capitalize()} world", ""]
        for goal in goals(found, world):
            if not goal.total:
                continue
            verdict = "met" if goal.met == goal.total else "short"
            lines.append(f"- {goal.name}: **{verdict}**, {goal.met} of {goal.total}")
            lines += [f"  - {text}" for text in goal.short[:SHOWN]]
            if len(goal.short) > SHOWN:
                lines.append(f"  - and {len(goal.short) - SHOWN} more, see the tables")
        lines.append("")
    return lines


def _accuracy(found: Measured, world: str) -> list[str]:
    lines = [
        "Root mean square errors in percent of the true value, viscous friction in N·s/m. *Flagged*: share "
        "of the checks at which the filter calls the quantity observable. In brackets: over all checks, "
        "where it never (or in less than one of twenty) is. *Claimed*, *bias* and *spread* (standard "
        "deviation of the errors) are the EKF's.",
        "",
        *([f"![RMSE over the bound]({_picture('bound')})", ""] if world == WORLDS[0] else []),
    ]
    rows = []
    for (at, name), outcomes in found.runs.items():
        if at != world:
            continue
        for i, quantity in enumerate(QUANTITIES):
            both = [accuracy(outcomes, m, i) for m in range(len(METHODS))]
            ekf = both[0]
            rows.append([
                name if i == 0 else "", quantity.replace("_", " "),
                " / ".join(f"{a.flagged:.0%}" for a in both), *[_figure(a, a.rmse) for a in both],
                _figure(ekf, ekf.bound), *[f"{a.over_bound:.2f}" if a.counted else "" for a in both],
                _figure(ekf, ekf.fitted) if np.isfinite(ekf.fitted) else "", _figure(ekf, ekf.claimed),
                _figure(ekf, ekf.bias), _figure(ekf, ekf.spread),
            ])  # fmt: skip
    head = ["case", "quantity", "flagged EKF / SVSF", "EKF", "SVSF", "bound", "EKF/bound", "SVSF/bound",
            "least squares", "claimed", "bias", "spread"]  # fmt: skip
    return [*lines, *table(head, rows, "llr")]


def _coverage(found: Measured, world: str) -> list[str]:
    lines = [
        "**Consistency**, share of runs inside the 95 % bands. NEES: squared error of the four parameters at "
        "the end over their covariance, χ² with four degrees of freedom, and the share above it (too sure); "
        "then each parameter's error within 1.96 standard deviations. NIS: its mean over the last two "
        "thirds of a run. Channels that drive the model like inputs are not counted, for their innovations "
        "are small whatever the filter does: encoders, as the noise of motion is far above what they "
        "resolve, and the pressure of a chamber that the accumulator may feed; with the minimum set nothing "
        "is left to test. The band is that of as many independent samples as there are over the integrated "
        "autocorrelation time of its 10 ms means (Sokal 1997). *Mean NIS* is over its expectation. *Lost*: "
        "runs that ended without a covariance.",
        "",
        *([f"![Coverage]({_picture('coverage')})", ""] if world == WORLDS[0] else []),
    ]
    rows = []
    for (at, name), outcomes in found.runs.items():
        if at != world:
            continue
        for m, method in enumerate(METHODS):
            c = coverage(outcomes, m)
            rows.append([
                name if m == 0 else "", method.upper(), f"{c.nees:.0%}", f"{c.too_sure:.0%}",
                *[f"{s:.0%}" for s in c.scores],
                _share(c.nis), f"{c.mean_nis:.2f}" if np.isfinite(c.mean_nis) else "", f"{c.lost:.0%}",
            ])  # fmt: skip
    head = [
        "case",
        "method",
        "NEES",
        "above",
        *[q.replace("_", " ") for q in QUANTITIES],
        "NIS",
        "mean NIS",
        "lost",
    ]
    return [*lines, *table(head, rows, "llr")]


def _steps(found: Measured) -> list[str]:
    if not found.steps:
        return []
    rows = []
    for (world, quantity), steps in found.steps.items():
        half = np.array([s.half for s in steps])
        cells = []
        for m in range(len(METHODS)):
            cells += [
                _seconds(np.median(half[:, m])),
                _seconds(np.quantile(half[:, m], 0.9, method="higher")),
            ]
        rows.append([world, quantity.replace("_", " "), *cells])
    return [
        "## A sudden change",
        "",
        f"Leakage +50 %, bulk modulus -30 %, friction +50 % in mid-run ({STEP_CASE.name} sensors): seconds "
        "until the estimate has followed half of it, median and 90 % of the runs.",
        "",
        *table(
            ["world", "quantity", *[f"{m.upper()}, {q}" for m in METHODS for q in ("median", "90 %")]],
            rows,
            "llr",
        ),
        f"![Response]({_picture('steps')})",
        "",
    ]


def _still(found: Measured) -> list[str]:
    if not found.still:
        return []
    rows = []
    for name in dict.fromkeys(outcome.case for outcome in found.still):
        runs = [outcome for outcome in found.still if outcome.case == name]
        for m, method in enumerate(METHODS):
            most = np.array([np.abs(o.moved[m]).max(axis=1) for o in runs])
            grown = np.array([o.std[m, :, -1] for o in runs])
            rows.append([
                name, method.upper(), str(len(runs)),
                *[f"{a:.2f} ({b:.1f})" for a, b in zip(most.max(axis=0), grown.mean(axis=0), strict=True)],
            ])  # fmt: skip
    return [
        "## An hour at standstill",
        "",
        f"The plant world: 20 s of steps, then nothing until {found.plan.still_duration:g} s. The largest "
        "change of an estimate's error, over the standard deviation that was claimed when standstill began; "
        "in brackets that standard deviation at the end over its beginning.",
        "",
        *table(["case", "method", "runs", *[q.replace("_", " ") for q in QUANTITIES]], rows, "llr"),
        f"![Standstill]({_picture('standstill')})",
        "",
    ]


def _peers(found: Measured) -> list[str]:
    if not found.peers:
        return []
    names = [*PEERS, *[f"our {m.upper()}" for m in METHODS]]
    rows = []
    for (world, name), outcomes in found.peers.items():
        for i, quantity in enumerate(QUANTITIES):
            errors, bound = _scaled(outcomes, i)
            rms = np.sqrt(np.nanmean(errors**2, axis=(0, 2)))
            lost = np.isnan(errors).any(axis=2).sum(axis=0)
            cells = [
                (f"{r:.3g}" if np.isfinite(r) else "") + (f" ({n} lost)" if n else "")
                for r, n in zip(rms, lost, strict=True)
            ]
            rows.append([world if i == 0 else "", name if i == 0 else "", quantity.replace("_", " "), *cells,
                         f"{np.sqrt(np.mean(bound**2)):.3g}"])  # fmt: skip
    return [
        "## Beside filterpy",
        "",
        f"filterpy's filters are slow: {found.plan.peers} runs of {PEER_DURATION:g} s of a few cases, "
        "errors over the last half at all times, flagged or not. They have the same model, noise, channels "
        "and first estimate. What cannot be said to them: they linearise at their own prediction and not at "
        "what the encoders measure, learn friction sample by sample from the velocity equation instead of "
        "from mean forces, and have neither robust weights nor bounds on parameters. So few runs compare "
        "orders of magnitude.",
        "",
        *table(["world", "case", "quantity", *names, "bound"], rows, "llr"),
    ]


def _scaled(outcomes: Sequence[PeerOutcome], quantity: int) -> tuple[np.ndarray, np.ndarray]:
    truth = np.array([o.truth[quantity] for o in outcomes])
    scale = np.ones_like(truth) if QUANTITIES[quantity] in ABSOLUTE else 0.01 * np.abs(truth)
    errors = np.array([o.errors[:, quantity] for o in outcomes]) / scale[:, None]
    return errors, np.array([o.bound[quantity] for o in outcomes]) / scale


def _picture(name: str) -> str:
    return f"estimators/{PICTURES[name]}"


def _figure(a: Accuracy, value: float) -> str:
    if not np.isfinite(value):
        return "lost"
    return f"{value:.3g}" if a.counted else f"({value:.3g})"


def _share(value: float) -> str:
    return f"{value:.0%}" if np.isfinite(value) else ""


def _seconds(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "never"
