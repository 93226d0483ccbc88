"""A block comes back as it was or is refused in a line; inbox and bus lose nothing without counting it."""

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fdd.bounds import MOST_AXES, MOST_BLOCK_ROWS
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.samples import Samples
from fdd.service.blocks import Block, Decoder, encode_arrow, encode_json
from fdd.service.queues import Bus, Event, Inbox

HEAD = {"schema": "fdd.block/1", "axis": "A1"}
GOOD = {**HEAD, "sequence": 1, "time": [0.0, 0.1], "columns": {"position": [1, None]}}


def message(**changed: object) -> bytes:
    return json.dumps({**GOOD, **changed}).encode()


def decode(payload: bytes) -> Block:
    return Decoder().decode(payload)


def arrow(columns: dict[str, object], head: object = HEAD, batches: int = 1, **options: object) -> bytes:
    batch = pa.record_batch(columns).replace_schema_metadata(head)
    out = pa.BufferOutputStream()
    with pa.ipc.new_stream(out, batch.schema, options=pa.ipc.IpcWriteOptions(**options)) as writer:
        for _ in range(batches):
            writer.write_batch(batch)
    return out.getvalue().to_pybytes()


values = st.integers(1, 30).flatmap(
    lambda n: arrays(np.float64, (3, n), elements=st.floats(allow_infinity=False, width=64))
)


@given(values=values, number=st.none() | st.integers(0, 2**53 - 1), unit=st.none() | st.just("rig_3"))
def test_a_block_comes_back_as_it_was(values, number, unit):
    time = 1.7e9 + np.arange(values.shape[1]) * 1e-3
    columns = dict(zip(("position", "pump_speed", "pressure_1"), values, strict=True))
    block = Block("line/A-1", Samples(time, columns), number, 0.0, unit)
    for payload in (encode_json(block), encode_arrow(block)):
        found = decode(payload)
        assert (found.axis, found.sequence, found.unit) == (block.axis, number, unit)
        assert np.array_equal(found.samples.time, time)
        for name, column in columns.items():
            assert np.array_equal(found.samples[name], column, equal_nan=True)


SEEDS = [message(), encode_arrow(decode(message()))]
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
block_columns = st.dictionaries(st.sampled_from(["position", "x"]), json_values, max_size=2)
block_times = st.fixed_dictionaries(dict.fromkeys(("start", "period", "n"), json_values)) | json_values
any_messages = st.fixed_dictionaries(
    {}, optional=dict.fromkeys(GOOD, json_values) | {"columns": block_columns, "time": block_times}
)


def block_or_refusal(payload: bytes) -> None:
    try:
        found = decode(payload)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert isinstance(found, Block) and len(found.samples) >= 1


