"""The figures of a report, in the units that engineers read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED, Diagnosis, FaultFinding, Trajectories
from fdd.report import traces as tr
from fdd.report.words import family_title
from fdd.residuals.balances import BALANCES
from fdd.samples import Samples

ESTIMATOR_TITLES = {"ekf": "EKF", "svsf": "SVSF"}
FAMILY_COLOURS = {
    "healthy": "#B9C6CF", "leakage": tr.BLUE, "seal_wear": tr.VERMILLION, "aeration": tr.SKY,
    "check_valve": tr.PURPLE, "relief_valve": tr.YELLOW, "friction": tr.ORANGE, "motor": tr.GREEN,
    "sensor": "#6A4C93", "unknown": "#6B6F76",
}  # fmt: skip
MISFIT = "healthy: about 1"
ALIKE_STD = 0.2
"""Standard deviations within which two trackers say the same: one line then."""
TO_RPM = 60.0 / (2.0 * np.pi)

# title, unit, what is drawn: (channel, name), factor from SI
MEASURED: tuple[tuple[str, str, tuple[tuple[str, str], ...], float], ...] = (
    ("Position", "mm", (("position", "measured"), ("position_setpoint", "set-point")), 1e3),
    ("Pressures", "bar", (
        ("pressure_difference", "difference P₁ − P₂"), ("pressure_1", "chamber 1"),
        ("pressure_2", "chamber 2"), ("pressure_accumulator", "accumulator"),
    ), 1e-5),
    ("Pump speed", "rpm", (("pump_speed", "measured"), ("command", "command")), TO_RPM),
    ("Motor current", "A", (("motor_current", "motor current"),), 1.0),
    ("Oil temperature", "°C", (("oil_temperature", "oil temperature"),), 1.0),
    ("Load force", "kN", (("load_force", "load force"),), 1e-3),
)  # fmt: skip
LABEL_SHARE = 0.2
"""Of a plot's width, that the name of a vertical line takes on a phone."""


@dataclass
class Figure:
    """One plot: where it goes, what it is called, and what plotly draws."""

    id: str
    title: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    unit: str = ""
    note: str = ""
    height: int = 280
    wide: bool = False


@dataclass
class Section:
    """Figures under one heading."""

    title: str
    note: str
    figures: list[Figure] = field(default_factory=list)


def sections(diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples) -> list[Section]:
    """All figures of a report, in reading order; without those that have nothing to show."""
    packages = [name.upper() for name in trajectories.estimates if name not in ESTIMATOR_TITLES]
    others = f", and by {', '.join(packages)} of an installed package" if packages else ""
    found = [
        Section(
            "When and what",
            "How sure the diagnosis was of each family of faults as the log went on, and the test that "
            "raises the alarm.",
            [*_probabilities(trajectories), *_statistic(trajectories)],
        ),
        Section(
            "Estimated quantities",
            f"Tracked by two filters on one model{others}, each with its ±2σ band, as one "
            "line where they say the same. Grey: the motion at that time does not show the quantity, and the "
            "value is only carried along.",
            [f for name in ESTIMATED for f in _estimate(name, diagnosis, trajectories)],
        ),
        Section(
            "Balances",
            "How badly each balance of the actuator closes, half a second at a time, against what a healthy "
            "unit's does (root of the reduced chi-square): about 1 while healthy. Findings add up many half "
            "seconds, so a small fault is found while this hardly leaves 1.",
            _features(trajectories),
        ),
        Section("Measured signals", "", _measured(samples)),
    ]
    # One x axis for all plots: from the first to the last time of the report.
    times = [t for t in (samples.time, trajectories.time, trajectories.window_time) if t.size]
    start = min((float(t[0]) for t in times), default=0.0)
    stop = max((float(t[-1]) for t in times), default=1.0)
    reach = start, stop if stop > start else start + 1.0
    for section in found:
        for figure in section.figures:
            _mark_faults(figure.layout, diagnosis.faults, reach)
    return [s for s in found if s.figures]


