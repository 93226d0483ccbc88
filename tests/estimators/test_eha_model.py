"""The reduced model, its covariance step and updates: closed forms, dense algebra and an exact layer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.update import COUPLED, PAIRS, compare_sensors, layers_exceeded, selected_update
from estimators.kernels import svsf_gain
from estimators.linalg import project

N = eha.STATES
AREA, VOLUME, DISPLACEMENT = 1520.0, 2.16e6, 557.0  # mm², mm³, mm³/rad
CROSS, CASE, STEP, ACCUMULATOR, VISCOSITY = 6.031, 0.978, 1.0, 0.48, 0.9
SWEEP = 1.4  # of compliance with position, over that of the volumes
BULK, AIR_FRACTION, INDEX, REFERENCE = 2.10e8, 0.003, 1.4, 4.82e5


def model(area_2: float = 1.52e-3) -> eha.Array:
    """Axis A of the thesis, in the model's own units; a smaller second area where wanted."""
    return eha.parameters(
        area_1=1.52e-3, area_2=area_2, volume_1=2.16e-3, volume_2=2.16e-3, moving_mass=3.688,
        displacement=5.57e-7, cross_port_leakage=CROSS * 1e-12, case_leakage=CASE * 1e-12,
        bulk_modulus=BULK, air_fraction=AIR_FRACTION, polytropic_index=INDEX,
        reference_pressure=REFERENCE, friction_forward=(151.1, 510.2, 0.026, 0.59),
        friction_reverse=(113.0, 448.0, 0.007, 0.776), accumulator_pressure=ACCUMULATOR * 1e6,
        position_compliance=SWEEP,
    )  # fmt: skip


def state(rng: np.random.Generator) -> eha.Array:
    """Any state of a working axis, away from the corners of friction at standstill and of the bounds."""
    x = np.empty(N)
    x[eha.X] = rng.uniform(-120.0, 120.0)
    x[eha.V] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.5, -0.7)
    x[eha.TH], x[eha.W] = rng.uniform(-400.0, 400.0), rng.uniform(-0.3, 0.3)
    x[eha.P1], x[eha.P2] = rng.uniform(0.05, 3.4, 2)
    x[eha.LEAK], x[eha.VALVE1], x[eha.VALVE2] = rng.uniform(0.3, 5.0), *rng.uniform(-0.5, 20.0, 2)
    x[eha.AIR], x[eha.GAIN] = rng.uniform(0.5, 40.0), rng.uniform(-0.05, 0.05)
    x[eha.SPLIT] = rng.uniform(-0.8, 0.8) * x[eha.AIR]
    x[eha.FRIC], x[eha.VISC] = rng.uniform(0.2, 3.0), rng.uniform(0.0, 1500.0)
    x[eha.SKEW], x[eha.ZERO] = rng.uniform(-200.0, 200.0), rng.uniform(-0.1, 0.1)
    x[eha.LOAD], x[eha.STIF] = rng.uniform(-3000.0, 3000.0), rng.uniform(0.0, 40.0)
    x[eha.THROT], x[eha.INERT] = rng.uniform(0.0, 2e5), rng.uniform(0.0, 200.0)
    return x


def stepped(
    x: eha.Array, q: eha.Array, h: float = STEP, v_at: float = np.nan, w_at: float = np.nan
) -> tuple[eha.Array, eha.Array, eha.Array]:
    """State, F and G after one step."""
    out, F, G = np.empty(N), np.empty((N, N)), np.empty((N, 4))
    eha.step(x, h, VISCOSITY, ACCUMULATOR, v_at, w_at, q, out, F, G)
    return out, F, G


def differences(x: eha.Array, q: eha.Array, h: float = STEP) -> eha.Array:
    """∂out/∂x by central differences of fourth order."""
    found = np.empty((N, N))
    for j in range(N):
        d = 1e-3 * abs(x[j]) if j == eha.V else 1e-4 * max(abs(x[j]), 1e-2)
        shifted = []
        for k in (-2.0, -1.0, 1.0, 2.0):
            moved = x.copy()
            moved[j] += k * d
            shifted.append(stepped(moved, q, h)[0])
        found[:, j] = (shifted[0] - 8.0 * shifted[1] + 8.0 * shifted[2] - shifted[3]) / (12.0 * d)
    return found


