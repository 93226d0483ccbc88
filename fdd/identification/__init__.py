"""A unit's own profile from its healthy logs: the thesis's chapters 5 and 6."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fdd.identification.identify import identify_unit
    from fdd.identification.profile import Identification

__all__ = ["Identification", "identify_unit"]


def __getattr__(name: str) -> Any:
    # A diagnosis wants the check of signs alone: what identifies imports a second's worth of scipy.
    if name == "identify_unit":
        from fdd.identification.identify import identify_unit

        return identify_unit
    if name == "Identification":
        from fdd.identification.profile import Identification

        return Identification
    raise AttributeError(name)