def _mark_faults(layout: dict[str, Any], faults: list[FaultFinding], reach: tuple[float, float]) -> None:
    """Onset and detection as lines, named above the plot; a bar there is the onset's 80 % interval."""
    start, stop = reach
    layout["xaxis"]["range"] = [round(start, 4), round(stop, 4)]
    taken: list[tuple[int, float]] = []
    for number, fault in enumerate(faults, start=1):
        suffix = f" {number}" if len(faults) > 1 else ""
        if fault.onset_interval is not None:
            early, late = np.clip(fault.onset_interval, start, stop).tolist()
            layout["shapes"].append(tr.bar_at_top(early, late))
        marks = (("onset", fault.onset_s, "dash"), ("detected", fault.detected_s, "solid"))
        for word, at, dash in marks:
            if not start <= at <= stop:
                continue
            layout["shapes"].append(tr.upright(at, dash=dash))
            share = (at - start) / (stop - start)
            # A label that would leave the plot goes to the other side; one that would lie on another, higher.
            left = share > LABEL_SHARE if word == "onset" else share > 1.0 - LABEL_SHARE
            begin = share - LABEL_SHARE if left else share
            free = (r for r in range(3) if all(r != o or abs(begin - b) > LABEL_SHARE for o, b in taken))
            row = next(free, 2)
            taken.append((row, begin))
            layout["annotations"].append(
                {**tr.upright_label(at, word + suffix, left=left), "yshift": 12 * row}
            )


def _probabilities(trajectories: Trajectories) -> list[Figure]:
    names = [n for n, p in trajectories.probabilities.items() if p.size]
    names.sort(key=lambda n: n != "healthy")
    if not names or not trajectories.window_time.size:
        return []
    table = np.column_stack([np.nan_to_num(trajectories.probabilities[n]) for n in names])
    time = tr.bucket_means(trajectories.window_time)
    shares = 100.0 * tr.bucket_means(table)
    data = [
        tr.scatter(
            tr.packed(time), tr.packed(share), family_title(name), hovertemplate="%{y:.0f} %",
            line={"width": 2, "color": FAMILY_COLOURS.get(name, tr.GREY), "shape": "hv"},
        )
        for name, share in zip(names, shares.T, strict=True)
        if name == "healthy" or share.max() >= 2.0
    ]  # fmt: skip
    layout = {**tr.layout(range=[0, 100]), "showlegend": True}
    return [
        Figure("probabilities", "Probability that each fault family is there", data, layout, "%", wide=True)
    ]


def _statistic(trajectories: Trajectories) -> list[Figure]:
    time, statistic, threshold = trajectories.window_time, trajectories.statistic, trajectories.threshold
    if not statistic.size or not np.isfinite(statistic).any():
        return []
    layout, unit = tr.layout(), ""
    highest = float(np.nanmax(statistic))
    if threshold > 0.0 and highest > 10.0 * threshold:
        # A gross fault drives the statistic far up; a logarithmic axis keeps the threshold readable.
        statistic = np.maximum(statistic, threshold / 20.0)
        unit = "logarithmic scale"
        layout["yaxis"] |= {"type": "log", "dtick": 1}
    elif threshold > 0.0:
        layout["yaxis"]["rangemode"] = "tozero"
    data = [tr.line(time, statistic, "test statistic", tr.BLUE)]
    for level, what, colour in (
        (threshold, "alarm while it runs", tr.VERMILLION),
        (trajectories.even, "this log, faulty", tr.ORANGE),
    ):
        if np.isfinite(level):
            data.append(tr.level(time, level, f"{what}: {level:.3g}", colour=colour))
    return [Figure("statistic", "Sequential test", data, layout, unit, height=230, wide=True)]


