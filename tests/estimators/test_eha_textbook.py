"""The compiled tracker, sample by sample, against a textbook EKF in dense matrices.

Process noise, walks, the valves' pull, robust weights, jumps and bounds are written out anew, from the
tracker's documentation; of the tracker's code only the model's step is used, which has tests of its own.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.layout import Noise
from estimators.eha.tracker import EhaTracker
from estimators.eha.walk import walk_parameters, walk_rates
from estimators.ekf import ExtendedKalmanFilter
from fdd import Unit, simulate
from fdd.plant.scenario import Recording, Scenario
from fdd.residuals.tracking import Tracking, channels_of, healthy_viscous, noise_of

N = eha.STATES
VALVES = [eha.VALVE1, eha.VALVE2]
FLOW = range(eha.LEAK, eha.SPLIT + 1)
ROBUST = 5.0
BOUNDS = {eha.LEAK: (0.02, 300.0), **dict.fromkeys(VALVES, (0.0, 300.0))}
BOUNDS |= {eha.AIR: (-2.0, 100.0), eha.SPLIT: (-30.0, 30.0), eha.GAIN: (-0.1, 0.1)}
# Parameters that walk, as (field of the noise, factor from SI to the model's unit), from its documentation.
WALKS = {
    eha.LEAK: ("leakage", 1.0), eha.AIR: ("air", 1e3), eha.SPLIT: ("air_split", 1e3), eha.GAIN: ("gain", 1.0),
    eha.FRIC: ("friction", 1.0), eha.VISC: ("viscous_friction", 1.0), eha.SKEW: ("viscous_skew", 1.0),
    eha.STIF: ("stiffness", 1e-3), eha.THROT: ("throttle", 1.0), eha.INERT: ("inertia", 1.0),
    eha.ZERO: ("zero", 1e-6),
}  # fmt: skip
# Where the textbook's constants of the windows come from: 250 ms, the long one eight of them.
WINDOW, LONG, JUMP = 250, 8, 5.0


class Textbook:
    """The filter of `EhaTracker` without its friction and load, one row in model units at a time."""

    def __init__(self, q: np.ndarray, noise: Noise, x: np.ndarray, P: np.ndarray) -> None:
        self.q, self.noise = q, noise
        self.kf = ExtendedKalmanFilter(N, 4)
        self.kf.x, self.kf.P = x.copy(), P.copy()
        self.kf.H = np.eye(N)[[eha.X, eha.TH, eha.P1, eha.P2]]
        pressure = noise.pressure * 1e-6
        self.r0 = np.array([noise.position * 1e3, noise.angle, pressure, pressure]) ** 2
        self.gaps: list[float] = []
        self.shifts: list[np.ndarray] = []  # one row a sample of what the flow parameters moved by
        self.gained: list[np.ndarray] = []
        self.long_from, self.windows, self.streak = 0, 0, 0
        self.jumps = self.bounded = 0
        self.velocity_mean = 0.0

    def walks(self, x: np.ndarray, P: np.ndarray) -> np.ndarray:
        """Variances that a millisecond adds to each parameter."""
        added = np.zeros(N)
        for state, (name, factor) in WALKS.items():
            rate, most = getattr(self.noise, name) * factor, getattr(self.noise, f"initial_{name}") * factor
            if state == eha.LEAK:
                rate, most = rate * max(1.0, x[state]), most * max(1.0, x[state])
            if state == eha.AIR:
                most *= max(1.0, 0.3 * x[state])
            added[state] = rate**2 * 1e-3 * max(0.0, 1.0 - P[state, state] / most**2)
        added[eha.LOAD] = self.noise.load**2 * 1e-3
        return added

    def pull(self) -> np.ndarray:
        """Draw the valves back; the variances that the Cauchy prior's walk adds meanwhile."""
        x, P = self.kf.x.copy(), self.kf.P.copy()
        added = np.zeros(N)
        D = np.eye(N)
        tau = 2.0 * (self.noise.initial_valve / self.noise.valve) ** 2
        for j in VALVES:
            openness = 1.0 + (x[j] / (3.0 * self.noise.initial_valve)) ** 2
            D[j, j] = 1.0 - 1e-3 / (tau * openness)
            added[j] = self.noise.valve**2 * 1e-3 * openness
        self.kf.x, self.kf.P = D @ x, D @ P @ D
        return added

    def predict(self, z: np.ndarray, p_acc: float, viscosity: float) -> None:
        x, P, noise = self.kf.x, self.kf.P, self.noise
        velocity = (1e-3 / self.q.moving_mass * noise.force) ** 2 * 1e3
        spread = P[eha.V, eha.V] + velocity
        trust = spread / (spread + P[eha.X, eha.X] + self.r0[0])
        v_at = x[eha.V] + trust * (z[0] - x[eha.X] - x[eha.V])
        self.velocity_mean += 1e-3 / noise.smoothing * (v_at - self.velocity_mean)
        v_at, w_at = self.velocity_mean, z[1] - x[eha.TH]
        relieved = abs(x[eha.P1] - x[eha.P2]) > noise.relief_pressure * 1e-6
        refed = relieved | (x[[eha.P1, eha.P2]] < p_acc + noise.refeed_margin * 1e-6)
        flows = np.where(refed, noise.flow_refeeding, noise.flow)
        added = self.walks(x, P) + self.pull()
        out, F, G = np.empty(N), np.empty((N, N)), np.empty((N, 4))
        eha.step(self.kf.x.copy(), 1.0, viscosity, p_acc, v_at, w_at, self.q, out, F, G)
        F[: eha.LEAK, eha.FRIC :] = 0.0  # friction and load learn from the mean force alone
        areas = np.array([self.q.area_1, self.q.area_2])
        compression = 100.0 * (noise.compression * (self.q.displacement * w_at - areas * v_at)) ** 2
        variances = [
            velocity, (noise.acceleration * 1e-3) ** 2 * 1e-3, *(flows * 1e9) ** 2 * 1e-3 + compression
        ]  # fmt: skip
        self.kf.f, self.kf.F_jacobian = (lambda *_: out), (lambda *_: F)
        self.kf.predict(dt=1.0, Q=G @ np.diag(variances) @ G.T + np.diag(added))

    def update(self, z: np.ndarray) -> None:
        before = self.kf.x.copy(), self.kf.P.copy()
        variance = np.diag(self.kf.H @ self.kf.P @ self.kf.H.T) + self.r0
        sigmas = np.abs(z - self.kf.H @ self.kf.x) / np.sqrt(variance)
        self.kf.update(z, R=np.diag(self.r0 + variance * np.maximum((sigmas / ROBUST) ** 2 - 1.0, 0.0)))
        self.shifts.append((self.kf.x - before[0])[FLOW])
        self.gained.append((np.diag(before[1]) - np.diag(self.kf.P))[FLOW])

    def scores(self, start: int) -> np.ndarray:
        return np.sum(self.shifts[start:], axis=0) / np.sqrt(np.sum(self.gained[start:], axis=0))

    def watch(self) -> None:
        """Every 250 ms, and every 2 s: widen after a score beyond five."""
        if len(self.shifts) % WINDOW:
            return
        self.windows += 1
        beyond = np.abs(self.scores(-WINDOW)).max() > JUMP
        if self.windows == LONG:
            beyond = beyond or np.abs(self.scores(self.long_from)).max() > JUMP
            self.windows, self.long_from = 0, len(self.shifts)
        if not beyond:
            self.streak = 0
            return
        size, noise = 2.0**self.streak, self.noise
        self.streak = min(self.streak + 1, 5)
        P = self.kf.P.copy()
        for state, step in (
            (eha.LEAK, noise.jump_leakage), (eha.VALVE1, noise.jump_valve), (eha.VALVE2, noise.jump_valve),
            (eha.AIR, noise.jump_air * 1e3), (eha.SPLIT, noise.initial_air_split * 1e3),
            (eha.GAIN, noise.initial_gain),
        ):  # fmt: skip
            P[state, state] += (step * size) ** 2
        self.kf.P = P
        self.windows, self.long_from = 0, len(self.shifts)
        self.jumps += 1

    def redundancy(self, gap: float) -> None:
        """The difference sensor's zero, twenty samples at a time: a filter of one state."""
        self.gaps.append(gap)
        if len(self.gaps) < 20:
            return
        x, P = self.kf.x.copy(), self.kf.P.copy()
        error = np.mean(self.gaps) - x[eha.ZERO]
        variance = ((self.noise.pressure_difference * 1e-6) ** 2 + 2.0 * self.r0[2]) / 20.0
        assert error**2 < ROBUST**2 * (P[eha.ZERO, eha.ZERO] + variance), "no outliers here"
        gain = P[eha.ZERO, eha.ZERO] / (P[eha.ZERO, eha.ZERO] + variance)
        x[eha.ZERO] += gain * error
        P[eha.ZERO, eha.ZERO] *= 1.0 - gain
        self.kf.x, self.kf.P, self.gaps = x, P, []

    def bounds(self) -> None:
        """Each state beyond its bound is taken there along the covariance; what is then beyond is cut off."""
        x, P = self.kf.x.copy(), self.kf.P
        for state, (low, high) in BOUNDS.items():
            moved = np.clip(x[state], low, high) - x[state]
            if moved:
                x[eha.LEAK :] += P[eha.LEAK :, state] / P[state, state] * moved
                self.bounded += 1
        for state, (low, high) in BOUNDS.items():
            x[state] = np.clip(x[state], low, high)
        self.kf.x = x

    def step(self, z: np.ndarray, gap: float, p_acc: float, viscosity: float) -> None:
        """One row: position, angle, both pressures; their measured difference less its own."""
        self.predict(z, p_acc, viscosity)
        self.update(z)
        self.watch()
        self.redundancy(gap)
        self.bounds()


