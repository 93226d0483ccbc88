"""SIGKILL at random instants of starting, working and stopping, while an MQTT sender goes on."""

from __future__ import annotations

import random
import signal
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from evidence.troubles.process import Process, until
from evidence.troubles.senders import Mqtt, blocks_of, leaking
from evidence.troubles.trial import ARRIVED_S, Outcome
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.unit import Unit

WORKS_S, STOPS_S = 1.5, 1.0
"""After its start, and after SIGTERM, within which the kill comes."""


def killed(kills: int, seed: int, progress: Callable[[float], None]) -> Outcome:
    """Kill it so often; what it tells of the run in the end must be what the pipeline says of the whole."""
    rng, blocks = random.Random(seed), blocks_of(leaking())
    when = dict.fromkeys(("starting", "working", "stopping"), 0)
    least, wrong, sent = 0, list[str](), sum(len(b.samples) for b in blocks)
    with tempfile.TemporaryDirectory(prefix="fdd-troubles-") as folder:
        sender = Mqtt(Path(folder))
        process = Process(Path(folder), [sender.source])
        starts_s = process.start()  # makes the session that the broker keeps
        sender.connect()
        try:
            for k in range(kills):
                sender.send(blocks[k * len(blocks) // kills : (k + 1) * len(blocks) // kills])
                process.popen.kill()
                process.popen.wait()
                process.spawn()
                phase = rng.choice(("starting", "working", "working", "stopping"))
                when[phase] += 1
                if phase == "starting":
                    time.sleep(rng.uniform(0.0, starts_s))
                else:
                    until(lambda: process.get("/api/health"), ARRIVED_S)
                    time.sleep(rng.uniform(0.0, WORKS_S))
                    # It may have shown what it was about to store: the broker has that, and sends it again.
                    until(partial(_has, process, least), ARRIVED_S)
                    now = process.samples()
                    if now < least:
                        wrong.append(f"before kill {k + 1} of {kills}: {now} samples, {least} before")
                    least = max(least, now if phase == "stopping" else 0)
                if phase == "stopping":
                    process.popen.send_signal(signal.SIGTERM)
                    time.sleep(rng.uniform(0.0, STOPS_S))
                progress(1.0 / kills)
            process.popen.kill()
            process.popen.wait()
            process.start()
            until(lambda: process.samples() >= sent, ARRIVED_S)
            time.sleep(2.0)
            found = process.samples()
            status = process.end()
        finally:
            process.popen.kill()
            process.popen.wait()
            sender.close()
        findings, actions = process.told()
        whole = [(f.fault, f.onset_s) for f in Pipeline(Unit.load("axis_a"), Model.load()).push(leaking())]
        if findings != whole or actions.count("RAISED") != len(whole) or status != 0:
            wrong.append(f"findings {findings}, without a kill {whole}; {actions}; exit status {status}")
        wrong += [f"its log: {line[:200]}" for line in process.lines("Traceback|internal error")]
    return Outcome(
        f"kill -9, {kills} times", "SIGKILL while " + ", ".join(f"{k} ({n})" for k, n in when.items()),
        "goes on from its checkpoint and journal", sent, sent, sent - found, wrong,
    )  # fmt: skip


def _has(process: Process, samples: int) -> bool:
    return process.samples() >= samples
