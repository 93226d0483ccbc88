"""The model file: what it says, what is refused, and how its curves run."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import genpareto

from fdd.bounds import MAX_MODEL_BYTES
from fdd.diagnosis.model import AlarmTail, Calibration, Model, root
from tests.refusal import refused


def test_round_trip(tmp_path: Path, tiny_model: Model) -> None:
    path = tmp_path / "model.json"
    tiny_model.save(path)
    found = Model.load(path)
    assert found == tiny_model
    assert found.sha256 == tiny_model.sha256
    other = tiny_model.model_copy(update={"calibration": Calibration(midpoint=3.1, slope=1.0)})
    assert other.sha256 != tiny_model.sha256
    assert json.loads(path.read_text())["schema"] == "fdd.model/5"


def test_the_shipped_model_is_sound() -> None:
    shipped = Model.load()
    assert root(shipped.tail.threshold(0.2)) > shipped.tail.height
    assert shipped.calibration.probability(shipped.tail.threshold(0.2)) > 0.5


BROKEN = {
    "not JSON": ("{", "Invalid JSON: EOF while parsing an object at line 1"),
    "another schema": ({"schema": "fdd.model/1"}, "schema"),
    "no tail": ({"tail": None}, "tail"),
    "a scale of zero": ({"tail": {"height": 1, "rate_per_hour": 1, "scale": 0, "hours": 1}}, "tail.scale"),
    "not a number": ({"calibration": {"midpoint": math.nan, "slope": 1}}, "calibration.midpoint"),
    "endless": ({"tail": {"height": math.inf, "rate_per_hour": 1, "scale": 1, "hours": 1}}, "tail.height"),
    "an unknown field": ({"colour": 3}, "colour"),
    "a list": ("[1, 2]", ""),
    "nested beyond reading": ("[" * 100_000, ""),
    "a figure beyond reading": ('{"data": 1' + "0" * 5_000 + "}", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_in_one_line(case: str, tmp_path: Path, tiny_model: Model) -> None:
    change, place = BROKEN[case]
    path = tmp_path / "broken.json"
    if isinstance(change, dict):
        change = json.dumps({**json.loads(tiny_model.model_dump_json(by_alias=True)), **change})
    path.write_text(change)
    line = refused(lambda: Model.load(path))
    assert str(path) in line and place in line


def test_a_missing_or_huge_file_is_refused(tmp_path: Path) -> None:
    assert "no such model file" in refused(lambda: Model.load(tmp_path / "none.json"))
    (tmp_path / "huge.json").write_bytes(b" " * (MAX_MODEL_BYTES + 1))
    assert "larger than" in refused(lambda: Model.load(tmp_path / "huge.json"))


RATES = st.floats(1e-12, 1e6)


@given(one=RATES, other=RATES, shape=st.sampled_from([0.0, 0.1, 0.5]))
def test_a_rarer_alarm_has_a_higher_threshold(one: float, other: float, shape: float) -> None:
    tail = AlarmTail(height=1.6, rate_per_hour=35.0, scale=1.7, shape=shape, hours=1.0)
    rare, often = (root(tail.threshold(x)) for x in (min(one, other), max(one, other)))
    assert math.isfinite(rare) and math.isfinite(often)
    assert rare >= often >= tail.height - 1e-9
    if max(one, other) < 35.0 and one != other:
        passed = genpareto.sf(rare - tail.height, shape, scale=tail.scale)
        assert tail.rate_per_hour * passed == pytest.approx(min(one, other), rel=1e-6)


@given(one=st.floats(-1e6, 1e6), other=st.floats(-1e6, 1e6), off=st.floats(-2.7, 2.7))
def test_a_higher_score_is_a_likelier_fault(one: float, other: float, off: float) -> None:
    """Odds go by the root of twice a score, and are even at the midpoint."""
    calibration = Calibration(midpoint=2.7, slope=0.33)
    low, high = (calibration.probability(x) for x in sorted((one, other)))
    assert 0.0 <= low <= high <= 1.0
    above, below = (calibration.probability(0.5 * (2.7 + x) ** 2) for x in (off, -off))
    assert above == pytest.approx(1.0 - below, abs=1e-9)
