"""Which axes a fleet watches, by which profiles, which it lets go, and what it keeps of their blocks."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from watched import blocks_of, fleet_of, passing, send

import fdd
from fdd.diagnosis.model import Model
from fdd.logs import read_log
from fdd.samples import PRESSURES, Samples
from fdd.service.axis import AxisWatch
from fdd.service.blocks import Block, Decoder, arrow_payload
from fdd.unit import Unit


@pytest.mark.parametrize("said", ["rig_3", None])
def test_a_restart_keeps_the_profile(store, log, tmp_path, said):
    """Names of files and of profiles may differ, and one may be called as another's file."""
    for stem, name in {"rig_3": "inner", "inner": "another", "A1": "inner"}.items():
        unit = Unit.load("axis_a").model_copy(update={"name": name})
        (tmp_path / f"{stem}.yaml").write_text(unit.to_yaml(), "utf-8")
    blocks = [replace(b, unit=said) for b in blocks_of(log.rows(0, 2000))]
    fleet = fleet_of(store, units=tmp_path, fallback=None)
    send(fleet, blocks)
    fleet.keep()
    again = fleet_of(store, units=tmp_path, fallback=None)
    assert again.axes()[0].unit == "inner" and again.axes()[0].samples == 2000
    assert not store.audit(), "its state was taken up again"


def test_an_axis_whose_sender_was_mended_is_watched_again(store, log):
    """Eight seconds in millimetres; restarts within the first seconds, which are checked, and after them
    change nothing."""
    wrong = blocks_of(Samples(log.time, {**log.columns, "position": 1000.0 * log["position"]}))
    for part in (wrong[:20], wrong[20:80]):
        fleet = fleet_of(store)
        send(fleet, part)
        fleet.keep()
    assert fleet.axes()[0].state == "failed" and "looks like mm" in fleet.axes()[0].headline
    assert not store.findings() and not store.audit(), "nothing is told of what was in a wrong unit"
    fleet = fleet_of(store)
    assert fleet.axes()[0].state == "failed"
    send(fleet, blocks_of(log)[80:450])
    (status,) = fleet.axes()
    assert status.state == "unacknowledged" and "internal_leakage" in {f["fault"] for f in store.findings()}


def test_pressures_on_another_scale_are_refused(monkeypatch):
    """Of a unit with a baseline: bar as psi passes as a magnitude, and not as this unit's."""
    monkeypatch.setattr("fdd.service.axis.STREAM_S", 5.0)
    demo = Path(fdd.__file__).parent / "demo"
    samples = read_log(demo / "demo.mcap").samples
    sound = samples.rows(0, int(np.searchsorted(samples.time, samples.time[0] + 15.5)))
    wrong = sound.with_columns({c: 0.0689476 * sound[c] for c in PRESSURES if c in sound})
    watch = AxisWatch("A1", Unit.load(demo / "unit.yaml"), Model.load())
    blocks = blocks_of(wrong)
    last = watch.push(*blocks)[-1]
    assert watch.failed is not None and "bar read as psi" in watch.failed
    assert last.time == pytest.approx(15.5, abs=0.2) and not last.standing, "what stood returns"
    later = Samples(sound.time + 20.0, sound.columns)
    watch.push(*blocks_of(later))
    assert watch.failed is None and not watch.standing


def test_an_axis_can_be_removed_and_begins_anew(store, log):
    fleet = fleet_of(store)
    heard = fleet._bus.subscribe(["axis"])
    send(fleet, blocks_of(log)[:450])
    fleet.keep()
    assert store.alarms()[0]["state"] == "UNACK" and store.rollups("A1", "leakage", "minute")
    with ThreadPoolExecutor(1) as others:
        for axis in ("A1", "A2"):
            removing = others.submit(fleet.remove, axis, "ann")
            while not removing.done():
                fleet.step(0.01)
            assert isinstance(removing.exception(), KeyError) == (axis == "A2")
    assert fleet.axes() == [] == store.axes() and store.checkpoint("A1") is None
    assert not store.journal("A1") and not store.rollups("A1", "leakage", "minute")
    assert store.alarms()[0]["state"] == "NORMAL"
    done = [(a["action"], a["who"]) for a in store.audit()]
    assert done[:2] == [("AXIS_REMOVED", "ann"), ("REMOVED", "ann")]
    assert [heard.get().data, heard.get().data][1] == {"removed": True}
    again = fleet_of(store)
    assert again.axes() == []
    send(again, blocks_of(log.rows(0, 1000)))
    again.keep()
    assert again.axes()[0].samples == 1000


