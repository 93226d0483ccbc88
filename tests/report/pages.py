"""Made-up diagnoses with all that a report shows, no plant, no filters; a page as a browser would read it."""

import base64
import gzip
import hashlib
import json
from html.parser import HTMLParser
from typing import Any, NamedTuple

import numpy as np

from fdd.diagnosis import findings
from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Invisible, Trajectories
from fdd.faults import FAMILIES
from fdd.samples import Samples
from fdd.unit import Unit

EVIL = """<script>alert('x')</script><img src=x onerror=alert(1)>" onload="y' & </title></style>{{ 7*7 }}"""
FEATURES = ["volume", "force", "torque", "shaft", "coherence", "refeed", "reservoir"]
BASELINES = {"leakage": 6.52e-12, "bulk_modulus": 2.1e8, "coulomb_friction": 132.0, "viscous_friction": 61.0}
SI_UNITS = dict(zip(BASELINES, ("m^3/(s*Pa)", "Pa", "N", "N*s/m"), strict=True))


class Case(NamedTuple):
    """All arguments of a report but its path."""

    diagnosis: Diagnosis
    trajectories: Trajectories
    samples: Samples
    unit: Unit
    settings: dict[str, str]


def log_samples(rows: int, rng: np.random.Generator) -> Samples:
    """A to-and-fro motion with a hole in time, missing values, and one spike of pressure."""
    time = np.arange(rows) * 1e-3
    setpoint = 0.02 * np.sign(np.sin(2 * np.pi * time / 8.0)) + 0.005 * np.sin(2 * np.pi * 0.5 * time)
    lag = np.exp(-np.arange(2000) * 1e-3 / 0.3)
    position = np.convolve(setpoint, lag / lag.sum())[:rows]
    speed = np.gradient(position, time) * 1.5e-3 / 5.57e-7
    difference = 4e5 * np.tanh(speed / 40.0) + rng.normal(0.0, 7e3, rows)
    current = speed * 0.01 + rng.normal(0.0, 0.02, rows)
    current[rows // 3 : rows // 3 + rows // 30] = np.nan
    difference[rows // 4] = 2.5e6
    keep = np.ones(rows, dtype=bool)
    keep[rows * 5 // 8 : rows * 5 // 8 + rows // 40] = False
    columns = {
        "position": position + rng.normal(0.0, 1e-6, rows),
        "position_setpoint": setpoint,
        "pressure_difference": difference,
        "pressure_1": 9e5 + difference / 2,
        "pressure_2": 9e5 - difference / 2,
        "pressure_accumulator": 4.8e5 + rng.normal(0.0, 1e3, rows),
        "pump_speed": speed + rng.normal(0.0, 0.1, rows),
        "command": np.clip(1.02 * speed, -300.0, 300.0),
        "motor_current": current,
        "oil_temperature": 38.0 + 4.0 * (1.0 - np.exp(-time / 30.0)),
    }
    return Samples(time[keep], {k: v[keep] for k, v in columns.items()})


def case(verdict: str = "faulty", rows: int = 60_000, seed: int = 1, log: str = "run.mcap") -> Case:
    """A case with the verdict wanted; the faulty one has internal leakage from a third of the log on."""
    rng = np.random.default_rng(seed)
    samples = log_samples(rows, rng)
    duration = rows * 1e-3
    onset = 0.338 * duration
    faulty = verdict == "faulty"
    trajectories = _trajectories(samples, duration, onset, verdict, rng)
    last = {name: float(v[-1]) for name, v in trajectories.probabilities.items()}
    ekf, stds = trajectories.estimates["ekf"], trajectories.stds["ekf"]
    estimates = {
        name: Estimate(
            unit=SI_UNITS[name], baseline=BASELINES[name], value=float(ekf[name][-1]),
            std=float(stds[name][-1]), observable=bool(trajectories.observable[name].any()),
        )
        for name in BASELINES
    }  # fmt: skip
    finding = FaultFinding(
        fault="internal_leakage", family="leakage", ambiguity=["internal_leakage", "pump_wear"],
        confidence=0.97, onset_s=onset, detected_s=onset + 0.6, severity=0.41,
        evidence=["The leakage coefficient rose from 6.5 to 11.4 × 10⁻¹² m³/(s·Pa), 49 times its spread."],
        severity_interval=(0.35, 0.47), next_check="Block the rod and read the pump's speed.",
    )  # fmt: skip
    quality = findings.Quality(
        dropped_samples=rows - len(samples), nan_samples=int(np.isnan(samples["motor_current"]).sum()),
        notes=["Motor current is missing from 20.0 to 22.0 s."] if faulty else [],
    )  # fmt: skip
    sensors = [("position", "trusted", None), ("motor_current", "missing", 20.0)]
    diagnosis = Diagnosis(
        log=log, axis="axis_a", unit="axis_a", duration_s=duration, samples=len(samples), verdict=verdict,
        faults=[finding] if faulty else [], probabilities=last, estimates=estimates, quality=quality,
        sensors=[findings.SensorState(channel=c, state=s, since=t) for c, s, t in sensors],
        not_visible=[Invisible(fault="internal_leakage", severity=0.07),
                     Invisible(fault="coupling_wear", severity=None)],
    )  # fmt: skip
    settings = {"model": "shipped", "false alarms per hour": "0.1", "block": "10000 samples"}
    return Case(diagnosis, trajectories, samples, Unit.load("axis_a"), settings)


def _trajectories(
    samples: Samples, duration: float, onset: float, verdict: str, rng: np.random.Generator
) -> Trajectories:
    time = samples.time[::5].copy()
    rise = (time > onset) * (1.0 - np.exp(-np.maximum(time - onset, 0.0) / 0.8)) * (verdict == "faulty")
    truth = {name: np.full(time.size, value) for name, value in BASELINES.items()}
    truth["leakage"] += 4.9e-12 * rise
    estimates: dict[str, dict[str, np.ndarray]] = {"ekf": {}, "svsf": {}}
    stds: dict[str, dict[str, np.ndarray]] = {"ekf": {}, "svsf": {}}
    for key, noise in (("ekf", 0.015), ("svsf", 0.025)):
        for name, values in truth.items():
            std = BASELINES[name] * (noise + 0.4 * np.exp(-time / 1.0))
            wander = np.convolve(rng.normal(size=time.size), np.ones(200) / np.sqrt(200), mode="same")
            estimates[key][name] = values + 0.7 * std * wander
            stds[key][name] = std
    moving = np.sin(2 * np.pi * time / 8.0 + 0.6) > -0.4
    seen = np.ones(time.size, dtype=bool)
    observable = dict(zip(BASELINES, (seen, moving, moving, ~seen), strict=True))
    window_time = np.arange(0.5, duration, 0.25)
    after = (window_time > onset) & (verdict == "faulty")
    features = np.sqrt(rng.chisquare(4, size=(window_time.size, len(FEATURES))) / 4.0)
    features[after, 0] += 24.0
    features[after, 6] += 5.0
    walk = np.where(after, 2.2, -0.6) + rng.normal(0.0, 0.8, window_time.size)
    total = np.cumsum(walk)
    statistic = total - np.minimum.accumulate(np.minimum(total, 0.0))  # CUSUM
    sure = 0.97 / (1.0 + np.exp(-(window_time - onset - 0.5) / 0.3)) if verdict == "faulty" else 0.01
    table = {name: np.full(window_time.size, 0.002) for name in FAMILIES}
    table["leakage"] = np.clip(np.full(window_time.size, 0.0) + sure, 0.005, 0.97)
    if verdict == "inconclusive":
        table["leakage"] = np.full(window_time.size, 0.40)
        table["friction"] = np.full(window_time.size, 0.25)
    table["healthy"] = 1.0 - sum(p for name, p in table.items() if name != "healthy")
    return Trajectories(
        time=time, estimates=estimates, stds=stds, observable=observable, window_time=window_time,
        nis={key: rng.chisquare(3, time.size) for key in estimates}, feature_names=list(FEATURES),
        features=features, statistic=statistic, threshold=12.0, probabilities=table,
    )  # fmt: skip


class Page(HTMLParser):
    """Tags, attributes, scripts and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag if tag in ("script", "style") else ""
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text += data

    def attributes(self, *names: str) -> list[str]:
        return [v or "" for _, attrs in self.tags for k, v in attrs.items() if k in names]

    @property
    def figures(self) -> dict[str, Any]:
        return {f["id"]: f for f in json.loads(unpacked(self.scripts[0]))}

    def script_policy(self) -> str:
        """The scripts that the page's policy lets run."""
        policy = next(c for c in self.attributes("content") if "default-src" in c)
        assert "default-src 'none'" in policy
        return policy.split("script-src ")[1].split(";")[0]


def unpacked(text: str) -> bytes:
    return gzip.decompress(base64.b64decode(text))


def hash_source(script: bytes) -> str:
    """How a policy names a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode()}'"


def decoded(array: dict[str, str]) -> np.ndarray:
    """The numbers of a trace."""
    values = np.frombuffer(base64.b64decode(array["bdata"]), dtype="<" + array["dtype"]).astype(float)
    return values.reshape([int(n) for n in array["shape"].split(",")]) if "shape" in array else values
