"""Frames drawn from the model that evidence assumes: Gaussian, with known coefficients, wander and faults."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fdd.diagnosis.evidence import Amplitude, Evidence
from fdd.diagnosis.hypotheses import Hypothesis
from fdd.residuals.balance_history import marginalised
from fdd.residuals.effects import Effects

NAME = "volume"
FRAMES = 80
EFFECTS = Effects(
    mean=np.array([1.0, 0.0, 0.5]),
    covariance=np.diag([0.3, 0.2, 0.4]) ** 2,
    known=np.diag([0.3, 0.2, 0.4]) ** 2 - np.diag([0.05, 0.04, 0.06]) ** 2,
    units=np.array([0.3, 0.2, 0.4]),
    between=np.array([[0.05, 0.04, 0.06], *np.zeros((4, 3))]),
    within=np.array([0.02, 0.02, 0.03]),
    wander=np.array([0.05, 0.08, 0.05]),
    noise=1.0,
    information=np.eye(3),  # a baseline whose errors are independent
    scatter=np.eye(3),
    log_variance=np.array([0.05, 0.04, 0.06]) ** 2,
)


def hypothesis(fault: str, column: Sequence[float], *, signed: bool = True) -> Hypothesis:
    return Hypothesis(fault, fault, {NAME: np.array(column)}, 0.7, signed)


LEAK = hypothesis("leak", [1.0, 0.0, 0.0])
DRIFT = hypothesis("drift", [0.0, 1.0, 0.2])
THIRD = hypothesis("third", [0.3, -0.4, 1.0], signed=False)


def drawn(
    seed: int, faults: Sequence[tuple[Hypothesis, float, int]] = (), *, colour: float = 0.0,
    frames: int = FRAMES, steady: bool = False, grow: int = 0, share: float = 0.0,
) -> Evidence:  # fmt: skip
    """Evidence of a log with steps of hypotheses, of an amplitude from a frame on.

    `colour` is the share of a frame's error that a block of two seconds has in common; `steady`: no wander;
    `grow`: frames in which faults grow to their amplitude, from a share of it.
    """
    rng = np.random.default_rng(seed)
    n = EFFECTS.mean.size
    effects = replace(EFFECTS, wander=1e-4 * EFFECTS.wander) if steady else EFFECTS
    start = EFFECTS.mean + np.sqrt(np.diag(EFFECTS.covariance)) * rng.normal(size=n)
    information, vector = np.empty((frames, n, n)), np.empty((frames, n))
    common = np.repeat(rng.normal(size=(frames // 4 + 1, n)), 4, axis=0)[:frames]
    for h in range(frames):
        b = start + effects.wander * rng.normal(size=n)
        for fault, amplitude, onset in faults:
            if h >= onset:
                grown = share + (1.0 - share) * min((h - onset + 0.5) / max(grow, 1e-9), 1.0)
                b = b + amplitude * grown * fault.columns[NAME]
        x = rng.normal(size=(25, n)) * np.array([3.0, 2.0, 1.5])
        information[h] = x.T @ x * (1e6 if steady else 1.0)
        own = np.linalg.cholesky(information[h]) @ (
            np.sqrt(1.0 - colour) * rng.normal(size=n) + np.sqrt(4.0 * colour) * common[h]
        )
        vector[h] = information[h] @ b + own
    return Evidence({NAME: marginalised(information, vector, effects.wander)}, {NAME: effects})


def best(evidence: Evidence, h: Hypothesis) -> Amplitude | None:
    """One hypothesis at its likeliest, alone."""
    found = evidence.fits([h], [])
    return found[0] if found else None
