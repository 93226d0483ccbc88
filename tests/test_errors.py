"""The one line that a user reads when the input is unusable."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from fdd.errors import InputError

text = st.text(alphabet=st.characters(codec="utf-8"), max_size=60)


def test_the_line_names_place_problem_and_mend_in_that_order() -> None:
    error = InputError("row 7 is not a number", where=Path("logs/a.csv"), mend="correct that row")
    assert str(error) == "logs/a.csv: row 7 is not a number; correct that row"
    assert (error.where, error.problem, error.mend) == (
        "logs/a.csv",
        "row 7 is not a number",
        "correct that row",
    )


@given(text, st.none() | text, st.none() | text)
def test_always_one_line_whatever_it_quotes(problem: str, where: str | None, mend: str | None) -> None:
    assert len(str(InputError(problem, where=where, mend=mend)).splitlines()) <= 1


def test_at_puts_the_file_before_the_place_in_it() -> None:
    inner = InputError("not a number", where="pump.displacement", mend="correct that field")
    assert str(inner.at("unit.yaml")) == "unit.yaml: pump.displacement: not a number; correct that field"
    assert str(InputError("empty").at("unit.yaml")) == "unit.yaml: empty"
