import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from fdd.diagnosis.findings import MethodEstimate
from fdd.measures import Measure
from fdd.residuals.normal_equations import NormalEquations
from fdd.restorable import Restorable, packed
from fdd.samples import Samples
from fdd.service.store import schema


class Owner(Restorable):
    STATE, STATE_CLASSES = ("value", "inner"), (NormalEquations, Measure, MethodEstimate)

    def __init__(self, value=None, inner=None):
        self.value, self.inner = value, inner


KINDS = st.sampled_from([np.float64, np.bool_, np.int64, np.dtype([("a", "<f8"), ("b", "<f8", (2,))])])
ARRAYS = KINDS.flatmap(lambda kind: arrays(kind, array_shapes(min_dims=0, min_side=0, max_side=3)))
SAMPLES = st.integers(0, 3).map(lambda n: Samples(np.arange(n), {"position": np.full(n, np.nan)}))
FLOATS, TEXT, INTEGERS = st.floats(), st.text(), st.integers() | st.booleans() | st.none()
RECORDS = st.builds(Measure, TEXT, FLOATS) | st.builds(MethodEstimate, value=FLOATS, std=FLOATS) | SAMPLES
ALIKE = st.lists(st.builds(NormalEquations, ARRAYS, ARRAYS, FLOATS, FLOATS)) | st.sets(TEXT | st.integers())
VALUES = st.recursive(
    ARRAYS | FLOATS | FLOATS.map(np.float64) | TEXT | INTEGERS | RECORDS | ALIKE,
    lambda v: st.lists(v) | st.lists(v).map(tuple) | st.dictionaries(TEXT, v) | st.lists(st.tuples(v, v)),
)


def exact(value):
    if isinstance(value, list | tuple | dict):
        return type(value), [exact(x) for x in (value.items() if isinstance(value, dict) else value)]
    of = (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else repr(value)
    of = exact(value.columns) if isinstance(value, Samples) else of
    return type(value), value if isinstance(value, set) else of


@given(VALUES, VALUES)
def test_what_was_saved_comes_back(value, other):
    one, again = Owner(value, {"a": Owner(other)}), Owner(None, {"a": Owner()})
    again.restore(schema.unpacked(*schema.packed(one.state()), where=""))
    assert exact([again.value, again.inner["a"].value]) == exact([value, other])


def test_only_declared_classes_are_saved_and_damage_is_refused():
    for value in (object(), np.array([None]), Owner, {"a": 1j}):
        with pytest.raises(TypeError):
            Owner([value]).state()
    bad = [["Path", None, "x"], ["list"], ["dict", ["list", None, "a"]], {"a": 1}, ["array", "O", [1]], [], 5]
    bad += [["array", "<f8", [10**12]], ["array", "<f8", [-1]], ["floats", 3], ["each", "Measure", None, 1]]
    state = Owner([np.ones(3)]).state()
    broken = [{"values": packed({"value": tree, "inner": None})} for tree in bad]
    for damage in (*broken, {"values": state["values"][:-2]}, {"arrays": state["arrays"][:5]}):
        with pytest.raises((KeyError, ValueError, TypeError)):
            Owner([]).restore(state | damage)
