"""Track leakage and bulk modulus on a rig's logs and compare them with the rig's own truth.

    python examples/rig_estimates.py LOGS --rig rig1 --map examples/rig1.map.yaml --base axis_b
    python examples/rig_estimates.py LOGS --rig rig7 --base examples/rig7.base.yaml

LOGS holds ``labels.json``, ``trajectories.parquet`` (log, time, leakage, bulk_modulus_1, bulk_modulus_2, and
leakage_excited, bulk_modulus_excited where a log excites them) and a folder per rig. The profile is
identified from the healthy baseline alone. Errors are medians of absolute relative errors at the excited
instants; "scale" is their signed median in the baseline: only volume over bulk modulus shows in flow and
pressure, so a chamber's volume that differs from the base profile's scales bulk modulus by a constant.
Beside them stands the least-squares fit of the volume balance over eight seconds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from volume_balance import Window, fit_balance

from estimators.eha import layout
from estimators.eha import model as eha
from fdd.identification.identify import identify_unit
from fdd.logs import ChannelMap, read_log
from fdd.residuals.tracking import METHODS, Tracking, channels_of, estimates, observability
from fdd.samples import Samples
from fdd.unit import Unit

Array = np.ndarray[Any, np.dtype[np.float64]]
WINDOW_S = 8.0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("--rig", required=True)
    parser.add_argument("--map", type=Path)
    parser.add_argument("--base", default="axis_a")
    options = parser.parse_args()
    labels = json.loads((options.logs / "labels.json").read_text(encoding="utf-8"))
    mine = {name: label for name, label in labels.items() if name.startswith(f"{options.rig}/")}
    truth = pd.read_parquet(options.logs / "trajectories.parquet")
    channel_map = None if options.map is None else ChannelMap.load(options.map)
    logs = {name: read_log(options.logs / name, channel_map).samples for name in mine}
    healthy = [logs[name] for name, label in mine.items() if label["baseline"]]
    unit = identify_unit(healthy, Unit.load(options.base), options.rig).unit
    rows = pd.concat([compared(name, logs[name], unit, truth[truth.log == name]) for name in mine])
    rows["baseline"] = rows.log.map({name: label["baseline"] for name, label in mine.items()})
    print("| log | load, faults | leakage: EKF | SVSF | fit | bulk modulus: EKF | SVSF | fit |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, label in mine.items():
        told = ", ".join(f"{f['fault']} {f['severity']:.2f}" for f in label["faults"]) or "healthy"
        print(f"| {name} | {label['load']}, {told} | {cells(rows[rows.log == name])} |")
    print(f"| all excited instants | | {cells(rows)} |")
    print(f"| where also flagged observable | | {cells(rows, flagged=True)} |")
    scale = rows[rows.baseline & (rows.method == "ekf")].bulk_modulus.explode().astype(float).median()
    for_scale = rows.assign(bulk_modulus=[(1.0 + b) / (1.0 + scale) - 1.0 for b in rows.bulk_modulus])
    print(f"| scale {scale:+.3f} of bulk modulus taken out | | {cells(for_scale)} |")


def compared(name: str, samples: Samples, unit: Unit, truth: pd.DataFrame) -> pd.DataFrame:
    """Relative errors at the truth's instants, a row per method and instant."""
    out = []
    at = truth.time.to_numpy()
    for method in METHODS:
        tracking = Tracking(unit, channels_of(samples), period_of(samples))
        records = tracking.trackers[method].push(tracking.block(samples))
        values, stds = estimates(records, unit, tracking.model)
        visible = observability(values, stds)
        k = np.clip(np.searchsorted(records["time"], at) - 1, 0, None)
        moduli = records["bulk_modulus"][k]
        out.append(
            errors(name, method, truth, values["leakage"][k], moduli)
            | {"leakage_seen": visible["leakage"][k], "bulk_seen": visible["bulk_modulus"][k]}
        )
    leakage, moduli = fitted(samples, unit, at)
    seen = np.isfinite(leakage)
    out.append(
        errors(name, "least squares", truth, leakage, moduli) | {"leakage_seen": seen, "bulk_seen": seen}
    )
    return pd.concat([pd.DataFrame({k: list(v) for k, v in part.items()}) for part in out])


