"""A proposed map as a file that a person reads on, and the check that it makes sense of the log."""

from __future__ import annotations

import numpy as np
import yaml

from fdd.logs.mapping.behaviour import Signals, follows, gain, rises_with_pumping
from fdd.logs.mapping.proposal import Proposal
from fdd.samples import CHANNELS, Samples


def map_text(proposal: Proposal, name: str, axis: str | None, made_of: str) -> str:
    """The map as YAML, a line a channel with what spoke for it behind.

    Raises
    ------
    InputError : the proposal lacks what a diagnosis needs.
    """
    proposal.channel_map(name, axis)
    head: dict[str, object] = {"schema": "fdd.map/1", "name": name}
    if axis is not None:
        head["axis"] = axis
    lines = [f"# Channel map proposed by fdd map from {made_of}.", *(f"# {n}." for n in proposal.notes)]
    lines += yaml.safe_dump(head, sort_keys=False, allow_unicode=True).splitlines()
    lines.append("channels:")
    for channel in CHANNELS:
        row = proposal.rows.get(channel)
        if row is None:
            continue
        entry = row.source.model_dump(by_alias=True, exclude_defaults=True)
        flow = yaml.safe_dump(entry, default_flow_style=True, sort_keys=False, allow_unicode=True, width=9999)
        lines.append(f"  {channel}: {flow.strip()}  # {100 * row.confidence:.0f} %: {row.why}")
    return "\n".join(lines) + "\n"


def balance_words(samples: Samples) -> list[str]:
    """Whether position, pump and pressures fit together as a cylinder's do, one sentence each.

    Parameters
    ----------
    samples : a log read by the map.
    """
    columns = {n: samples[n] for n in ("position", "pump_angle", "pump_speed") if n in samples}
    data = Signals(samples.time, columns)
    pump, rate = ("pump_speed", True) if "pump_speed" in columns else ("pump_angle", False)
    if float(np.nanmax(columns["position"]) - np.nanmin(columns["position"])) == 0.0:
        return ["the cylinder stands still in this log: nothing shows whether the map is right"]
    along = follows(data, "position", pump) if rate else 0.0
    ratio = gain(data, "position", pump)[0] if rate else 0.0
    t = rises_with_pumping(data, samples["pressure_difference"], "position", pump, rate=rate)
    words = []
    if rate:
        verdict = "as it should" if along > 0.8 else "which is not how a pump moves a cylinder"
        words.append(
            f"the piston moves {ratio * 1e3:.3g} mm a radian of the pump (correlation {along:.2f}), {verdict}"
        )
    if abs(t) > 5.0:
        verdict = "as it should" if t > 0 else "so chambers or signs are the wrong way round"
        words.append(f"pumping {'raises' if t > 0 else 'lowers'} P1 - P2 (t = {t:.0f}), {verdict}")
    else:
        words.append("this log does not show which chamber the pump fills")
    return words
