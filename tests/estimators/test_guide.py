"""The guide of the estimators (estimators/README.md): its code runs, and says what the guide says."""

import re
from pathlib import Path

import numpy as np
import pytest

import estimators
from estimators import SVSF, ExtendedKalmanFilter

GUIDE = Path(estimators.__file__).with_name("README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE, flags=re.DOTALL)


def test_the_guides_code_runs_and_does_what_the_guide_says() -> None:
    assert len([line for line in BLOCKS[0].split("def run")[1].splitlines() if line.strip()]) <= 20
    shown: dict = {}
    exec(compile(BLOCKS[0], "README.md", "exec"), shown)
    kalman, robust = shown["kalman"], shown["robust"]
    np.testing.assert_array_equal(robust[:1000, :2], kalman[:1000, :2])
    assert np.flatnonzero(robust[:, 4])[0] == 1001
    assert robust[1001:, 4].all()
    assert kalman[1000:, 0].max() == pytest.approx(0.069, abs=0.001)
    assert robust[1000:, 0].max() == pytest.approx(0.012, abs=0.001)
    narrow = shown["run"]([0.005, 0.025])
    rms = [np.sqrt(np.mean(part**2)) for part in (narrow[1000:, 0], narrow[500:1000, 0], robust[1000:, 0])]
    np.testing.assert_allclose(rms, [0.5e-3, 0.5e-3, 11e-3], atol=0.5e-3, rtol=0.1)

    exec(compile(BLOCKS[1], "README.md", "exec"), shown)
    assert shown["ekf"].robust_weights[0] == pytest.approx(0.06, abs=0.005)
    assert shown["ekf"].nis == pytest.approx(2475, abs=1)

    exec(compile(BLOCKS[2].replace("@njit\n", ""), "README.md", "exec"), shown)
    F, H, rng = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.random.default_rng(0)
    z = np.where(rng.random((50, 1)) < 0.2, np.nan, rng.normal(size=(50, 1)))
    out = shown["filtered"](z, F, H, 1e-3 * np.eye(2), np.eye(1), np.zeros(2), np.eye(2))
    kf = ExtendedKalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.x = F, H, 1e-3, np.zeros(2)
    for measured, x in zip(z, out, strict=True):
        kf.predict()
        kf.update(measured)
        np.testing.assert_allclose(x, kf.x, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("made", ["ExtendedKalmanFilter(", "SVSF(psi=0.05, "])
def test_filterpys_bank_of_our_filters_does_what_the_guide_says(made: str) -> None:
    shown: dict = {"SVSF": SVSF}
    exec(compile(BLOCKS[3].replace("ExtendedKalmanFilter(", made), "README.md", "exec"), shown)
    cracked = np.array(shown["mu"])[:, 1] > 0.99
    assert np.flatnonzero(cracked)[0] == 1008
    assert cracked[1008:].all()
    np.testing.assert_allclose(shown["bank"].x[:, 0], np.ravel(shown["filters"][1].x), rtol=0.01)


def pushed(make, channels: int, dt: float) -> tuple[np.ndarray, SVSF | ExtendedKalmanFilter]:
    """Rms errors in mm and mm/s, healthy and pushed, of the guide's mass on a spring (seeded)."""

    def spring(x, u, dt):
        speed = x[1] + dt * (u - 40.0 * x[0] - 3.0 * x[1]) / 2.0
        return [x[0] + dt * speed, speed]

    kf = make(f=spring, h=lambda x: x[:channels])
    kf.x, kf.P, kf.Q = np.zeros(2), [1e-4, 1e-2], [1e-12, 1e-5 * dt]
    kf.R = [1e-6, 25e-6][:channels]
    rng, truth, errors, steps = np.random.default_rng(0), np.zeros(2), [], round(2.0 / dt)
    for i in range(steps):
        u = 10.0 * np.sin(10.0 * i * dt)
        truth = np.array(spring(truth, u + (30.0 if i >= steps // 2 else 0.0), dt))
        z = truth + [1e-3, 5e-3] * rng.normal(size=2)
        kf.predict(u, dt)
        kf.update(z[:channels])
        errors.append(1e3 * (kf.x - truth))
    parts = errors[steps // 4 : steps // 2], errors[steps // 2 :]
    return np.concatenate([np.sqrt(np.mean(np.square(part), axis=0)) for part in parts]), kf


@pytest.mark.parametrize(
    ("channels", "rate", "kalman", "expected"),
    [
        (2, 1000, True, (0.07, 0.6, 51, 660)),
        (2, 1000, False, (0.54, 2.5, 0.5, 7)),
        (1, 100, True, (0.12, 0.4, 368, 2000)),
        (1, 100, False, (0.57, 0.9, 1.0, 14000)),
        (1, 1000, True, (0.12, 0.6, 135, 1645)),
        (1, 1000, False, (0.54, 0.3, 1.1, 18400)),
    ],
)
def test_the_guides_table(channels: int, rate: int, kalman: bool, expected: tuple) -> None:
    def make(**model):
        if kalman:
            return ExtendedKalmanFilter(2, channels, **model)
        return SVSF(2, channels, psi=[0.005, 0.025][:channels], **model)

    np.testing.assert_allclose(pushed(make, channels, 1.0 / rate)[0], expected, rtol=0.08, atol=0.05)
