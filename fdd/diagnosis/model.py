"""The trained classifier on disk: a folder with a skops file and its manifest.

The manifest names version, features, classes and the SHA-256 of the classifier, which is
checked before the file is parsed; parsing accepts a fixed list of types only, and the loaded
classifier must repeat the golden predictions that were stored at training.
"""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from fdd.diagnosis.sequential import AlarmTail
from fdd.errors import InputError
from fdd.faults import FAMILIES
from fdd.files import whole_file
from fdd.residuals.features import FEATURE_VERSION, FEATURES

if TYPE_CHECKING:
    from sklearn.base import ClassifierMixin

Array = NDArray[np.float64]

MODEL_SCHEMA = "fdd.model/1"
CLASSIFIER, MANIFEST = "classifier.skops", "manifest.json"
MAX_CLASSIFIER_BYTES, MAX_MANIFEST_BYTES = 64_000_000, 4_000_000
# Beyond what skops trusts by itself (NumPy arrays and scikit-learn's estimators): the trees' node arrays.
TRUSTED: tuple[str, ...] = ("sklearn.tree._tree.Tree",)


class Manifest(BaseModel):
    """What a model file says of itself."""

    model_config = ConfigDict(extra="forbid", protected_namespaces=())

    schema_name: str
    fdd_version: str
    sklearn_version: str
    numpy_version: str
    features: list[str]
    feature_version: str
    classes: list[str]
    healthy_share: float
    """Prior share of healthy windows that the classifier was trained with."""
    centre: list[float]
    scale: list[float]
    """Healthy population of the features: mean and standard deviation over units, logs and windows."""
    usual_spread: list[float]
    """Spread of each feature over one unit's own healthy windows that is usual for a unit."""
    tail: dict[str, float]
    """Healthy excursions of the sequential test: fields of `AlarmTail`."""
    temperature: float
    """Exponent 1/T that makes the verdict's family shares calibrated."""
    training_data: str
    training_sha256: str
    classifier_sha256: str
    golden_inputs: list[list[float]]
    golden_outputs: list[list[float]]


def damping(spread: Array, usual: Array) -> Array:
    """Factor on each feature of a unit whose own healthy windows scatter by `spread`.

    A rig with coarse or noisy sensors scatters more than those that the classifier knows. What
    is no news on that unit must not be news to the classifier: beyond the usual spread,
    deviations count in proportion to the unit's own.

    Examples
    --------
    >>> damping(np.array([0.1, 0.4]), np.array([0.2, 0.2])).tolist()
    [1.0, 0.5]
    """
    return np.asarray(usual / np.maximum(usual, spread))


class Model:
    """A classifier of residual windows with everything that its use needs.

    Examples
    --------
    >>> model = Model.load()                      # the shipped one
    >>> model.probabilities(np.zeros((1, len(FEATURES)))).shape[1] == len(model.classes)
    True
    """

    def __init__(self, classifier: ClassifierMixin, manifest: Manifest, name: str) -> None:
        self.classifier = classifier
        self.manifest = manifest
        self.name = name
        self.classes = tuple(manifest.classes)
        self._centre = np.array(manifest.centre)
        self._scale = np.array(manifest.scale)
        self._usual = np.array(manifest.usual_spread)
        self.tail = AlarmTail(**manifest.tail)

    def __repr__(self) -> str:
        return f"Model({self.name!r}, classes={list(self.classes)})"

    def standardise(self, features: Array, spread: Array | None = None) -> Array:
        """Features in healthy standard deviations, (m, k), of the population or of a wider unit.

        Parameters
        ----------
        features : (m, k) relative to the unit's baseline. spread : (k,) the baseline's own scale.
        """
        if spread is not None:
            features = features * damping(spread, self._usual)
        return np.asarray((features - self._centre) / self._scale)

    def probabilities(self, features: Array, spread: Array | None = None) -> Array:
        """Class probabilities of windows, (m, k) features to (m, len(classes)), none quite 0."""
        raw = np.asarray(self.classifier.predict_proba(self.standardise(features, spread)), dtype=np.float64)
        return np.asarray((raw + 1e-3) / (1.0 + 1e-3 * raw.shape[1]))

    def log_ratios(self, probabilities: Array) -> Array:
        """Log-likelihood ratios of fault against healthy, (m, classes) to (m,)."""
        healthy = probabilities[:, self.classes.index("healthy")]
        prior = self.manifest.healthy_share
        return np.asarray(np.log((1.0 - healthy) / healthy) - np.log((1.0 - prior) / prior))

    @classmethod
    def load(cls, folder: str | Path | None = None) -> Model:
        """Read and check a model; None is the shipped one.

        Raises
        ------
        InputError : no model there, another version, other features, a wrong hash, or unknown content.
        """
        if folder is None:
            return _shipped()
        return _load(Path(folder))

    def save(self, folder: str | Path) -> None:
        """Write the model into `folder` (made if need be); the manifest last, so half a model is none."""
        import zipfile

        from skops.io import dumps

        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        content = dumps(self.classifier, compression=zipfile.ZIP_DEFLATED, compresslevel=9)
        self.manifest.classifier_sha256 = hashlib.sha256(content).hexdigest()
        (folder / MANIFEST).unlink(missing_ok=True)
        for name, data in (
            (CLASSIFIER, content),
            (MANIFEST, (self.manifest.model_dump_json(indent=1) + "\n").encode()),
        ):
            with whole_file(folder / name) as temporary:
                temporary.write_bytes(data)


