"""Section 7.2: the proportional gain from which the position loop oscillates for ever."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.findings import Finding, Picture, Row, Table, number_text
from evidence.thesis.frequency_response import TransferFunction
from evidence.thesis.runs import PERIOD, riding_partner, run_position
from evidence.thesis.whole_eha import HIGH, HIGH_SPEED, LOW, respond, with_delay
from fdd.plant.scenario import Partner
from fdd.unit import Unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ULTIMATE = 33_750.0
"""(rad/s)/m, by experiment on the rig."""
OSCILLATES = 20e-6
"""m, peak to peak over the last second: twenty counts of the encoder."""
STEP = 0.1
MOST = 1e6
"""(rad/s)/m, highest gain tried."""
_REST, _SECONDS = 100, 3.9


def oscillation(unit: Unit, gain: float, seed: int, partner: tuple[Unit, Partner] | None = None) -> float:
    """Peak to peak position (m) in the last second of four after a step of 0.1 m, less its one-way creep."""
    setpoint = np.concatenate([np.zeros(_REST), np.full(round(_SECONDS / PERIOD), STEP)])
    log = run_position(unit, setpoint, gain, partner=partner, seed=seed).samples
    last = log["position"][-1000:]
    return float(np.ptp(last) - abs(np.mean(last[-50:]) - np.mean(last[:50])))


def ultimate_gain(
    unit: Unit, seed: int, partner: tuple[Unit, Partner] | None = None
) -> tuple[float, Array, Array]:
    """Least gain that oscillates, to 3 %, and the gains (n,) and amplitudes (n,) on the way; NaN for none."""
    gains: list[float] = []
    sizes: list[float] = []

    def oscillates(gain: float) -> bool:
        gains.append(gain)
        sizes.append(oscillation(unit, gain, seed, partner))
        return sizes[-1] > OSCILLATES

    low, high = 0.5 * ULTIMATE, float("nan")
    for gain in 0.5 * ULTIMATE * np.sqrt(2.0) ** np.arange(12):
        if gain <= MOST and oscillates(float(gain)):
            high = float(gain)
            break
        low = float(gain)
    while high / low > 1.03:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if oscillates(middle) else (middle, high)
    order = np.argsort(gains)
    return high, np.array(gains)[order], np.array(sizes)[order]


def linear_ultimate_gain(model: TransferFunction) -> float:
    """Proportional gain at which the loop around ``model/s`` is on the verge, (rad/s)/m.

    Where velocity over demanded speed lags 90°, and the integrator the other 90°.

    Examples
    --------
    >>> lag = TransferFunction((1.0,), (1.0, 1.0), 0.0)   # K/(s(s+1)) never oscillates
    >>> linear_ultimate_gain(lag)
    nan
    >>> delay = TransferFunction((1.0,), (1.0, 1e9), 0.25)
    >>> round(linear_ultimate_gain(delay) * 1e-9, 2)   # K·exp(-s/4)/s: K = 2π
    6.28
    """
    frequency = np.geomspace(0.05, 400.0, 40_001)
    response = model.at(frequency) / np.sign(model.gain)
    phase = np.unwrap(np.angle(response))
    late = np.flatnonzero(phase < -0.5 * np.pi)
    if late.size == 0:
        return float("nan")
    k = int(late[0])
    return float(2.0 * np.pi * frequency[k] / np.abs(response[k]))


def measure(axis_a: Unit, axis_b: Unit, seed: int) -> Finding:
    """Raise the gain on the plant, and ask the linear models."""
    found, gains, sizes = ultimate_gain(axis_a, seed)
    late, late_gains, late_sizes = ultimate_gain(with_delay(axis_a, 0.01), seed)
    soft_unit = with_delay(axis_a, 0.01)
    soft_unit.oil.bulk_modulus = 4e7
    soft, soft_gains, soft_sizes = ultimate_gain(soft_unit, seed)
    beside = riding_partner(axis_b)
    riding, _, _ = ultimate_gain(axis_a, seed, beside)
    late_riding, _, _ = ultimate_gain(with_delay(axis_a, 0.01), seed, beside)
    high_model = respond(axis_a, HIGH_SPEED, seed, sines=(10.0,)).model
    models = {"eq. 6.12": linear_ultimate_gain(LOW), "eq. 6.13": linear_ultimate_gain(HIGH)}
    own = linear_ultimate_gain(high_model)
    crossing = ULTIMATE * axis_a.pump.displacement / axis_a.cylinder.area_1
    why = (
        f"33750 (rad/s)/m crosses over at {crossing / (2 * np.pi):.1f} Hz, where neither of the thesis's "
        f"models lags much: they predict {number_text(models['eq. 6.12'])} and "
        f"{number_text(models['eq. 6.13'])}. With their 10 ms of delay the plant oscillates from "
        f"{number_text(late)}, with axis B riding along besides from {number_text(late_riding)}, and with "
        f"oil of 40 MPa instead from {number_text(soft)}."
    )
    rows = [
        Row("ultimate gain by experiment", "7.2", ULTIMATE, found, "(rad/s)/m", why=why, digits=4),
    ]  # fmt: skip
    cells = [
        ("thesis, experiment", number_text(ULTIMATE, 4)),
        ("thesis, eq. 6.12", number_text(models["eq. 6.12"])),
        ("thesis, eq. 6.13", number_text(models["eq. 6.13"])),
        ("plant, experiment", number_text(found)),
        ("plant, its high-speed model", number_text(own)),
        ("plant, axis B riding along, experiment", number_text(riding)),
        ("plant, axis B riding along, with a delay of 10 ms, experiment", number_text(late_riding)),
        ("plant with a delay of 10 ms, experiment", number_text(late)),
        ("plant with a delay of 10 ms and β = 40 MPa, experiment", number_text(soft)),
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for label, g, s, marker in (
            ("plant", gains, sizes, "o-"), ("plant, 10 ms delay", late_gains, late_sizes, "s-"),
            ("plant, 10 ms delay, β = 40 MPa", soft_gains, soft_sizes, "^-"),
        ):  # fmt: skip
            axes.loglog(g, 1e3 * np.maximum(s, 1e-7), marker, markersize=4, linewidth=1.0, label=label)
        axes.axvline(ULTIMATE, color="k", linestyle="--", linewidth=1.0, label="thesis, experiment: 33750")
        axes.axvline(models["eq. 6.12"], color="C3", linestyle=":", label="thesis, eq. 6.12 predicts")
        axes.axvline(models["eq. 6.13"], color="C4", linestyle=":", label="thesis, eq. 6.13 predicts")
        axes.axhline(1e3 * OSCILLATES, color="0.7", linewidth=0.8)
        axes.set(xlabel="proportional gain ((rad/s)/m)", ylabel="oscillation, peak to peak (mm)")
        axes.legend(fontsize=8)

    return Finding(
        "Ultimate gain",
        "Section 7.2 raises the proportional gain until the output oscillates at its set-point (Ziegler "
        "and Nichols) and takes half of it. Here the gain climbs by √2 and is then halved in: "
        f"oscillating means more than {1e6 * OSCILLATES:.0f} µm peak to peak, three to four seconds after "
        "a step of 0.1 m. A linear model's ultimate gain is where it lags 90° and the integrator the "
        "rest.",
        rows,
        tables=[Table("Ultimate gains ((rad/s)/m)", ("of", "gain"), cells)],
        remarks=[
            "Below that gain the plant comes to rest: stuck, with a dead band around the set-point, a "
            "loop without integrator has no reason to move. An oscillation at a tenth of the models' "
            "margin needs an effect that the thesis does not describe."
        ],
        pictures=[Picture("ultimate_gain", "What is left of the motion over the gain.", draw)],
    )
