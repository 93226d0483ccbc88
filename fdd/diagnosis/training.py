"""Train the classifier of residual windows, its sequential test and its calibration.

What is shown of the model comes from units that it was not trained on (cross-validation over
units). "Unknown" is a class of its own: healthy windows with a few features thrown far out, so
that what resembles no known fault does not fall to the nearest one (outlier exposure,
Hendrycks et al. 2019).
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from fdd import __version__
from fdd.diagnosis.model import MODEL_SCHEMA, Manifest, Model, damping
from fdd.diagnosis.sequential import AlarmTail, PageTest, excursion_peaks
from fdd.diagnosis.verdict import family_probabilities
from fdd.errors import InputError
from fdd.residuals.features import FEATURE_VERSION, FEATURES, HOP, RESIDUALS, WINDOW_FEATURES

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesClassifier

Array = NDArray[np.float64]

TREES, LEAF, LEAVES = 60, 8, 400
FOLDS = 5
UNKNOWN_SHARE = 0.12
GOLDEN = 16
FALSE_ALARMS_PER_HOUR = 1.0


@dataclass
class LabelledLog:
    """Windows of one log with what is true of each.

    Attributes
    ----------
    unit : its unit's name; folds are cut between units. family : of the log, ``healthy`` if none.
    times, features : (m,), (m, k). labels : (m,) family per window, ``""`` where it is in between.
    onset : s, NaN for healthy logs. spread : (k,) the unit's own healthy scale of each feature.
    """

    unit: str
    family: str
    times: Array
    features: Array
    labels: NDArray[np.str_]
    onset: float = np.nan
    spread: Array = field(default_factory=lambda: np.zeros(len(FEATURES)))
    probabilities: Array = field(default_factory=lambda: np.empty((0, 0)))


def train_model(logs: list[LabelledLog], *, data: str, data_sha256: str, seed: int = 0) -> Model:
    """Train on labelled logs; fills each log's out-of-fold `probabilities`.

    Raises
    ------
    InputError : too few units, or a class without windows.
    """
    import sklearn

    rng = np.random.default_rng(seed)
    units = sorted({log.unit for log in logs})
    if len(units) < FOLDS:
        raise InputError(f"{len(units)} units where training needs {FOLDS} or more")
    classes = sorted({str(c) for log in logs for c in np.unique(log.labels) if c} | {"unknown"})
    if "healthy" not in classes or len(classes) < 3:
        raise InputError("training data without healthy windows or without faults")
    usual = np.maximum(np.percentile([log.spread for log in logs], 75, axis=0), 1e-3)
    damped = {id(log): log.features * damping(log.spread, usual) for log in logs}
    healthy = np.concatenate([damped[id(log)][log.labels == "healthy"] for log in logs])
    centre = np.median(healthy, axis=0)
    # Of the bulk and of the tails, whichever is wider: faults must leave both behind.
    scale = np.maximum(
        np.diff(np.percentile(healthy, [15.87, 84.13], axis=0), axis=0)[0] / 2.0,
        np.diff(np.percentile(healthy, [2.275, 97.725], axis=0), axis=0)[0] / 4.0,
    )
    scale = np.maximum(scale, 1e-3)
    order = rng.permutation(len(units))
    fold_of = {units[u]: i % FOLDS for i, u in enumerate(order)}

    def rows(chosen: list[LabelledLog]) -> tuple[Array, NDArray[np.str_], Array]:
        # Windows overlap by three quarters: every second one says as much.
        x = [(damped[id(log)][log.labels != ""][::2] - centre) / scale for log in chosen]
        y = [log.labels[log.labels != ""][::2] for log in chosen]
        # Each log counts alike, however long: windows of one log repeat each other.
        w = [np.full(len(v), 1.0 / max(len(v), 1)) for v in y]
        extra = _unknown_windows(np.concatenate(x), np.concatenate(y), rng)
        weight = np.concatenate(w)
        return (
            np.concatenate([*x, extra]),
            np.concatenate([*y, np.full(len(extra), "unknown")]),
            np.concatenate([weight, np.full(len(extra), UNKNOWN_SHARE * weight.sum() / max(len(extra), 1))]),
        )

    for fold in range(FOLDS):
        x, y, w = rows([g for g in logs if fold_of[g.unit] != fold])
        classifier = _classifier(seed + fold).fit(x, y, sample_weight=w)
        for log in logs:
            if fold_of[log.unit] == fold and log.features.shape[0]:
                raw = classifier.predict_proba((damped[id(log)] - centre) / scale)
                full = np.zeros((raw.shape[0], len(classes)))
                for i, c in enumerate(classifier.classes_):
                    full[:, classes.index(str(c))] = raw[:, i]
                log.probabilities = (full + 1e-3) / (1.0 + 1e-3 * len(classes))
    x, y, w = rows(logs)
    final = _classifier(seed).fit(x, y, sample_weight=w)
    final.n_jobs = None  # a minute of log is too little work to share out
    golden = x[rng.choice(len(x), GOLDEN, replace=False)]
    manifest = Manifest(
        schema_name=MODEL_SCHEMA, fdd_version=__version__, sklearn_version=sklearn.__version__,
        numpy_version=np.__version__, features=list(FEATURES), feature_version=FEATURE_VERSION,
        classes=[str(c) for c in final.classes_],
        healthy_share=float(w[y == "healthy"].sum() / w.sum()),
        centre=centre.tolist(), scale=scale.tolist(), usual_spread=usual.tolist(),
        tail={"height": 0.0, "rate": 1.0, "scale": 1.0}, temperature=1.0,
        training_data=data, training_sha256=data_sha256, classifier_sha256="",
        golden_inputs=golden.tolist(), golden_outputs=final.predict_proba(golden).tolist(),
    )  # fmt: skip
    model = Model(final, manifest, "trained")
    model.tail = healthy_tail(logs, model)
    manifest.tail = asdict(model.tail)
    manifest.temperature = calibrated_temperature(logs, model)
    return model


def _classifier(seed: int) -> ExtraTreesClassifier:
    from sklearn.ensemble import ExtraTreesClassifier

    return ExtraTreesClassifier(
        n_estimators=TREES,
        min_samples_leaf=LEAF,
        max_leaf_nodes=LEAVES,
        max_features=0.7,
        random_state=seed,
        n_jobs=-1,
    )


def _unknown_windows(x: Array, y: NDArray[np.str_], rng: np.random.Generator) -> Array:
    """Healthy windows with one to three residuals thrown 4 to 40 healthy deviations out.

    Four in five since the log began, so that the change shows it too; the rest from its start.
    """
    healthy = x[y == "healthy"]
    n = max(len(x) // 12, 200)
    out = healthy[rng.integers(len(healthy), size=n)].copy()
    for row in out:
        chosen = rng.choice(len(RESIDUALS), size=rng.integers(1, 4), replace=False)
        size = rng.choice([-1.0, 1.0], size=chosen.size) * 4.0 * 10.0 ** rng.uniform(0.0, 1.0, chosen.size)
        row[chosen] += size
        if rng.uniform() < 0.8:
            row[len(WINDOW_FEATURES) + chosen] += size
    return out


def healthy_tail(logs: list[LabelledLog], model: Model) -> AlarmTail:
    """Tail of the test's healthy excursions, out of fold."""
    peaks: list[float] = []
    seconds = 0.0
    for log in logs:
        quiet = _before_onset(log)
        seconds += HOP * int(quiet.sum())
        if quiet.any():
            peaks += excursion_peaks(model.log_ratios(log.probabilities[quiet]), HOP)
    return AlarmTail.fit(peaks, seconds)