def compare(seconds: float, begin: Callable[[EhaTracker], None]) -> tuple[Textbook, EhaTracker]:
    """Both filters over the same rows, from rest into motion; they must agree at each."""
    unit, duty = Unit.load("axis_a"), {"name": "steps", "lead_in": 0.03}
    scenario = Scenario(duration=seconds, duty=duty, load={"name": "spring"}, recording=Recording.perfect())
    run = simulate(unit, scenario)
    tracking = Tracking(unit, channels_of(run.samples), 1e-3)
    block = tracking.block(run.samples)
    compiled = EhaTracker(
        tracking.model, replace(noise_of(unit), compression=0.05, smoothing=3e-3),
        viscous_friction=healthy_viscous(unit), air_fraction=unit.oil.air_fraction,
    )  # fmt: skip
    compiled.model.sliding_velocity = 1e3  # so that the mean force says nothing: that is no part of this
    begin(compiled)
    compiled.push(block[:1])
    state = compiled.state()
    book = Textbook(compiled.model, compiled.noise, state["x"], state["P"])
    # The row that starts the motion counts for the redundancy and for the first window, with no update.
    gap = block[0, layout.DIFFERENCE] - (block[0, layout.PRESSURE_1] - block[0, layout.PRESSURE_2])
    book.gaps.append(gap * 1e-6)
    book.shifts, book.gained = [np.zeros(len(FLOW))], [np.zeros(len(FLOW))]
    for i in range(1, len(block)):
        compiled.push(block[i : i + 1])
        row = block[i]
        z = row[[layout.POSITION, layout.ANGLE, layout.PRESSURE_1, layout.PRESSURE_2]]
        gap = row[layout.DIFFERENCE] - (row[layout.PRESSURE_1] - row[layout.PRESSURE_2])
        z *= [1e3, 1.0, 1e-6, 1e-6]
        book.step(z, gap * 1e-6, row[layout.ACCUMULATOR] * 1e-6, row[layout.VISCOSITY])
        spread = np.sqrt(np.diag(book.kf.P))
        np.testing.assert_allclose((compiled.x - book.kf.x) / spread, 0.0, atol=1e-6, err_msg=f"row {i}")
        ours, theirs = (P / np.outer(spread, spread) for P in (compiled.P, book.kf.P))
        np.testing.assert_allclose(ours, theirs, atol=1e-6, err_msg=f"row {i}")
    return book, compiled


