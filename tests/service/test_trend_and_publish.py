"""Trends from a store, and `fdd publish`: what was put in comes out, and a bad line is as asked."""

import math
import time
from contextlib import closing

import numpy as np
import pytest
from typer.testing import CliRunner

from fdd.cli.app import app
from fdd.diagnosis.estimates import healthy_of
from fdd.history.trend import severity_one, trend_of
from fdd.logs.tabular_writing import write_table
from fdd.samples import Samples
from fdd.service.alarms import AlarmBook
from fdd.service.sources.mqtt import sendings
from fdd.service.status import HEALTHY_LEAKAGE, LEAKAGE_FACTOR, answers_of, sentence_of
from fdd.service.store import Rollup, Store, profile_key
from fdd.unit import Unit
from reports.service import free_port
from tests.service.senders import LEAK, ordered

DAYS, LOOKS = 40, 30
UNIT = Unit.load("axis_a").model_copy(update={"name": "rig7"})
GROWTH = 0.5
"""Of the healthy leakage, over all days."""
ALARM_DAY = 35


@pytest.fixture(scope="module")
def begin() -> float:
    return (time.time() // 86400.0 - DAYS) * 86400.0


@pytest.fixture(scope="module")
def url(tmp_path_factory, begin) -> str:
    """Forty days of an axis whose leakage grows straight while its oil's temperature goes up and down: the
    healthy leakage by two thirds within a day, and from day to day."""
    url = f"sqlite:///{tmp_path_factory.mktemp('state') / 'fdd.db'}"
    rng, healthy, store = np.random.default_rng(3), healthy_of(UNIT), Store(url)
    book = AlarmBook()
    with store.transaction() as t:
        for day in range(DAYS):
            t.axis("A1", begin, unit="rig7", profile_sha256="7")
            season = rng.normal(0.0, 0.2)
            for look in range(LOOKS):
                wall = begin + 86400.0 * (day + look / LOOKS)
                warm = math.exp(season + 0.4 * math.sin(2 * math.pi * look / LOOKS)) * healthy["leakage"]
                factor = 1.0 + GROWTH * (day + look / LOOKS) / DAYS + rng.normal(0.0, 0.01)
                values = {"leakage": (factor * warm, 0.02 * warm), HEALTHY_LEAKAGE: (warm, 0.0)}
                values[LEAKAGE_FACTOR] = (factor, 0.02)
                stiff = healthy["bulk_modulus"]
                values["bulk_modulus"] = (stiff * rng.normal(1.0, 0.01), 0.01 * stiff)
                t.rollup(*(Rollup("A1", n, wall, 1, v, s, v, v) for n, (v, s) in values.items()))
        t.meta(profile_key("7"), UNIT.to_yaml())
        for transition in book.update("A1", 15.0, begin + (ALARM_DAY + 0.5) * 86400.0, [LEAK]):
            t.transition(transition)
    store.close()
    return url


def test_the_slope_that_was_put_in_comes_out_by_days_and_the_page_says_the_same(url, begin):
    with closing(Store(url)) as store:
        found, _ = trend_of(answers_of(store, "A1", UNIT, "day"), severity_one(UNIT), "day")
        asked = sentence_of(store, "A1", "leakage", "day", 0.0)
        for axis, quantity in (("A1", "probability_of_a_fault"), ("B2", "leakage")):
            assert sentence_of(store, axis, quantity, "day", 0.0) == ""
    life = found.model_dump(mode="json")
    assert (life["unit"], life["axis"], life["each"], len(life["logs"])) == ("rig7", "A1", "day", DAYS)
    leakage, stiff = life["trends"]
    assert asked == leakage["sentence"]
    low, high = leakage["slope_interval"]
    assert low < GROWTH / DAYS < high < 1.4 * GROWTH / DAYS and leakage["direction"] == "rises"
    wanted = np.hypot(0.02, 0.01)  # what each look errs by itself, and what they scatter by
    assert [p["std"] for p in leakage["points"]] == pytest.approx([wanted] * DAYS, rel=0.15)
    at = (leakage["limit"] - 1.0 - GROWTH) / (GROWTH / DAYS)  # from the last day's middle
    least, most = leakage["until_limit_interval"]
    assert least < at < most and leakage["limit"] > 1.5
    assert stiff["direction"] is None and stiff["last"] == pytest.approx(1.0, abs=0.01)
    marked = [x["log"] for x in life["logs"] if x["faults"]]
    first = time.strftime("%Y-%m-%d", time.gmtime(begin + ALARM_DAY * 86400.0))
    assert marked[0] == first and len(marked) == DAYS - ALARM_DAY, "it still stands"
    assert life["logs"][0]["log"] == time.strftime("%Y-%m-%d", time.gmtime(begin))


ROWS = 103
"""Of a block: the first that last 0.1 s or more. Stamps in 1024ths of a second are exact."""
WHOLE = 583
POSITION = np.random.default_rng(1).standard_normal(ROWS * WHOLE)
LOG = Samples(np.arange(ROWS * WHOLE) / 1024.0, {"position": POSITION})


def test_a_plain_line_sends_each_block_when_its_last_row_is_due():
    sent = sendings("A1", LOG, 20.0)
    assert [block.sequence for _, block in sent] == list(range(WHOLE))
    assert [when for when, _ in sent] == pytest.approx([b.samples.time[-1] / 20.0 for _, b in sent])
    assert Samples.concatenate([b.samples for _, b in sent])["position"] == pytest.approx(LOG["position"])
    assert {when for when, _ in sendings("A1", LOG, math.inf)} == {0.0}


@pytest.mark.parametrize("seed", range(5))
def test_a_bad_line_loses_delays_and_swaps_as_asked_and_a_service_puts_it_right(seed):
    link = 20.0, 0.05, 0.03, 5, seed
    sent = sendings("A1", LOG, *link)
    assert [(w, b.sequence) for w, b in sent] == [(w, b.sequence) for w, b in sendings("A1", LOG, *link)]
    numbers = np.array([b.sequence for _, b in sent])
    assert not np.array_equal(numbers, [b.sequence for _, b in sendings("A2", LOG, *link)])
    assert np.unique(numbers).size == numbers.size and 5 <= WHOLE - numbers.size <= 40  # 17 +- 4
    times = np.array([w for w, _ in sent])
    held_up = times - np.array([b.samples.time[-1] for _, b in sent]) / 20.0
    # Held up by the jitter, and by the neighbours behind which it comes.
    assert (np.diff(times) >= 0.0).all() and held_up.min() >= 0.0
    assert 0.03 < held_up.max() <= 0.05 + 4 * ROWS / 1024.0 / 20.0
    found, order = ordered(block for _, block in sent)
    came = Samples.concatenate([b.samples for _, b in sorted(sent, key=lambda one: one[1].sequence or 0)])
    assert np.array_equal(found.time, came.time) and np.array_equal(found["position"], came["position"])
    assert order.counts["late"] == 0 and order.counts["reordered"] > 100


def test_what_cannot_be_published_is_said_in_a_line(tmp_path):
    log = tmp_path / "run.parquet"
    columns = dict.fromkeys(("position", "pump_speed"), LOG["position"][:3000])
    write_table(log, Samples(LOG.time[:3000], columns | {"pressure_difference": 1e6 * columns["position"]}))
    away = f"mqtt://127.0.0.1:{free_port()}"
    for arguments, words in (
        ([log, "--mqtt", away], "cannot be reached"),
        ([log, "--mqtt", "http://localhost"], "mqtt://[USER@]HOST[:PORT]"),
        ([log, "--mqtt", "mqtt://ann:secret@localhost"], "no URL of a broker"),
        ([log, "--mqtt", "mqtt://localhost:99999"], "no URL of a broker"),
        ([log, "--mqtt", away, "--topic", "a/+/b"], "--topic"),
        ([log, log, "--mqtt", away], "two logs of one name"),
        ([log, "--mqtt", away, "--speed", "0"], "--speed"),
        ([tmp_path / "a b.csv", "--mqtt", away], "no name of an axis"),
        ([log, "--mqtt", "mqtts://localhost", "--ca", tmp_path / "none.pem"], "TLS cannot be set up"),
        ([log, "--mqtt", f"mqtt://ann@{away[7:]}", "--password-file", tmp_path / "none"], "password"),
    ):
        done = CliRunner().invoke(app, ["publish", *map(str, arguments)])
        told = done.stderr.strip().splitlines()
        assert done.exit_code == 2 and len(told) == 1 and words in told[0], (arguments, done.output)
        assert "secret" not in told[0]
