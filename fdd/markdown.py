"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_RULES = {"l": "---", "r": "---:"}


def table(head: Sequence[str], rows: Iterable[Sequence[str]], sides: str = "l") -> list[str]:
    """Lines of a table, an empty one last.

    `sides` says where columns' cells stand, ``l`` or ``r`` (numbers); the last letter holds for the rest.

    Examples
    --------
    >>> table(["fault", "logs"], [["aeration", "12"]], "lr")
    ['| fault | logs |', '| --- | ---: |', '| aeration | 12 |', '']
    """
    rule = [_RULES[side] for side in sides.ljust(len(head), sides[-1])]
    return ["| " + " | ".join(line) + " |" for line in (head, rule, *rows)] + [""]