def test_each_step_is_that_of_the_textbook_filter() -> None:
    book, compiled = compare(0.6, lambda _: None)
    assert abs(compiled.x[eha.X]) > 1.0, "it should have moved"
    assert book.bounded > 0, "a valve's noise should have reached its bound"
    assert compiled.x[eha.ZERO] != 0.0


@pytest.mark.parametrize("leakage", [8.0, 0.1])
def test_jumps_and_bounds_are_those_of_the_textbook_filter(leakage: float) -> None:
    """It begins sure of a leakage that is not there: scores pass their limit, valves their bound."""

    def begin(compiled: EhaTracker) -> None:
        compiled.x[eha.LEAK], compiled.x[eha.VALVE1] = leakage, 0.2
        compiled.P[eha.LEAK, eha.LEAK] = 0.01**2

    book, compiled = compare(2.6, begin)
    assert book.jumps > 0
    assert book.bounded > 0
    assert compiled.P[eha.LEAK, eha.LEAK] > 0.01**2


def walked(x: np.ndarray, P: np.ndarray, seconds: float, h: float) -> tuple[np.ndarray, np.ndarray]:
    """State and covariance after steps of `h` ms without any measurement."""
    x, P, diag, c = x.copy(), P.copy(), np.empty(N), Noise().numbers()
    rates = walk_rates(c)
    for _ in range(round(1e3 * seconds / h)):
        walk_parameters(x, P, h, 1.0, c, rates, diag)
        P[np.diag_indices(N)] += diag
    return x, P


@pytest.mark.parametrize("gap", [2.0, 60.0, 3600.0])
def test_a_gap_in_one_step_is_the_gap_in_milliseconds(gap: float) -> None:
    """A log with a hole, or a monitor that was off for an hour: one call, not a million."""
    x, noise, P = np.zeros(N), Noise(), np.zeros((N, N))
    x[[eha.LEAK, eha.AIR, eha.FRIC, *VALVES]] = 1.0, 3.0, 1.0, 0.02, 0.002
    for state, (name, factor) in WALKS.items():
        P[state, state] = (0.3 * getattr(noise, f"initial_{name}") * factor) ** 2
    P[VALVES, VALVES] = (0.3 * noise.initial_valve) ** 2
    at_once, slowly = walked(x, P, gap, 1e3 * gap), walked(x, P, gap, gap)
    # The valve's pull changes a little while it closes; one step takes it as it was.
    np.testing.assert_allclose(at_once[0], slowly[0], atol=2e-3)
    for state in (*WALKS, *VALVES):
        spread = np.sqrt(slowly[1][state, state] + 1e-12)
        assert np.sqrt(at_once[1][state, state]) == pytest.approx(spread, rel=0.06), state
    for state, (name, factor) in WALKS.items():
        most = getattr(noise, f"initial_{name}") * factor
        assert np.sqrt(at_once[1][state, state]) <= most * (1.0 + 1e-9)
