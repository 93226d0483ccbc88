"""What severity 1 of each fault is in figures: numbers that a user may override."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import Field, create_model

from fdd.faults import CATALOGUE, Figure
from fdd.plant.validated import Validated

_FIGURES = [figure for entry in CATALOGUE.values() for figure in entry.figures]


def _field(figure: Figure) -> Any:
    low, high = figure.allowed
    return Annotated[float, Field(ge=low, le=high, description=figure.meaning)], figure.value


if TYPE_CHECKING:

    class _Figures(Validated):
        def __getattr__(self, name: str) -> float: ...
else:  # Of the catalogue, so that a figure stands in its fault's module alone.
    _Figures = create_model("_Figures", __base__=Validated, **{f.name: _field(f) for f in _FIGURES})


class FaultScales(_Figures):
    """Effects of the faults at severity 1; between 0 and 1 they go in proportion.

    Its parameters are the figures of the catalogue, whose modules say what each of them means. Leakages are
    those at the oil's reference temperature, orifice flows those at 1 MPa.

    Examples
    --------
    >>> FaultScales(free_air=0.04).internal_leakage
    1.2e-11
    """

    usual: ClassVar[dict[str, tuple[float, float]]] = {f.name: f.usual for f in _FIGURES if f.usual}
    """Ranges that a campaign draws from, see `fdd.faults.Figure`."""
