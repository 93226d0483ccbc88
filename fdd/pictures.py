"""The look of pictures that matplotlib, an extra of the package, draws."""

from __future__ import annotations

from importlib.util import find_spec

from fdd.errors import InputError

STYLE = {
    "font.size": 10, "axes.grid": True, "grid.color": "0.9", "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": True, "legend.edgecolor": "none", "legend.framealpha": 0.9,
    "legend.fontsize": 9, "lines.markersize": 5,
}  # fmt: skip
"""For `matplotlib.rc_context`."""


def require_matplotlib() -> None:
    """Refuse where matplotlib is missing, and say what to install."""
    if find_spec("matplotlib") is None:
        problem = "matplotlib, which draws the pictures, is not installed"
        raise InputError(problem, mend="install fdd[reports]")
