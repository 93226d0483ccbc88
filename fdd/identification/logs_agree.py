"""Do several healthy logs of one unit agree: what each alone identifies, held against the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from fdd.errors import InputError
from fdd.identification.identify import identify_unit
from fdd.identification.profile import WORDS, against_base
from fdd.samples import Samples
from fdd.unit import Unit

FALSE_ALARM = 0.01
"""Share of healthy sets of logs that are refused by chance, over all quantities."""
BETWEEN = {
    "pump.leakage": (0.0, "1 to 2 K between the gap and the sensor stand in each log's own deviation"),
    "pump.displacement": (0.003, "0.01 to 0.03 % of a transducer's gain a kelvin"),
    "drive.torque_constant": (0.04, "magnets lose 0.1 % a kelvin and warm by 40"),
    "oil.bulk_modulus": (0.25, "air dissolves and comes out, and strokes are long or short"),
}
"""By what share a healthy unit differs from log to log, and by what. Friction is none of them: what a load
or a gust does to the force of one log alone is more."""
UNMEASURED = 0.4
"""The same of leakage where nobody measures the oil's temperature: 10 K."""


@dataclass(frozen=True)
class Comparison:
    """One quantity over the logs that tell it.

    Attributes
    ----------
    quantity : in words. logs : how many tell it. p_value : of their scatter. worst : the log that is farthest
        from the others; None where there are but two. times : its value over theirs. of : the logs.
    """

    quantity: str
    logs: int
    p_value: float
    worst: str | None
    times: float
    of: tuple[str, ...] = ()

    @property
    def refused(self) -> bool:
        """Whether the logs disagree."""
        return self.p_value < FALSE_ALARM / len(BETWEEN)

    @property
    def sentence(self) -> str:
        """What disagrees, in words."""
        if self.worst is None:
            return (
                f"{' and '.join(self.of)} disagree: {self.quantity} differs by a factor of {self.times:.3g}"
            )
        return f"{self.worst} disagrees with the others: {self.quantity} is {self.times:.3g} times theirs"


def disagreement(
    unit: Unit, logs: Sequence[Samples], labels: Sequence[str], *, more: bool = False
) -> list[Comparison]:
    """Compare what each log alone identifies, by a chi-square test of each quantity.

    The `unit` was identified from all of them or, with `more`, from other logs, and then counts as one.
    """
    if len(logs) + more < 2:
        return []
    each = [_alone(log, unit, label) for log, label in zip(logs, labels, strict=True)]
    if more:
        each, labels = [*each, _own(unit)], [*labels, f"profile {unit.name}"]
    out = []
    for quantity, (between, _) in BETWEEN.items():
        told = [(k, *values[quantity]) for k, values in enumerate(each) if quantity in values]
        if len(told) < 2:
            continue
        x, std = np.array([t[1] for t in told]), np.array([t[2] for t in told])
        weight = 1.0 / (std**2 + between**2)
        chi = _scatter(x, weight)
        without = [_scatter(np.delete(x, i), np.delete(weight, i)) for i in range(x.size)]
        odd = int(np.argmin(without))
        others = np.average(np.delete(x, odd), weights=np.delete(weight, odd))
        times = float(x[odd] / others) if others > 0.0 else np.inf
        worst = labels[told[odd][0]] if x.size > 2 else None
        of = tuple(labels[t[0]] for t in told)
        out.append(Comparison(WORDS[quantity], x.size, float(chdtrc(x.size - 1, chi)), worst, times, of))
    return sorted(out, key=lambda c: c.p_value)


def _scatter(x: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sum(weight * (x - np.average(x, weights=weight)) ** 2))


def _alone(log: Samples, unit: Unit, label: str) -> dict[str, tuple[float, float]]:
    """What this log alone identifies over the profile's, with its standard deviation.

    Not the logarithm: that of a leakage which a log can hardly tell from none has no normal law.
    """
    try:
        found = identify_unit([log], unit, labels=[label])
    except InputError:  # too short, or the pump hardly turns: it tells nothing against the others
        return {}
    ratios = against_base(found, unit, UNMEASURED)
    return {name: (r.value, r.value * r.std) for name, r in ratios.items()}


def _own(unit: Unit) -> dict[str, tuple[float, float]]:
    """What the profile itself says, where it was identified: 1, with its standard deviation."""
    numbers = {
        "pump.displacement": (unit.pump.displacement, unit.pump.std_of("displacement")),
        "pump.leakage": (unit.pump.cross_port_leakage, unit.pump.std_of("cross_port_leakage")),
        "drive.torque_constant": (unit.drive.torque_constant, unit.drive.std_of("torque_constant")),
        "oil.bulk_modulus": (unit.oil.bulk_modulus, unit.oil.std_of("bulk_modulus")),
    }
    return {name: (1.0, std / value) for name, (value, std) in numbers.items() if std and value > 0.0}
