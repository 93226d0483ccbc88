"""filterpy's extended Kalman filter on the tracker's model, sample by sample.

Model step, walks, jumps, force balance and bounds are the tracker's compiled functions, called from Python:
what is slow is filterpy itself. It has no channels that come and go, so it gets rows with all sensors.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.eha import bounds, forces, gate, layout, loop, model, redundancy, walk
from estimators.eha.tracker import EhaTracker
from estimators.eha.update import MOVING

Array = NDArray[np.float64]

CHANNELS = (model.X, model.TH, model.P1, model.P2)
"""States that the peer measures."""
_COLUMNS = [layout.POSITION, layout.ANGLE, layout.PRESSURE_1, layout.PRESSURE_2]
_UNITS = np.array([1e3, 1.0, 1e-6, 1e-6])


@dataclass(frozen=True)
class PeerRun:
    """What filterpy made of a block.

    Attributes
    ----------
    whole : processor time per sample, s, of all of it.
    filterpy : of its `predict` and `update` alone, medians over the samples.
    x, variances : (STATES,) final state and its variances, model units.
    """

    whole: float
    filterpy: float
    x: Array
    variances: Array


def run_filterpy(tracker: EhaTracker, block: Array) -> PeerRun:
    """Track a block with filterpy's EKF, from a tracker's state after the block before.

    The tracker stays as it is; the block (n, COLUMNS) is evenly sampled, without gaps, with all pressures.
    """
    from filterpy.kalman import ExtendedKalmanFilter

    start = tracker.state()
    n, h, q, c = model.STATES, tracker.period * 1e3, tracker.model, tracker.noise_numbers
    memory = start["memory"].view(layout.MEMORY)[0]
    F, G, noise, out = np.eye(n), np.zeros((n, 4)), np.empty(4), np.empty(n)

    class Peer(ExtendedKalmanFilter):
        def predict_x(self, u: Any = 0) -> None:
            self.x = out.copy()

    peer = Peer(dim_x=n, dim_z=len(CHANNELS))
    peer.x, peer.P = start["x"], start["P"]
    H = np.zeros((len(CHANNELS), n))
    H[np.arange(len(CHANNELS)), CHANNELS] = 1.0
    r0 = np.array([c.position * 1e3, c.angle, c.pressure * 1e-6, c.pressure * 1e-6]) ** 2
    rates, walks = walk.walk_rates(c), np.empty(n)
    flow = slice(model.LEAK, model.LEAK + layout.FLOW_PARAMETERS)
    measured = block[:, _COLUMNS] * _UNITS
    spent = np.empty(len(block))
    begin = time.process_time()
    for row, z in enumerate(measured):
        x, P = peer.x, peer.P
        p_acc, viscosity = block[row, layout.ACCUMULATOR] * 1e-6, block[row, layout.VISCOSITY]
        loop.motion_noise(x, h, p_acc, True, q, c, noise)
        spread = (P[model.V, model.V] + noise[0]) * h * h
        trust = spread / (spread + P[model.X, model.X] + r0[0])
        v_at = x[model.V] + trust * ((z[0] - x[model.X]) / h - x[model.V])
        w_at = (z[1] - x[model.TH]) / h
        walk.walk_parameters(x, P, h, memory.unrest, c, rates, walks)
        model.step(x, h, viscosity, p_acc, v_at, w_at, q, out, F, G)
        F[:MOVING, model.FRIC :] = 0.0
        peer.F = F
        peer.Q = (G * noise) @ G.T
        peer.Q.flat[:: n + 1] += walks
        tick = time.perf_counter()
        peer.predict()
        lap = time.perf_counter() - tick
        before = np.array([peer.x[flow], np.diag(peer.P)[flow]])
        air, split = model.AIR, model.SPLIT
        kept = np.array([[*peer.x[[air, split]], 0.0], [*np.diag(peer.P)[[air, split]], peer.P[air, split]]])
        innovation = z - peer.x[list(CHANNELS)]
        variance = peer.P[CHANNELS, CHANNELS] + r0
        r = r0 + np.maximum((innovation / forces.ROBUST) ** 2 - variance, 0.0)
        tick = time.perf_counter()
        peer.update(z, lambda x: H, lambda x: H @ x, R=np.diag(r))
        spent[row] = lap + time.perf_counter() - tick
        gap = block[row, layout.DIFFERENCE] * 1e-6 - (z[2] - z[3])
        curve = model.friction_curve(peer.x[model.V], q)[0]
        if gate.pressures_rest(peer.x, h, c, memory):
            gate.keep_compliance(peer.x, peer.P, kept)
        walk.watch_jumps(peer.x, peer.P, before, h, c, memory)
        redundancy.compare_sensors(
            peer.x, peer.P, gap, c.pressure_difference**2 * 1e-12 + 2.0 * r0[2], memory
        )
        forces.balance_forces(peer.x, peer.P, h, curve, q, c, memory)
        bounds.keep_in_bounds(peer.x, peer.P)
    whole = (time.process_time() - begin) / len(block)
    return PeerRun(whole, float(np.median(spent)), peer.x.copy(), np.diag(peer.P).copy())