def test_strangers_of_one_message_each_leave_the_place_to_others(store, log, monkeypatch, ticking):
    monkeypatch.setattr("fdd.service.fleet.MOST_AXES", 5)
    monkeypatch.setattr("fdd.service.fleet.MOST_REFUSED", 3)
    fleet = fleet_of(store)
    send(fleet, blocks_of(log.rows(0, 6000)))
    for k in range(20):
        send(fleet, [replace(blocks_of(log)[0], axis=f"stranger-{k}")])
    assert len(fleet.axes()) == len(store.axes()) == 5 and "A1" in {s.name for s in fleet.axes()}
    passing(fleet, ticking, *[0.2] * 400)
    assert [s.name for s in fleet.axes()] == ["A1"] == [row["name"] for row in store.axes()]


def test_what_is_refused_for_want_of_a_profile_is_counted_and_told(store, log):
    fleet = fleet_of(store, units={"known": "axis_a"}, fallback=None)
    send(fleet, blocks_of(log, "known")[:5])
    for k in range(120):
        send(fleet, [replace(blocks_of(log)[0], axis=f"A{k}")])
    assert len(fleet.axes()) == 101, "of the names that strangers give the last ones are told"
    assert fleet.axes()[-1].quality == {"refused": 100} and "no profile" in fleet.problems()[0]
    assert fleet.axes()[-1].state == "failed" and "no profile" in fleet.axes()[-1].headline
    assert fleet.axes()[0].name == "known" and fleet.axes()[0].state != "failed"


def test_a_state_of_another_profile_is_put_away(store, log):
    fleet = fleet_of(store)
    send(fleet, blocks_of(log)[:60])
    fleet.keep()
    assert fleet_of(store, units={"A1": "axis_b"}).axes()[0].samples == 0
    assert [a["action"] for a in store.audit()] == ["STATE_DISCARDED"]


@pytest.mark.slow
def test_a_unit_without_baseline_is_learnt_while_it_is_healthy(store, log):
    healthy = blocks_of(log)[:290]
    fleet = fleet_of(store, learn_minutes=0.25)
    send(fleet, healthy[:100])
    assert fleet.axes()[0].state == "silent" and fleet._axes["A1"].unit.baseline is None
    fleet.keep()
    fleet = fleet_of(store, learn_minutes=0.25)
    send(fleet, healthy[100:])
    fleet.keep()
    assert fleet._axes["A1"].unit.baseline is not None, "learnt, over a restart too"
    again = fleet_of(store, learn_minutes=0.25)
    assert again._axes["A1"].unit.to_yaml() == fleet._axes["A1"].unit.to_yaml(), "and not forgotten"
    assert not store.alarms()


def test_a_message_is_kept_as_it_came_unless_it_says_more(store, log):
    def message(block: Block, stray: dict[str, np.ndarray] | None = None, **more: object) -> bytes:
        """Without its axis, which the topic tells."""
        head = {"schema": "fdd.block/1", "sequence": block.sequence, **more}
        return arrow_payload({"time": block.samples.time, **block.samples.columns, **(stray or {})}, head)

    first, messages = blocks_of(log)[0], [message(block) for block in blocks_of(log)[:32]]
    send(fleet_of(store), [Decoder().decode(m, axis="A1") for m in messages])
    kept = [payload for _, payload in store.journal("A1")]
    assert kept and kept == messages[-len(kept) :]
    again = fleet_of(store)
    again.keep()
    assert again.axes()[0].samples == 3200, "worked again from there"
    for given in (message(first, note="x" * 100_000), message(first, {"stray": first.samples.time})):
        decoded = Decoder().decode(given, axis="A1")
        assert decoded.payload is None and np.array_equal(decoded.samples.time, first.samples.time)


def test_blocks_of_many_axes_in_one_step_are_all_there_after_a_restart(store, log):
    fleet = fleet_of(store)
    both = zip(blocks_of(log, "A1")[:33], blocks_of(log, "B2")[:33], strict=True)
    for number, (one, other) in enumerate(both):
        fleet.inbox.put(one)
        if number % 3:  # not in every step
            fleet.inbox.put(other)
        fleet.step(0.0)
    again = fleet_of(store)
    again.keep()
    quality = {s.name: s.quality for s in again.axes()}
    held = {name: watch.order.held_samples for name, watch in again._axes.items()}
    assert {s.name: s.samples + held[s.name] for s in again.axes()} == {"A1": 3300, "B2": 2200}
    assert quality["A1"]["missing_blocks"] == 0 and quality["B2"]["missing_blocks"] == 8, "two may still come"
