"""File formats of logs: each a module that opens a file as signals with units and clocks."""

from fdd.logs.formats.registry import open_log, suffixes
from fdd.logs.formats.signals import LogFile, Signal

__all__ = ["LogFile", "Signal", "open_log", "suffixes"]
