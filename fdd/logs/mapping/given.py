"""What a user knows of a log: a channel's signal, its unit, and the scale of raw counts."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelSource
from fdd.measures import measure
from fdd.near_misses import did_you_mean
from fdd.samples import CHANNELS

FORM = "CHANNEL=[SIGNAL][*SCALE[+OFFSET]][:UNIT]"
_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = re.compile(
    rf"(?P<signal>.*?)(?:\*(?P<scale>-?{_NUMBER})(?P<offset>[+-]{_NUMBER})?)?(?::(?P<unit>[^:]*))?", re.DOTALL
)


@dataclass(frozen=True)
class Given:
    """What is known of one channel.

    Attributes
    ----------
    signal : its name; "" for no signal at all, None where only the unit is known.
    unit : of ``scale * raw + offset``; None where the file or the proposal tells.
    scale, offset : of the raw number; None without.
    """

    signal: str | None
    unit: str | None = None
    scale: float | None = None
    offset: float = 0.0

    def applied(self, source: ChannelSource) -> ChannelSource:
        """A source with this unit and scale; the sign stays as found, unless the scale has one itself."""
        if self.unit is None:
            return source
        update: dict[str, object] = {"unit": self.unit}
        if self.scale is not None:
            sign = -1 if source.sign < 0 < self.scale else 1
            update |= {"scale": self.scale, "offset": sign * self.offset, "sign": sign}
        elif not source.wrap:
            update["scale"] = 1.0
        return source.model_copy(update=update)


def given_of(options: Iterable[str]) -> dict[str, Given]:
    """Read what a user says of channels, each as ``CHANNEL=[SIGNAL][*SCALE[+OFFSET]][:UNIT]``.

    Raises
    ------
    InputError : no such channel, a scale that is no number or has no unit, or a unit of another dimension.

    Examples
    --------
    >>> given_of(["pressure_1=adc2*0.0625-0.625:bar"])["pressure_1"]
    Given(signal='adc2', unit='bar', scale=0.0625, offset=-0.625)
    >>> given_of(["position=:mm", "motor_current="])["motor_current"].signal
    ''
    """
    out: dict[str, Given] = {}
    for option in options:
        channel, equals, value = option.partition("=")
        if not equals or channel not in ("pressure", *CHANNELS):
            raise InputError(
                f"--set {option}: no channel {channel!r}{did_you_mean(channel, ('pressure', *CHANNELS))}",
                mend=f"write {FORM}, with one of: {', '.join(CHANNELS)}",
            )
        parts = _VALUE.fullmatch(value)
        assert parts is not None  # every text matches, as a name at least
        signal, unit = parts["signal"], parts["unit"]
        scale = float(parts["scale"]) if parts["scale"] else None
        offset = float(parts["offset"]) if parts["offset"] else 0.0
        odd = re.search(r"\*[-+.\d]", signal) is not None or scale == 0.0
        if odd or (scale is not None and not np.isfinite([scale, offset]).all()):
            raise InputError(
                f"--set {option}: the scale is no number other than 0",
                mend="write it like *0.0625-0.625:bar",
            )
        if scale is not None and not unit:
            raise InputError(f"--set {option}: a scale without a unit", mend="add it, e.g. *0.025:mm")
        if unit is not None:
            measure(unit, CHANNELS["pressure_1" if channel == "pressure" else channel].dimension)
        out[channel] = Given(signal if signal or unit is None else None, unit or None, scale, offset)
    return out
