"""What is saved comes back with the same types, and what is damaged is refused."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pydantic import BaseModel

from fdd.restorable import Restorable, packed
from fdd.samples import Samples
from fdd.service.store import schema


class Pair(NamedTuple):
    wide: Any
    rows: float


@dataclass
class Record:
    of: Any


class Finding(BaseModel):
    share: float | None


class Owner(Restorable):
    STATE = ("value", "inner")
    STATE_CLASSES = (Pair, Record, Finding)

    def __init__(self, value: Any = None, inner: Any = None) -> None:
        self.value, self.inner = value, inner


ROWS = [("time", "<f8"), ("state", "<f8", (2,))]
PLAIN = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
ARRAYS = st.sampled_from([np.float64, np.bool_, np.int64, np.dtype(ROWS)]).flatmap(
    lambda of: arrays(of, array_shapes(min_dims=0, min_side=0, max_side=3))
)
SAMPLES = st.integers(0, 3).map(lambda n: Samples(np.arange(n), {"position": np.full(n, np.nan)}))
LEAVES = (
    PLAIN | ARRAYS | st.floats().map(np.float64) | SAMPLES | st.builds(Finding, share=st.none() | st.floats())
)
VALUES = st.recursive(
    LEAVES,
    lambda v: (st.lists(v) | st.lists(v).map(tuple) | st.dictionaries(st.text(max_size=2), v) | st.builds(Record, v)
               | st.sets(PLAIN.filter(lambda x: x == x)) | st.lists(st.builds(Pair, ARRAYS, st.floats())) | st.lists(st.tuples(v, v))),
    max_leaves=12,
)  # fmt: skip


def text(value: Any) -> str:
    """All of a value with its types, to the bit."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes()!r}"
    if isinstance(value, dict | list | tuple):
        parts = [*value.items()] if isinstance(value, dict) else value
        return f"{type(value)}({', '.join(text(p) for p in parts)})"
    if isinstance(value, Samples | Record | Finding):
        return (
            f"{type(value)}{text([value.time, value.columns] if isinstance(value, Samples) else vars(value))}"
        )
    return f"{type(value)}{sorted(map(repr, value)) if isinstance(value, set) else repr(value)}"


@given(VALUES, VALUES)
def test_what_was_saved_comes_back(value: Any, other: Any) -> None:
    one, again = Owner(value, {"a": Owner(other), "b": Owner(1)}), Owner(None, {"a": Owner(), "b": Owner()})
    again.restore(schema.unpacked(*schema.packed(one.state()), where=""))
    assert text(again.value) == text(value) and text(again.inner["a"].value) == text(other)


@pytest.mark.parametrize("value", [object(), np.array([None]), Owner, {1: object()}])
def test_only_declared_classes_are_saved(value: Any) -> None:
    with pytest.raises(TypeError):
        Owner([value]).state()


TOLD = [["Path", None, "x"], ["Owner", None], ["list"], ["dict", ["list", None, "a"]], {"a": 1}, ["array", "O", [1]],
        ["array", "<f8", [-1]], ["array", "<f8", [10**12]], ["floats", 3], [], ["each", "Pair", None, 1], 5]  # fmt: skip


@pytest.mark.parametrize("told", TOLD)
def test_damage_is_refused(told: Any) -> None:
    state = Owner([np.ones(3)]).state()
    for broken in (
        {"values": packed({"value": told, "inner": None})},
        {"values": state["values"][:-2]},
        {"arrays": state["arrays"][:5]},
    ):
        with pytest.raises((KeyError, ValueError, TypeError)):
            Owner([]).restore(state | broken)
    with pytest.raises(KeyError):
        Owner().restore({"values": state["values"]})