@pytest.mark.parametrize("h", [0.5, 1.0, 5.0])
@pytest.mark.parametrize("area_2", [1.52e-3, 1.1e-3])
def test_jacobian_is_that_of_central_differences(area_2: float, h: float) -> None:
    rng, q = np.random.default_rng(11), model(area_2)
    typical = [50, 0.1, 100, 0.2, 1, 1, 1, 1, 1, 5, 2, 1e-2, 1, 300, 100, 1000, 10, 1e5, 50, 0.02]
    for _ in range(60):
        x = state(rng)
        found, expected = stepped(x, q, h)[1], differences(x, q, h)
        # Each entry as its share of what a typical change of that state does to that row.
        effect = np.abs(expected) * typical
        share = np.abs(found - expected) * typical / effect.max(axis=1, keepdims=True)
        assert share.max() < 1e-6, np.unravel_index(share.argmax(), share.shape)


def gas_volume(p: float) -> float:
    """Of a unit of free air, adiabatic or as its index says, over its volume at atmosphere."""
    return (eha.ATMOSPHERE / (p + eha.ATMOSPHERE)) ** (1.0 / INDEX)


def specific_volume(x: eha.Array, q: eha.Array, p: float) -> float:
    """Of oil with the mean share of air, up to a constant, over that at atmosphere: falls with pressure."""
    return 1e-3 * x[eha.AIR] * gas_volume(p) - q.stiff_compliance * p


def capacities(x: eha.Array, q: eha.Array, area_2: float) -> list[float]:
    """V/β of each chamber, mm³/MPa: eq. 5.20 with its own share of air, the sweep as the profile's."""
    found = []
    for sign, area, p in ((1.0, AREA, x[eha.P1]), (-1.0, area_2, x[eha.P2])):
        curve = gas_volume(p) / (INDEX * (p + eha.ATMOSPHERE))
        share = 1e-3 * (x[eha.AIR] + sign * x[eha.SPLIT])
        volume = VOLUME + sign * SWEEP * area * x[eha.X]
        found.append(volume * (q.stiff_compliance + share * curve))
    return found


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_volume_balance_holds_to_rounding(seed: int, h: float) -> None:
    """C₁Δp₁ + A₁Δx + h·outflow = D Δθ ρ̄/ρ₁ and its mirror image, by sums made here from eqs 3.14 to 3.18.

    The pump's teeth carry oil of the ports' mean density ρ̄; to first order in compressibility it takes up
    ½ (v₁ - v₂)/v more or less volume in a chamber, v the specific volume there.
    """
    area_2 = 1100.0
    q, x = model(area_2 * 1e-6), state(np.random.default_rng(seed))
    out = stepped(x, q, h)[0]
    change = out - x
    across = CROSS * (x[eha.P1] - x[eha.P2]) * x[eha.LEAK]
    to_case = [CASE * (x[p] - ACCUMULATOR) * x[eha.LEAK] for p in (eha.P1, eha.P2)]
    pairs = ((eha.VALVE1, eha.P1), (eha.VALVE2, eha.P2))
    valves = [(CROSS + CASE / 2.0) * x[v] * (x[p] - ACCUMULATOR) for v, p in pairs]
    swells = 0.5 * (specific_volume(x, q, x[eha.P1]) - specific_volume(x, q, x[eha.P2]))
    displaced = DISPLACEMENT * (1.0 + x[eha.GAIN]) * change[eha.TH]
    delivered = [displaced * (1.0 + swells), displaced * (1.0 - swells)]
    stored = [c * change[p] for c, p in zip(capacities(x, q, area_2), (eha.P1, eha.P2), strict=True)]
    out_1 = h * (across + to_case[0] + valves[0]) / VISCOSITY
    out_2 = h * (-across + to_case[1] + valves[1]) / VISCOSITY
    largest = max(abs(displaced), abs(out_1), abs(out_2), abs(AREA * change[eha.X]), 1.0)
    # Differences of states near 400 rad carry rounding of 400 × 2⁻⁵² times the displacement.
    rounding = 1e-12 * largest + 1e-10 * DISPLACEMENT * h
    assert stored[0] + AREA * change[eha.X] + out_1 == pytest.approx(delivered[0], abs=rounding)
    assert stored[1] - area_2 * change[eha.X] + out_2 == pytest.approx(-delivered[1], abs=rounding)