def _before_onset(log: LabelledLog) -> NDArray[np.bool_]:
    return log.times < (np.inf if np.isnan(log.onset) else log.onset)


def run_test(log: LabelledLog, model: Model) -> PageTest:
    """Page's test over a log's out-of-fold windows at the default false alarm rate."""
    test = PageTest(model.tail.threshold(FALSE_ALARMS_PER_HOUR / 3600.0), HOP)
    for ratio, time in zip(model.log_ratios(log.probabilities), log.times, strict=True):
        test.step(float(ratio), float(time))
    return test


def verdict_of(log: LabelledLog, model: Model, test: PageTest) -> dict[str, float]:
    """All families' probabilities for an alarmed log."""
    since = log.times >= min(test.since, test.alarm_time)
    return family_probabilities(model, log.probabilities[since], test)


def calibrated_temperature(logs: list[LabelledLog], model: Model) -> float:
    """Temperature of the family shares that is likeliest on the alarmed faulty logs, out of fold."""
    cases = [(log, run_test(log, model)) for log in logs if log.family != "healthy" and log.features.shape[0]]
    cases = [(log, test) for log, test in cases if test.alarmed and log.family in model.classes]
    if len(cases) < 10:
        return 1.0

    def loss(log_temperature: float) -> float:
        model.manifest.temperature = float(np.exp(log_temperature))
        return -float(np.mean([np.log(verdict_of(log, model, t)[log.family] + 1e-9) for log, t in cases]))

    best = minimize_scalar(loss, bounds=(np.log(0.2), np.log(5.0)), method="bounded")
    return float(np.exp(best.x))


def data_digest(logs: list[LabelledLog]) -> str:
    """SHA-256 over all windows and labels."""
    digest = hashlib.sha256()
    for log in logs:
        digest.update(log.features.tobytes())
        digest.update("\n".join(log.labels.tolist()).encode())
    return digest.hexdigest()
