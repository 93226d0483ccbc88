"""A unit's own profile from its healthy logs: the thesis's chapters 5.1 to 5.4, on any rig."""

from fdd.identify.identify import identify_unit
from fdd.identify.profile import Identification, TableRow

__all__ = ["Identification", "TableRow", "identify_unit"]
