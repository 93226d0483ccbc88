"""Ranges, shares and weights of recipes, and drawing from them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from fdd.errors import InputError


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] <= pair[1]:
        raise InputError(f"range [{pair[0]:g}, {pair[1]:g}] runs backwards", mend="write [low, high]")
    return pair


def within(least: float, most: float) -> AfterValidator:
    """Marks a range that may not leave these bounds."""

    def inside(pair: tuple[float, float]) -> tuple[float, float]:
        if pair[0] < least or pair[1] > most:
            problem = f"[{pair[0]:g}, {pair[1]:g}] leaves {least:g} to {most:g}"
            raise InputError(problem, mend="correct that range")
        return pair

    return AfterValidator(inside)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Range = Annotated[tuple[Finite, Finite], AfterValidator(_ordered)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Weight = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Rng = np.random.Generator


def uniform(rng: Rng, bounds: Range) -> float:
    """One value of a range."""
    return float(rng.uniform(*bounds))


def log_uniform(rng: Rng, bounds: Range) -> float:
    """One value of a positive range, each factor as likely."""
    return float(np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]))))


def spread(rng: Rng, bounds: Range) -> float:
    """Log-uniform where a positive range spans a factor of four or more, else uniform."""
    return log_uniform(rng, bounds) if 0.0 < 4.0 * bounds[0] <= bounds[1] else uniform(rng, bounds)


def drawn(rng: Rng, ranges: Mapping[str, Range]) -> dict[str, Any]:
    """One value for each, see `spread`."""
    return {name: spread(rng, bounds) for name, bounds in ranges.items()}


def chosen(rng: Rng, weights: Mapping[str, float]) -> str:
    """One of the names, by weight."""
    names, values = list(weights), np.array(list(weights.values()))
    return names[int(rng.choice(len(names), p=values / values.sum()))]


def apportioned(shares: Mapping[str, float], number: int) -> NDArray[np.str_]:
    """`number` names in their shares (sum 1): whole parts first, then the largest remainders."""
    names, wanted = list(shares), np.array(list(shares.values())) * number
    counts = np.floor(wanted + 1e-9).astype(int)
    left = number - int(counts.sum())
    for k in np.argsort(-(wanted - counts), kind="stable")[:left]:
        counts[k] += 1
    return np.repeat(names, counts)