@settings(max_examples=300)
@given(data=st.data())
def test_damaged_messages_are_a_block_or_refused(data):
    payload = bytearray(data.draw(st.sampled_from(SEEDS)))
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(payload) - 1))
        payload[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        if not payload:
            break
    block_or_refusal(bytes(payload))


@settings(max_examples=300)
@given(changed=any_messages)
def test_any_json_is_a_block_or_refused(changed):
    block_or_refusal(message(**changed))


def test_missing_and_infinite_values_are_missing_and_the_topic_says_which_axis():
    text = message(time=[0, 1, 2, 3], columns={"position": [None, float("nan"), float("inf"), 2]})
    assert np.array_equal(decode(text).samples["position"], [np.nan, np.nan, np.nan, 2], equal_nan=True)
    nulls = arrow({"time": [0.0, 1.0], "position": pa.array([None, 0.5], pa.float32())})
    assert np.array_equal(decode(nulls).samples["position"], [np.nan, 0.5], equal_nan=True)
    without = message().replace(b'"axis": "A1", ', b"")
    assert Decoder().decode(without, axis="B2").axis == "B2"
    with pytest.raises(InputError, match="says axis 'A1', its topic 'B2'"):
        Decoder().decode(message(), axis="B2")


def test_a_map_names_columns_and_units():
    text = "time: {column: ms, unit: ms}\nposition: {column: x, unit: mm, sign: -1}"
    rig, columns = Decoder(ChannelMap.from_yaml(text)), {"x": [5, 6], "ms": [1000, 1500], "odd": ["a", {}]}
    found = rig.decode(json.dumps({**HEAD, "columns": columns}).encode())
    assert found.samples.time.tolist() == [1.0, 1.5]
    assert found.samples["position"].tolist() == [-0.005, -0.006] and found.ignored == ("odd",)
    same = rig.decode(arrow({"x": [5.0, 6.0], "ms": [1000.0, 1500.0], "odd": [0.0, 0.0]}))
    assert np.array_equal(same.samples["position"], found.samples["position"]) and same.ignored == ("odd",)


NO_AXES = ("", "../etc", "a/./b", "<script>", "x" * 65, "Ä", "A\n")
NO_NUMBERS = (["1", "2"], [None, "2"], [True, False], [[1], [2]])


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"schema": "fdd.block/2"}, "its schema is not fdd.block/1"),
        ({"sequnce": 3}, "unknown key 'sequnce'"),
        *(({"axis": name}, "no name of an axis") for name in NO_AXES),
        *(({"sequence": number}, "sequence") for number in (-1, 1.5, True, 2**53)),
        ({"unit": 3}, "unit is no name"),
        ({"time": None}, "no time"),
        ({"time": [0.1, 0.0]}, "axis A1: channel time, row 1"),
        ({"time": [0.0, None]}, "not a finite number"),
        ({"time": [0.0]}, "2 values for 1 time stamps"),
        ({"time": {"start": 0, "period": 0.1, "n": MOST_BLOCK_ROWS + 1}}, "time is no object of"),
        ({"time": {"start": 0, "period": -0.1, "n": 2}}, "time must increase"),
        ({"time": {"start": 10**400, "period": 0.1, "n": 2}}, "beyond any number"),
        ({"time": {"start": 0, "period": 0.1, "n": True}}, "time is no object of"),
        ({"columns": {}}, "no channel in the block"),
        ({"columns": {"positon": [1, 2]}}, "no channel in the block"),
        ({"columns": [1]}, "columns is no object"),
        *(({"columns": {"position": values}}, "'position' is no list") for values in NO_NUMBERS),
        ({"time": [], "columns": {"position": []}}, "a block of 0 rows"),
        ({"columns": {f"c{k}": [1, 2] for k in range(300)}}, "at most 256 lists"),
        (arrow({"time": [0.0], "position": [1]}), "'position' is not of float64 or float32"),
        (arrow({"time": np.zeros(5000), "position": np.zeros(5000)}, compression="zstd"), "compressed"),
        (arrow({"time": np.arange(MOST_BLOCK_ROWS + 1.0)}), "rows, at most"),
        (arrow({"time": [0.0], "position": [1.0]}, {"axis": "A"}), "its schema is not"),
        (arrow({"time": [0.0], "position": [1.0]})[:-60], "no Arrow stream"),
        (arrow({"time": [0.0], "position": [1.0]}, batches=2), "more than one"),
    ],
)
def test_what_is_wrong_is_told(wrong, told):
    with pytest.raises(InputError, match=told) as caught:
        decode(wrong if isinstance(wrong, bytes) else message(**wrong))
    assert "\n" not in str(caught.value)


def block(axis: str, number: int, seconds: float = 1.0, **more: object) -> Block:
    time = number * seconds + np.linspace(0.0, seconds, 10, endpoint=False)
    return Block(axis, Samples(time, {"position": time}), number, 0.0, **more)


def test_blocks_come_out_oldest_first_and_in_turn():
    inbox = Inbox()
    for one in (*(block("busy", number) for number in range(5)), block("calm", 0)):
        inbox.put(one)
    taken = inbox.take(0.0)
    assert [b.axis for b in taken[:3]] == ["busy", "calm", "busy"]
    assert [b.sequence for b in taken if b.axis == "busy"] == list(range(5))
    assert inbox.take(0.0) == []


def test_the_axis_that_lags_loses_its_oldest_and_no_other():
    inbox, told = Inbox(most_seconds=3.0), []
    for number in range(8):
        inbox.put(block("slow", number, accepted=lambda n=number: told.append(n)))
    assert inbox.problems() == ["overloaded: the oldest samples are dropped of slow"]
    inbox.put(block("fine", 0))
    counters = {axis: inbox.counters(axis) for axis in ("slow", "fine")}
    assert counters["slow"]["dropped_samples"] == 50
    assert counters["slow"]["lag_s"] == pytest.approx(3.0) and counters["fine"]["dropped_samples"] == 0
    assert [b.sequence for b in inbox.take(0.0) if b.axis == "slow"] == [5, 6, 7]
    assert told == [], "what is not stored is not acknowledged"
    assert inbox.counters("slow")["lag_s"] == 0.0
    short, long = [block("short", n, seconds=0.1) for n in range(2)], [block("long", n) for n in range(6)]
    inbox = Inbox(most_bytes=6 * (block("x", 0).nbytes + 1000))
    for one in (*short, *long):
        inbox.put(one)
    dropped = {axis: inbox.counters(axis)["dropped_samples"] for axis in ("short", "long")}
    assert dropped == {"short": 0, "long": 2 * len(long[0].samples)}


