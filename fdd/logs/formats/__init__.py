"""File formats of logs: each a module that opens a file as signals with units and clocks.

Installed packages add others as entry points of the group ``fdd.log_formats`` (docs/extending.md).
"""

from fdd.logs.formats.registry import open_log, suffixes
from fdd.logs.formats.signals import Format, LogFile, Signal, require_size

__all__ = ["Format", "LogFile", "Signal", "open_log", "require_size", "suffixes"]