@given(st.integers(0, 2**32 - 1))
def test_noise_on_velocity_and_speed_keeps_the_balance(seed: int) -> None:
    """Columns of G for velocity and speed move position, angle and pressures together."""
    q, x = model(), state(np.random.default_rng(seed))
    G = stepped(x, q)[2]
    capacity = capacities(x, q, AREA)
    swells = 0.5 * (specific_volume(x, q, x[eha.P1]) - specific_volume(x, q, x[eha.P2]))
    displaced = DISPLACEMENT * (1.0 + x[eha.GAIN]) * G[eha.TH, 1]
    for column, flow in ((0, 0.0), (1, displaced)):
        into, out_of = flow * (1.0 + swells), flow * (1.0 - swells)
        assert capacity[0] * G[eha.P1, column] + AREA * G[eha.X, column] == pytest.approx(into, abs=1e-6)
        assert capacity[1] * G[eha.P2, column] - AREA * G[eha.X, column] == pytest.approx(-out_of, abs=1e-6)
    # One mm³ into a chamber raises its pressure by the inverse of its capacity, and nothing else.
    for column, p, c in ((2, eha.P1, capacity[0]), (3, eha.P2, capacity[1])):
        assert G[p, column] * c == pytest.approx(1.0)
        assert np.count_nonzero(G[:, column]) == 1


@given(st.floats(0.1, 20.0), st.floats(0.1, 50.0))
def test_compliance_near_eq_5_21(pressure: float, per_mille: float) -> None:
    """Eq. 5.21, 1/β = (1 - δ)/β₀ + δ/(1.4 P), where δ is the share of gas at the pressure P (absolute)."""
    q = model()
    absolute = pressure + eha.ATMOSPHERE
    gas = 1e-3 * per_mille * (eha.ATMOSPHERE / absolute) ** (1.0 / INDEX)  # volume over oil's, at P
    delta = gas / (1.0 + gas)
    mixture = (1.0 - delta) * q.stiff_compliance + delta / (INDEX * absolute)
    # The model refers volumes to the oil alone: 1 + gas of the mixture's.
    assert eha.compliance(pressure, per_mille, q)[0] == pytest.approx((1.0 + gas) * mixture, rel=1e-9)


@given(st.floats(-0.3, 0.3).filter(lambda v: abs(v) > 1e-6))
def test_friction_curve_is_eq_5_12_with_a_smooth_reversal(v: float) -> None:
    q = model()
    coulomb, static, stribeck, exponent = (
        (151.1, 510.2, 0.026, 0.59) if v > 0 else (113.0, 448.0, 0.007, 0.776)
    )
    curve, slope, *_ = eha.friction_curve(v, q)
    level = coulomb + (static - coulomb) * np.exp(-(((abs(v) + 1e-5) / stribeck) ** exponent))
    assert curve == pytest.approx(np.tanh(v / eha.STICTION_VELOCITY) * level, rel=1e-9)
    d = 1e-3 * abs(v)
    expected = (eha.friction_curve(v + d, q)[0] - eha.friction_curve(v - d, q)[0]) / (2.0 * d)
    assert slope == pytest.approx(expected, rel=1e-3, abs=0.1)


@given(st.floats(1e-4, 0.3))
def test_viscous_friction_has_a_direction(v: float) -> None:
    """VISC + SKEW when extending, VISC - SKEW when retracting; of two velocities the mean is VISC's alone."""
    q, x = model(), np.zeros(N)
    x[[eha.P1, eha.P2, eha.AIR]] = ACCUMULATOR, ACCUMULATOR, 3.0
    cases = ((1.0, 0.0, 200.0), (-1.0, 0.0, 200.0), (1.0, 50.0, 250.0), (-1.0, 50.0, 150.0))
    for sign, skew, expected in cases:
        x[[eha.V, eha.VISC, eha.SKEW]] = sign * v, 200.0, skew
        after = stepped(x, q)[0][eha.V]
        over_velocity = (x[eha.V] - after) / after * q.moving_mass * 1e3
        assert over_velocity == pytest.approx(expected, rel=1e-9)


# States measured by each channel, added and subtracted: position, angle, both pressures, their difference.
PLUS = np.array([eha.X, eha.TH, eha.P1, eha.P2, eha.P1])
MINUS = np.array([-1, -1, -1, -1, eha.P2])
M = PLUS.size


def outputs() -> np.ndarray:
    """The same as a matrix."""
    H = np.zeros((M, N))
    H[np.arange(M), PLUS] = 1.0
    H[4, eha.P2] = -1.0
    return H


