"""Both filter classes, in each of their configurations, go through the same list of checks."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import estimators
from estimators import SVSF, ExtendedKalmanFilter

STEPS = 120
FILTERPY_NAMES = (
    "dim_x", "dim_z", "dim_u", "x", "P", "Q", "R", "F", "B", "H", "y", "z", "S", "SI", "K", "x_prior",
    "P_prior", "x_post", "P_post", "log_likelihood", "likelihood", "mahalanobis", "predict", "update",
)  # fmt: skip


def swing(x, u, dt):
    """A damped pendulum: angle in rad, its rate in rad/s, torque per inertia u in 1/s²."""
    rate = x[1] + dt * (u - 9.81 * np.sin(x[0]) - 0.5 * x[1])
    return np.array([x[0] + dt * rate, rate])


def swing_jacobian(x, u, dt):
    angle, g = float(np.ravel(x)[0]), 9.81
    return [
        [1.0 - dt * dt * g * np.cos(angle), dt * (1.0 - 0.5 * dt)],
        [-dt * g * np.cos(angle), 1.0 - 0.5 * dt],
    ]


def seen(x):
    return np.array([np.sin(x[0]), x[1]])


def seen_jacobian(x):
    return [[float(np.cos(np.ravel(x)[0])), 0.0], [0.0, 1.0]]


@dataclass(frozen=True)
class Case:
    """An estimator in one of its configurations; ``column`` states are (n, 1), as filterpy's default."""

    make: Callable[[], ExtendedKalmanFilter]
    linear: bool
    column: bool = False

    def fresh(self) -> ExtendedKalmanFilter:
        kf = self.make()
        kf.x = np.array([0.3, 0.0]).reshape((2, 1) if self.column else 2)
        kf.P, kf.Q, kf.R = np.diag([0.1, 0.2]), np.diag([1e-7, 1e-5]), np.diag([1e-4, 4e-4])
        if self.linear:
            kf.H, kf.B = np.eye(2), np.array([[1e-4], [0.01]])
        return kf


def hanging(x, u, dt):
    """The pendulum's Jacobian at rest: a linear model."""
    return swing_jacobian([0.0, 0.0], u, dt)


full = {"f": swing, "h": seen, "F_jacobian": swing_jacobian, "H_jacobian": seen_jacobian}
CASES = {
    "ekf-linear": Case(lambda: ExtendedKalmanFilter(2, 2, 1, F_jacobian=hanging), True),
    "ekf-linear-column": Case(lambda: ExtendedKalmanFilter(2, 2, 1, F_jacobian=hanging), True, column=True),
    "ekf-jacobians": Case(lambda: ExtendedKalmanFilter(2, 2, **full), False),
    "ekf-differences": Case(lambda: ExtendedKalmanFilter(2, 2, f=swing, h=seen), False),
    "ekf-robust": Case(lambda: ExtendedKalmanFilter(2, 2, robust=2.0, **full), False),
    "svsf-fixed": Case(lambda: SVSF(2, 2, psi=[0.03, 0.06], **full), False),
    "svsf-fixed-linear": Case(lambda: SVSF(2, 2, psi=0.05, gamma=0.3, F_jacobian=hanging), True),
    "svsf-variable": Case(lambda: SVSF(2, 2, psi=[0.2, 0.4], boundary_layer="variable", **full), False),
    "svsf-variable-column": Case(
        lambda: SVSF(2, 2, psi=0.3, boundary_layer="variable", F_jacobian=hanging), True, column=True
    ),
}
everyone = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())


def stream(seed: int = 0, gaps: float = 0.2) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """Input, time step and measurement of a swinging pendulum, at an uneven rate and with gaps."""
    rng = np.random.default_rng(seed)
    x = np.array([0.2, 0.1])
    for i in range(STEPS):
        dt, u = rng.uniform(0.005, 0.015), np.array([0.5 * np.sin(0.1 * i)])
        x = swing(x, u[0], dt)
        z = seen(x) + rng.normal(size=2) * [0.01, 0.02]
        yield u, dt, np.where(rng.random(2) < gaps, np.nan, z)


def feed(kf: ExtendedKalmanFilter, u: np.ndarray, dt: float, z: np.ndarray) -> None:
    kf.predict(u if kf.f is None else u[0], dt)
    kf.update(z.reshape((2, 1)) if np.ndim(kf.x) == 2 else z)


def run(kf: ExtendedKalmanFilter, samples: list) -> ExtendedKalmanFilter:
    for sample in samples:
        feed(kf, *sample)
    return kf


def assert_same(one: ExtendedKalmanFilter, other: ExtendedKalmanFilter) -> None:
    for name, value in vars(one).items():
        if not callable(value):
            np.testing.assert_array_equal(getattr(other, name), value, err_msg=name)


