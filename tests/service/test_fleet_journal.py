"""What the fleet keeps of accepted blocks: as they came, of many axes at once, and whatever waited."""

from __future__ import annotations

import numpy as np
import pytest
from watched import blocks_of, fleet_of, send

from fdd.errors import InputError
from fdd.samples import Samples
from fdd.service.arrow import arrow_payload
from fdd.service.blocks import Block, Decoder
from fdd.service.store import Store
from fdd.service.store.records import packed, unpacked


def message(block: Block, **more: object) -> bytes:
    """Without its axis, which the topic tells."""
    head = {"schema": "fdd.block/1", "sequence": block.sequence, **more}
    return arrow_payload({"time": block.samples.time, **block.samples.columns}, head)


def test_a_message_is_kept_as_it_came_and_worked_again_from_there(store: Store, log: Samples) -> None:
    messages = [message(block) for block in blocks_of(log)[:32]]
    fleet, inbox, _ = fleet_of(store)
    send(fleet, inbox, [Decoder().decode(m, axis="A1") for m in messages])
    kept = [payload for _, payload in store.journal("A1")]
    assert kept and kept == messages[-len(kept) :]
    again, _, _ = fleet_of(store)
    again.keep()
    assert again.axes()[0].samples == 3200


def test_a_message_that_says_more_than_its_samples_is_not_kept_as_it_came(log: Samples) -> None:
    block = blocks_of(log)[0]
    fat = message(block, note="x" * 100_000)
    stray = arrow_payload(
        {"time": block.samples.time, **block.samples.columns, "stray": block.samples.time},
        {"schema": "fdd.block/1"},
    )
    assert Decoder().decode(message(block), axis="A1").payload is not None
    for given in (fat, stray):
        decoded = Decoder().decode(given, axis="A1")
        assert decoded.payload is None and np.array_equal(decoded.samples.time, block.samples.time)


def test_blocks_of_many_axes_in_one_step_are_all_there_after_a_restart(store: Store, log: Samples) -> None:
    fleet, inbox, _ = fleet_of(store)
    both = zip(blocks_of(log, "A1")[:33], blocks_of(log, "B2")[:33], strict=True)
    for number, (one, other) in enumerate(both):
        inbox.put(one)
        if number % 3:  # not in every step
            inbox.put(other)
        fleet.step(0.0)
    again, _, _ = fleet_of(store)
    again.keep()
    quality = {s.name: s.quality for s in again.axes()}
    held = {name: watch.order.held_samples for name, watch in again._axes.items()}
    assert {s.name: s.samples + held[s.name] for s in again.axes()} == {"A1": 3300, "B2": 2200}
    assert quality["A1"]["missing_blocks"] == 0 and quality["B2"]["missing_blocks"] == 8, "two may still come"


def test_a_state_that_another_version_packed_is_refused_in_one_line() -> None:
    import hashlib
    import zlib

    state = b"state" * 1000
    assert unpacked(*packed(state), where="fdd.db") == state
    old = zlib.compress(state, 1)
    with pytest.raises(InputError, match="of another version of fdd; the axis must start anew"):
        unpacked(old, hashlib.sha256(old).hexdigest(), where="fdd.db")
