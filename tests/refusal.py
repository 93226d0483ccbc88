"""How all that is unusable has to be told."""

from collections.abc import Callable

import pytest

from fdd.errors import InputError


def refused(act: Callable[[], object], longest: int = 1500) -> str:
    """The line of the InputError that `act` must raise."""
    with pytest.raises(InputError) as caught:
        act()
    line = str(caught.value)
    assert len(line.splitlines()) == 1 and "Traceback" not in line and 10 < len(line) < longest
    return line
