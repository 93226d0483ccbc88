"""The same work for each unit, in one process or in several."""

from __future__ import annotations

import pytest

from fdd.campaign.units import for_each_unit
from fdd.errors import InputError

UNITS = ["unit_000", "unit_001", "unit_002"]


def letters(unit: str) -> list[str]:
    return [f"{unit}-{letter}" for letter in "ab"]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_units(workers: int) -> None:
    told: list[tuple[int, int]] = []
    found = for_each_unit(letters, UNITS, workers=workers, progress=lambda *step: told.append(step))
    assert found == [f"{unit}-{letter}" for unit in UNITS for letter in "ab"]
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_unit_that_refuses_is_left_out_with_a_warning(workers: int) -> None:
    with pytest.warns(UserWarning, match=f"{UNITS[1]} left out: too short"):
        assert for_each_unit(one_refuses, UNITS, workers=workers) == [u for u in UNITS if u != UNITS[1]]
    with pytest.raises(InputError, match="too short"), pytest.warns(UserWarning, match="left out"):
        for_each_unit(one_refuses, UNITS[1:2], workers=workers)


def one_refuses(unit: str) -> list[str]:
    if unit == UNITS[1]:
        raise InputError("too short", mend="record more")
    return [unit]