def period_of(samples: Samples) -> float:
    """s between samples."""
    return float(np.median(np.diff(samples.time)))


def errors(name: str, method: str, truth: pd.DataFrame, leakage: Array, moduli: Array) -> dict[str, Any]:
    """Columns of one method."""
    n = len(truth)
    true_moduli = truth[["bulk_modulus_1", "bulk_modulus_2"]].to_numpy()
    return {
        "log": [name] * n,
        "method": [method] * n,
        "leakage": leakage / truth.leakage.to_numpy() - 1.0,
        "leakage_excited": truth.leakage_excited.to_numpy(),
        "bulk_modulus": moduli / true_moduli - 1.0,
        "bulk_excited": truth.bulk_modulus_excited.to_numpy(),
    }


def fitted(samples: Samples, unit: Unit, at: Array) -> tuple[Array, Array]:
    """Leakage and both chambers' moduli by least squares over the last eight seconds before each instant."""
    period = period_of(samples)
    tracking = Tracking(unit, channels_of(samples), period)
    block, q = tracking.block(samples), tracking.model
    time = block[:, layout.TIME]
    angle = block[:, layout.ANGLE]
    if not np.isfinite(angle).any():  # counts of the encoder over each sample: they add up without error
        steps = np.rint(np.diff(time, prepend=time[0] - period) / period)
        angle = np.cumsum(np.nan_to_num(block[:, layout.SPEED]) * steps * period)
    leakage, moduli = np.full(at.size, np.nan), np.full((at.size, 2), np.nan)
    for i, end in enumerate(at):
        rows = (time > end - WINDOW_S) & (time <= end) & np.isfinite(block[:, layout.PRESSURE_1])
        rows &= np.isfinite(block[:, layout.PRESSURE_2]) & np.isfinite(block[:, layout.POSITION])
        if rows.sum() < 2000:
            continue
        cut = block[rows]
        window = Window(
            cut[:, layout.POSITION] * 1e3, angle[rows], cut[:, layout.PRESSURE_1] * 1e-6,
            cut[:, layout.PRESSURE_2] * 1e-6, cut[:, layout.ACCUMULATOR] * 1e-6,
        )  # fmt: skip
        scale, air = fit_balance(window, q)
        viscosity = (
            np.nanmean(cut[:, layout.VISCOSITY]) if np.isfinite(cut[:, layout.VISCOSITY]).any() else 1.0
        )
        leakage[i] = scale * unit.pump.total_leakage / viscosity
        for c, column in enumerate((layout.PRESSURE_1, layout.PRESSURE_2)):
            pressure = float(np.mean(cut[-50:, column])) * 1e-6
            if np.isfinite(air):
                moduli[i, c] = 1e6 / eha.compliance(pressure, float(air), q)[0]
    return leakage, moduli


def cells(rows: pd.DataFrame, *, flagged: bool = False) -> str:
    """Median absolute errors of each method, leakage first."""
    out = []
    for name, excited, seen in (
        ("leakage", "leakage_excited", "leakage_seen"),
        ("bulk_modulus", "bulk_excited", "bulk_seen"),
    ):
        for method in (*METHODS, "least squares"):
            chosen = rows[(rows.method == method) & rows[excited]]
            if flagged:
                chosen = chosen[chosen[seen]]
            values = np.abs(np.concatenate([np.atleast_1d(v) for v in chosen[name]] or [np.empty(0)]))
            values = values[np.isfinite(values)]
            out.append(f"{100 * np.median(values):.1f} %" if values.size else "–")
    return " | ".join(out)


if __name__ == "__main__":
    main()