def _estimate(name: str, diagnosis: Diagnosis, trajectories: Trajectories) -> list[Figure]:
    _, unit, title = ESTIMATED[name]
    scale = DISPLAY_SCALE[name]
    time = trajectories.time
    drawn = {k: e[name] * scale for k, e in trajectories.estimates.items() if name in e and e[name].size}
    drawn = {k: v for k, v in drawn.items() if np.isfinite(v).any()}
    if not drawn or not time.size:
        return []
    seen = trajectories.observable[name]
    data: list[dict[str, Any]] = []
    lines, bands = [], []
    (first, leading), *others = drawn.items()
    spread = scale * trajectories.stds[first][name]
    apart = {first: seen, **{k: seen & (np.abs(v - leading) > ALIKE_STD * spread) for k, v in others}}
    alike = [k for k, differs in apart.items() if k == first or not differs.any()]
    for number, (key, value) in enumerate(drawn.items()):
        if number and key in alike:
            continue
        colour = tr.LINE_COLOURS[number % len(tr.LINE_COLOURS)]
        called = " and ".join(ESTIMATOR_TITLES.get(k, k.upper()) for k in ([key] if number else alike))
        called += "" if apart[key][seen].all() else " where it differs"
        shown = np.where(apart[key], value, np.nan)
        half = 2.0 * scale * trajectories.stds[key][name]
        low, high = shown - half, shown + half
        data.append(tr.band(time, low, high, called, colour))
        bands += [low, high]
        if not seen.all() and not number:
            grey = tr.line(time, np.where(seen, np.nan, value), called, tr.GREY, width=1.0, legend=False)
            data.append({**grey, "hoverinfo": "skip"})
        if seen.any():
            data.append(tr.line(time, shown, called, colour))
        lines.append(shown if seen.any() else value)
    held = trajectories.held.get(name)
    if held is not None and seen.any() and not seen.all():
        last = np.where(seen, np.nan, scale * held)
        data.append(tr.line(time, last, "last observable value", tr.LINE_COLOURS[0], dash="dot", width=1.0))
    found = diagnosis.estimates.get(name)
    baseline = None if found is None or found.baseline is None else found.baseline * scale
    if baseline is not None:
        data.append(tr.level(time, baseline, "healthy baseline", colour=tr.GREEN))
    layout = tr.layout()
    span = y_range(lines, bands, baseline)
    if span is not None:
        layout["yaxis"]["range"] = span
    layout["shapes"] = [tr.shade(a, b) for a, b in tr.intervals(time, ~seen)]
    note = "" if seen.any() else "Not observable anywhere in this log."
    return [Figure(f"estimate-{name}", title, data, layout, unit, note)]


def y_range(lines: list[tr.Column], bands: list[tr.Column], baseline: float | None) -> list[float] | None:
    """A y range that a filter's wide first seconds do not spoil and that holds a fault which has just begun,
    of estimates (`lines`) and the edges of their `bands`, (n,) each. Zooming out shows the rest."""
    everything = np.concatenate([x[np.isfinite(x)] for x in [*lines, *bands]] or [np.empty(0)])
    if not everything.size:
        return None
    low, high = (float(q) for q in np.percentile(everything, (1.0, 99.0)))
    later = np.concatenate([x[x.size // 10 :] for x in lines])
    if np.isfinite(later).any():
        most = 3.0 * (high - low)
        low = max(min(low, float(np.nanmin(later))), low - most)
        high = min(max(high, float(np.nanmax(later))), high + most)
    if baseline is not None:
        low, high = min(low, baseline), max(high, baseline)
    pad = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    return [float(f"{low - pad:.5g}"), float(f"{high + pad:.5g}")]


def _features(trajectories: Trajectories) -> list[Figure]:
    time, features, names = trajectories.window_time, trajectories.features, trajectories.feature_names
    if features.ndim != 2 or not features.size or not np.isfinite(features).any():
        return []
    magnitude = np.abs(np.where(np.isfinite(features), features, 0.0))
    # The strongest by what they reach for a tenth of the time, not by one spike.
    shown = np.argsort(-np.percentile(magnitude, 90.0, axis=0), kind="stable")[: len(tr.LINE_COLOURS)]
    titles = [BALANCES[n].title if n in BALANCES else n.replace("_", " ") for n in names]
    lines = [
        tr.line(time, features[:, i], titles[i], tr.LINE_COLOURS[rank], buckets=tr.BUCKETS // 2)
        for rank, i in enumerate(shown)
    ]
    limit = [tr.level(time, 1.0, "healthy", colour=tr.GREY, dash="dot")]
    layout = tr.layout()
    return [Figure("features", "Misfit of balances", lines + limit, layout, MISFIT, wide=True, height=320)]


def _measured(samples: Samples) -> list[Figure]:
    figures = []
    for title, unit, channels, factor in MEASURED:
        data = []
        for number, (channel, name) in enumerate(channels):
            if channel not in samples or not np.isfinite(samples[channel]).any():
                continue
            wanted = channel in ("command", "position_setpoint")
            colour = tr.VERMILLION if wanted else tr.LINE_COLOURS[(0, 2, 3, 4)[number]]
            dash, values = "dot" if wanted else "solid", samples[channel] * factor
            data.append(tr.line(samples.time, values, name, colour, dash=dash, width=1.3))
        if data:
            name = f"measured-{title.lower().replace(' ', '-')}"
            figures.append(Figure(name, title, data, tr.layout(), unit))
    if len(figures) % 2:
        figures[-1].wide = True
    return figures
