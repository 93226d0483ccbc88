"""Records of named numbers, as compiled code reads and writes them."""

from __future__ import annotations

from typing import Annotated, get_args, get_type_hints

import numpy as np

from estimators.linalg import Array

Two = Annotated[Array, 2]


def record_of(described: type) -> np.dtype[np.void]:
    """The NumPy record type with a class's annotated fields, each a float64 or, where `Annotated`, so many.

    A field is an attribute both in Python and in compiled code, and a record is passed on by reference.

    Examples
    --------
    >>> class Chamber:
    ...     area: float
    ...     pressures: Two
    >>> chamber = np.zeros(1, record_of(Chamber))[0]
    >>> chamber.pressures[1] = 3.0
    >>> chamber.area, chamber.pressures
    (np.float64(0.0), array([0., 3.]))
    """
    hints = get_type_hints(described, include_extras=True)
    fields = [(name, "f8", get_args(hint)[1:]) for name, hint in hints.items()]
    return np.dtype((np.record, fields))
