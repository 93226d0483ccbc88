"""`fdd publish`: what a bad line does to blocks is what was asked for, and a service puts it right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from fdd.cli.app import app
from fdd.logs.tabular_writing import write_parquet
from fdd.samples import Samples
from fdd.service.order import Order
from fdd.service.publishing import Link, sendings
from reports.service import free_port

ROWS = 103
"""Of a block: the first that last 0.1 s or more. Stamps in 1024ths of a second are exact."""
WHOLE = 583
LOG = Samples(
    np.arange(ROWS * WHOLE) / 1024.0, {"position": np.random.default_rng(1).standard_normal(ROWS * WHOLE)}
)


def test_a_plain_line_sends_each_block_when_its_last_row_is_due() -> None:
    sent = sendings("A1", LOG, Link(speed=20.0))
    assert [block.sequence for _, block in sent] == list(range(WHOLE))
    assert [when for when, _ in sent] == pytest.approx([b.samples.time[-1] / 20.0 for _, b in sent])
    assert Samples.concatenate([b.samples for _, b in sent])["position"] == pytest.approx(LOG["position"])
    assert {when for when, _ in sendings("A1", LOG, Link(speed=math.inf))} == {0.0}


@pytest.mark.parametrize("seed", range(5))
def test_a_bad_line_loses_delays_and_swaps_as_asked_and_a_service_puts_it_right(seed: int) -> None:
    link = Link(speed=20.0, jitter=0.05, loss=0.03, shuffle=5, seed=seed)
    sent = sendings("A1", LOG, link)
    assert [(w, b.sequence) for w, b in sent] == [(w, b.sequence) for w, b in sendings("A1", LOG, link)]
    numbers = np.array([b.sequence for _, b in sent])
    assert not np.array_equal(numbers, [b.sequence for _, b in sendings("A2", LOG, link)])
    assert np.unique(numbers).size == numbers.size and 5 <= WHOLE - numbers.size <= 40  # 17 +- 4
    times = np.array([w for w, _ in sent])
    held_up = times - np.array([b.samples.time[-1] for _, b in sent]) / 20.0
    # Held up by the jitter, and by the neighbours behind which it comes.
    assert (
        (np.diff(times) >= 0.0).all()
        and held_up.min() >= 0.0
        and 0.03 < held_up.max() <= 0.05 + 4 * ROWS / 1024.0 / 20.0
    )
    order = Order()
    found = Samples.concatenate([*(order.take([b]) for _, b in sent), order.flush()])
    came = Samples.concatenate([b.samples for _, b in sorted(sent, key=lambda one: one[1].sequence or 0)])
    assert np.array_equal(found.time, came.time) and np.array_equal(found["position"], came["position"])
    assert order.counts["late"] == 0 and order.counts["reordered"] > 100


def test_what_cannot_be_published_is_said_in_a_line(tmp_path: Path) -> None:
    log = tmp_path / "run.parquet"
    columns = dict.fromkeys(("position", "pump_speed"), LOG["position"][:3000])
    write_parquet(log, Samples(LOG.time[:3000], columns | {"pressure_difference": 1e6 * columns["position"]}))
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
