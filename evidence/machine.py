"""What a report was measured on."""

from __future__ import annotations

import os
import platform


def machine() -> str:
    """What it was measured on."""
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def load_now() -> str:
    """How busy the machine was, as the end of a sentence."""
    try:
        load = os.getloadavg()[0]
    except OSError:
        return "load unknown."
    return f"load average {load:.1f} at the end of the run."