@everyone
def test_interface_shapes_and_covariance_at_every_step(case: Case) -> None:
    kf = case.fresh()
    vector = (2, 1) if case.column else (2,)
    for sample in stream(gaps=0.5):
        feed(kf, *sample)
        for name in ("x", "y", "z", "x_prior", "x_post"):
            assert getattr(kf, name).shape == vector, name
        for name in ("P", "F", "H", "S", "SI", "K", "P_prior", "P_post"):
            assert getattr(kf, name).shape == (2, 2), name
        assert 0 <= kf.channels_used <= 2
        for P in (kf.P_prior, kf.P_post):
            np.testing.assert_array_equal(P, P.T)
            assert np.linalg.eigvalsh(P).min() > 0.0
        assert np.isfinite(kf.x).all()
        assert 0.0 < kf.likelihood < np.inf
    assert not [name for name in FILTERPY_NAMES if not hasattr(kf, name)]


@everyone
def test_inputs_stay_and_instances_and_copies_share_nothing(case: Case) -> None:
    kf, other = case.fresh(), case.fresh()
    given = {name: np.asarray(getattr(kf, name)) for name in ("x", "P", "Q", "R", "H")}
    before, samples = copy.deepcopy(given), list(stream(1))
    kept = copy.deepcopy(samples)
    twin = None
    for i, (first, second) in enumerate(zip(samples, stream(2), strict=True)):
        feed(kf, *first)
        feed(other, *second)
        if i == 50:
            twin = copy.deepcopy(kf)
    assert twin is not None
    assert_same(run(case.fresh(), samples), kf)
    assert_same(run(twin, samples[51:]), kf)
    assert not np.array_equal(kf.x, other.x)
    for name, value in given.items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    for sample, original in zip(samples, kept, strict=True):
        np.testing.assert_array_equal(sample[0], original[0])
        np.testing.assert_array_equal(sample[2], original[2])


@everyone
def test_a_long_gap_makes_it_unsure_and_a_measurement_sure_again(case: Case) -> None:
    kf = run(case.fresh(), list(stream(7, gaps=0.0)))
    sure = np.trace(kf.P)
    for _ in range(2000):
        kf.predict(None if case.linear else 0.0, 0.01)
        kf.update(None)
    unsure = np.trace(kf.P)
    assert np.isfinite(kf.P).all()
    assert unsure > 2.0 * sure
    kf.update(np.reshape([0.0, 0.0], np.shape(kf.x)))
    assert np.trace(kf.P) < unsure


def test_the_guides_code_runs_and_does_what_the_guide_says() -> None:
    guide = Path(estimators.__file__).with_name("README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", guide, flags=re.DOTALL)
    assert len(blocks) == 4  # the last one: test_modes.py
    assert len([line for line in blocks[0].split("def run")[1].splitlines() if line.strip()]) <= 20
    shown: dict = {}
    exec(compile(blocks[0], "README.md", "exec"), shown)
    kalman, robust = shown["kalman"], shown["robust"]
    np.testing.assert_array_equal(robust[:1000, :2], kalman[:1000, :2])
    assert np.flatnonzero(robust[:, 4])[0] == 1001
    assert robust[1001:, 4].all()
    assert kalman[1000:, 0].max() == pytest.approx(0.069, abs=0.001)
    assert robust[1000:, 0].max() == pytest.approx(0.012, abs=0.001)
    narrow = shown["run"]([0.005, 0.025])
    rms = [np.sqrt(np.mean(part**2)) for part in (narrow[1000:, 0], narrow[500:1000, 0], robust[1000:, 0])]
    np.testing.assert_allclose(rms, [0.5e-3, 0.5e-3, 11e-3], atol=0.5e-3, rtol=0.1)

    exec(compile(blocks[1], "README.md", "exec"), shown)
    assert shown["ekf"].robust_weights[0] == pytest.approx(0.06, abs=0.005)
    assert shown["ekf"].nis == pytest.approx(2475, abs=1)

    exec(compile(blocks[2].replace("@njit\n", ""), "README.md", "exec"), shown)
    F, H, rng = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.random.default_rng(0)
    z = np.where(rng.random((50, 1)) < 0.2, np.nan, rng.normal(size=(50, 1)))
    out = shown["filtered"](z, F, H, np.array([1e-3, 1e-3]), np.ones(1), np.zeros(2), np.eye(2))
    kf = ExtendedKalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.x = F, H, 1e-3, np.zeros(2)
    for measured, x in zip(z, out, strict=True):
        kf.predict()
        kf.update(measured)
        np.testing.assert_allclose(x, kf.x, rtol=1e-10, atol=1e-12)