@lru_cache(maxsize=1)
def _shipped() -> Model:
    with resources.as_file(resources.files("fdd") / "diagnosis" / "model") as folder:
        return _load(folder, name="shipped")


def _load(folder: Path, name: str | None = None) -> Model:
    mend = "make one with: fdd train DATASET -o MODEL"
    if not (folder / MANIFEST).is_file() or not (folder / CLASSIFIER).is_file():
        raise InputError(f"no model here ({MANIFEST} and {CLASSIFIER} are wanted)", where=folder, mend=mend)
    for file, most in ((folder / MANIFEST, MAX_MANIFEST_BYTES), (folder / CLASSIFIER, MAX_CLASSIFIER_BYTES)):
        if file.stat().st_size > most:
            raise InputError(f"larger than {most} bytes, not a model of fdd", where=file)
    try:
        data: Any = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        schema = data.get("schema_name") if isinstance(data, dict) else None
        if schema != MODEL_SCHEMA:
            raise InputError(
                f"model of version {schema!r} where {MODEL_SCHEMA!r} is wanted", where=folder, mend=mend
            )
        manifest = Manifest.model_validate(data)
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise InputError("manifest is not JSON", where=folder / MANIFEST, mend=mend) from None
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(p) for p in first["loc"])
        raise InputError(f"manifest field {field}: {first['msg']}", where=folder, mend=mend) from None
    if manifest.feature_version != FEATURE_VERSION or tuple(manifest.features) != FEATURES:
        raise InputError(
            f"model for features of version {manifest.feature_version}, this is version {FEATURE_VERSION}",
            where=folder, mend=mend,
        )  # fmt: skip
    if not set(manifest.classes) <= set(FAMILIES) or "healthy" not in manifest.classes:
        raise InputError("its classes are not the catalogue's families", where=folder, mend=mend)
    content = (folder / CLASSIFIER).read_bytes()
    if hashlib.sha256(content).hexdigest() != manifest.classifier_sha256:
        raise InputError(
            "the classifier's SHA-256 is not the manifest's", where=folder / CLASSIFIER,
            mend="the file was changed or damaged: copy it again or train anew",
        )  # fmt: skip
    return Model(_parse(content, folder, manifest, mend), manifest, name or str(folder))


def _parse(content: bytes, folder: Path, manifest: Manifest, mend: str) -> ClassifierMixin:
    from skops.io import get_untrusted_types, loads

    try:
        unknown = set(get_untrusted_types(data=content)) - set(TRUSTED)
        if unknown:
            raise InputError(
                f"the classifier holds types that fdd does not load: {', '.join(sorted(unknown)[:3])}",
                where=folder,
            )
        classifier = loads(content, trusted=list(TRUSTED))
        golden = classifier.predict_proba(np.array(manifest.golden_inputs))
    except InputError:
        raise
    except Exception as error:  # a damaged file may fail anywhere inside skops
        raise InputError(
            f"the classifier can't be read ({type(error).__name__})", where=folder, mend=mend
        ) from None
    if golden.shape != np.shape(manifest.golden_outputs) or not np.allclose(
        golden, manifest.golden_outputs, atol=1e-6
    ):
        raise InputError(
            "the classifier doesn't repeat its golden predictions", where=folder,
            mend=f"it was trained with scikit-learn {manifest.sklearn_version}; install that or train anew",
        )  # fmt: skip
    return classifier