def covariance(rng: np.random.Generator, decades: float = 3.0) -> np.ndarray:
    """Of two blocks, with the states' scales apart by up to twice `decades`."""
    P = np.zeros((N, N))
    for block in (slice(0, COUPLED), slice(COUPLED, N)):
        size = len(range(N)[block])
        root = rng.standard_normal((size, size)) * 10.0 ** rng.uniform(-decades, decades, (size, 1))
        P[block, block] = root @ root.T
    return 0.5 * (P + P.T)


@pytest.mark.parametrize("channel", range(M))
@pytest.mark.parametrize("decades", range(2, 31, 4))
def test_what_a_precise_channel_leaves_is_right_to_its_last_digits(channel: int, decades: int) -> None:
    """Noise far below the rounding of the prior: the variance left is its own, which P - k s k' loses."""
    P, h = covariance(np.random.default_rng(channel), 0.5), outputs()[channel]
    prior = float(h @ P @ h)
    r = prior * 10.0**-decades
    selected_update(P, PLUS[channel], MINUS[channel], r, np.empty(N))
    left = r * prior / (prior + r)
    # Both pressures keep their variance: it is their difference that has to be this small.
    within = 0.0 if MINUS[channel] < 0 else 4e-16 * P[eha.P1, eha.P1]
    assert h @ P @ h == pytest.approx(left, rel=1e-12, abs=within)
    np.testing.assert_array_equal(P, P.T)
    spread = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(spread, spread)).min() > -1e-14, "as correlations"


@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=M, max_size=M), st.floats(0.5, 20.0))
def test_layers_are_those_of_the_svsf(seed: int, used: list[bool], layer: float) -> None:
    """Also with a difference beside both pressures, where H P H' is singular."""
    rng, mask = np.random.default_rng(seed), np.array(used)
    P, y, r = covariance(rng, 0.5), rng.standard_normal(M), 10.0 ** rng.uniform(-2.0, 0.0, M)
    e_post, psi_k = rng.standard_normal(M), np.empty(M)
    used_H, R = outputs()[mask], np.diag(r[mask])
    count = len(used_H)
    psi = layer * np.sqrt(np.einsum("ci,ij,cj->c", used_H, P, used_H) + r[mask])
    exceeded = layers_exceeded(P, y, PLUS, MINUS, r, mask, e_post, 0.1, layer, psi_k, np.empty((2 * M, M)))
    PHt, HPHt, expected = np.empty((N, count)), np.empty((count, count)), np.empty(count)
    project(P, used_H, PHt, HPHt)
    switched = svsf_gain(
        PHt, HPHt, R, y[mask], e_post[mask], 0.1, psi, True, np.empty((N, count)), expected,
        np.empty(count, np.bool_),
    )  # fmt: skip
    np.testing.assert_allclose(psi_k[mask], expected, rtol=1e-6)
    assert np.isnan(psi_k[~mask]).all()
    assert exceeded == (psi_k[mask] > psi).any()
    if np.abs(psi_k[mask] / psi - 1.0).min(initial=1.0) > 1e-5:
        assert exceeded == switched


PRIOR = 4e-4  # MPa²: 20 kPa
VARIANCE = 2.0 * 0.003**2 + 0.007**2


def compared(gaps: np.ndarray) -> tuple[eha.Array, eha.Array]:
    """State and covariance after these differences, MPa."""
    x, P, memory = np.zeros(eha.STATES), np.full((eha.STATES, eha.STATES), 0.5), np.zeros(1, layout.MEMORY)[0]
    P[eha.ZERO, :] = P[:, eha.ZERO] = 0.0
    P[eha.ZERO, eha.ZERO] = PRIOR
    for gap in gaps:
        compare_sensors(x, P, float(gap), VARIANCE, memory)
    return x, P


def test_an_outlier_moves_it_by_no_more_than_its_share() -> None:
    """A short circuit of 3 MPa for 20 samples, after half a second of good data."""
    rng = np.random.default_rng(4)
    good = 0.01 + np.sqrt(VARIANCE) * rng.standard_normal(25 * PAIRS)
    before, P_before = compared(good)
    after, P_after = compared(np.concatenate([good, np.full(PAIRS, 3.0)]))
    # Huber at five standard deviations of the innovation: 5 √s K, with s = P + r, K = P/s.
    prior, noise = P_before[eha.ZERO, eha.ZERO], VARIANCE / PAIRS
    most = 5.0 * prior / np.sqrt(prior + noise)
    assert 0.0 < after[eha.ZERO] - before[eha.ZERO] <= most * (1.0 + 1e-9)
    assert 0.99 * prior < P_after[eha.ZERO, eha.ZERO] <= prior
