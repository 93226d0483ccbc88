"""Logs in and out: MCAP, CSV and Parquet, channel maps, and the quality of the data."""

from fdd.logs.channel_map import ChannelMap
from fdd.logs.quality import DataQuality
from fdd.logs.read import Log, as_log, read_log

__all__ = ["ChannelMap", "DataQuality", "Log", "as_log", "read_log"]
