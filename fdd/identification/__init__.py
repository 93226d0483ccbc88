"""A unit's own profile from its healthy logs: the thesis's chapters 5 and 6."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fdd.identification.identify import identify_unit

__all__ = ["identify_unit"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(name)
    # A diagnosis wants the check of signs alone: what identifies imports a second's worth of scipy.
    from fdd.identification import identify

    return getattr(identify, name)