def test_a_patient_sender_waits_for_room_until_the_inbox_is_closed():
    size = block("A1", 0).nbytes + 1000
    inbox, told = Inbox(most_seconds=3.0, most_bytes=5 * size), []

    def send() -> None:
        for number in range(20):
            inbox.put(block("A1", number, patient=True, accepted=lambda n=number: told.append(n)))

    sender = threading.Thread(target=send)
    sender.start()
    taken = inbox.take(5.0)
    while len(taken) < 20:
        taken += inbox.take(5.0)
    sender.join(5.0)
    assert [b.sequence for b in taken] == list(range(20)) and told == []
    one = block("A1", 0, patient=True)
    inbox, told = Inbox(most_seconds=0.5, most_bytes=one.nbytes + 1000), []
    inbox.put(one)
    assert inbox.problems() == ["overloaded: senders wait, more than 0.5 s behind are A1"]
    late = block("A1", 1, patient=True, accepted=lambda: told.append(1))
    sender = threading.Thread(target=inbox.put, args=(late,))
    sender.start()
    inbox.close()
    sender.join(5.0)
    assert not sender.is_alive() and len(inbox.take(0.0)) == 1 and told == []


def test_more_axes_than_a_service_watches_are_refused():
    inbox, one = Inbox(), block("A", 0)
    for number in range(MOST_AXES):
        inbox.put(replace(one, axis=f"A{number}"))
    with pytest.raises(InputError, match="more than 1000 axes"):
        inbox.put(replace(one, axis="one-more"))
    inbox.put(replace(one, axis="A7"))
    patient = threading.Thread(target=inbox.put, args=(replace(one, axis="one-more", patient=True),))
    patient.start()
    assert "one-more" not in {b.axis for b in inbox.take(0.0)}, "not refused either: it waits for a place"
    patient.join(5.0)
    assert not patient.is_alive()


def test_many_threads_put_and_all_is_taken_or_counted():
    inbox, names, each = Inbox(most_seconds=5.0), [f"A{k}" for k in range(6)], 200

    def send(name: str) -> None:
        for number in range(each):
            inbox.put(block(name, number, seconds=0.1))

    taken: list[Block] = []
    with ThreadPoolExecutor(len(names)) as pool:
        sending = [pool.submit(send, name) for name in names]
        while not all(s.done() for s in sending):
            taken += inbox.take(0.2)
    while more := inbox.take(0.0):
        taken += more
    for name in names:
        own = [b for b in taken if b.axis == name]
        assert [b.sequence for b in own] == sorted(b.sequence for b in own)
        dropped = inbox.counters(name)["dropped_samples"]
        assert sum(len(b.samples) for b in own) + dropped == 10 * each


def event(number: int, kind: str = "status") -> Event:
    return Event(kind, "A1", float(number), {})


def test_each_subscriber_hears_its_kinds_in_order_and_a_slow_one_loses_the_oldest():
    bus = Bus()
    bus.publish(event(0))
    every, alarms, slow = bus.subscribe(), bus.subscribe(["alarm"]), bus.subscribe(most=10)
    for number in range(1, 101):
        bus.publish(event(number, "alarm" if number == 2 else "status"))
    assert [every.get().time for _ in range(100)] == [float(k) for k in range(1, 101)]
    assert alarms.get() == event(2, "alarm")
    assert every.get() is alarms.get() is None
    assert (slow.lost, every.lost) == (90, 0) and slow.get() == event(91)


def test_many_threads_publish_and_every_event_arrives_once():
    bus = Bus()
    subscription = bus.subscribe(most=10_000)

    def publish(k: int) -> None:
        bus.subscribe(most=1)
        for n in range(500):
            bus.publish(event(1000 * k + n))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(publish, range(8)))
    heard = [e.time for e in iter(subscription.get, None)]
    assert sorted(heard) == [1000.0 * k + n for k in range(8) for n in range(500)]
    assert subscription.lost == 0
