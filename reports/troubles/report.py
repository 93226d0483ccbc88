"""``python -m reports troubles``: faults of the service's own, tried on the real `fdd serve`."""

from __future__ import annotations

import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.console import progress
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.markdown import table
from fdd.unit import Unit
from reports.service import MOSQUITTO, until
from reports.troubles import during
from reports.troubles.trial import ARRIVED_S, Mqtt, Outcome, Trouble, blocks_of, leaking, process_in, shifted
from reports.writing import FOLDER, OutOption, made_by, require_folder, write_report

HOUR_S = 3600.0
TROUBLES = (
    Trouble("broker restarted", during.broker_away, "not connected", mqtt=True),
    Trouble("disk full", during.full, "disk is full", disk=12),
    Trouble("quota reached", during.no_growth, "cannot be read or written"),
    Trouble("store locked", during.locked, "is locked"),
    Trouble("store's file gone", during.renamed_file, "file is gone"),
    Trouble("host's clock ahead", during.clock_ahead),
    Trouble("host's clock back", during.clock_back),
    Trouble(
        "sender's clock ahead",
        during.set_in_the_middle,
        change=lambda b: [*b[:300], *shifted(b[300:], HOUR_S)],
    ),
    Trouble(
        "sender's clock back",
        during.set_in_the_middle,
        change=lambda b: [*b[:300], *shifted(b[300:], -HOUR_S)],
    ),
)


WORKS_S, STOPS_S = 1.5, 1.0
"""After its start, and after SIGTERM, within which the kill comes."""


def killed(kills: int, seed: int, progress: Callable[[float], None]) -> Outcome:
    """Kill it so often; what it tells of the run in the end must be what the pipeline says of the whole."""
    rng, blocks = random.Random(seed), blocks_of(leaking())
    when = dict.fromkeys(("starting", "working", "stopping"), 0)
    least, wrong, sent = 0, list[str](), sum(len(b.samples) for b in blocks)
    with tempfile.TemporaryDirectory(prefix="fdd-troubles-") as folder:
        sender = Mqtt(Path(folder))
        process = process_in(Path(folder), [sender.source])
        starts_s = process.start()  # makes the session that the broker keeps
        sender.connect()
        try:
            for k in range(kills):
                sender.send(blocks[k * len(blocks) // kills : (k + 1) * len(blocks) // kills])
                process.kill()
                process.spawn()
                phase = rng.choice(("starting", "working", "working", "stopping"))
                when[phase] += 1
                if phase == "starting":
                    time.sleep(rng.uniform(0.0, starts_s))
                else:
                    until(lambda: process.get("/api/health"), ARRIVED_S)
                    time.sleep(rng.uniform(0.0, WORKS_S))
                    # It may have shown what it was about to store: the broker has that, and sends it again.
                    until(lambda least=least: process.samples() >= least, ARRIVED_S)  # type: ignore[misc]
                    now = process.samples()
                    if now < least:
                        wrong.append(f"before kill {k + 1} of {kills}: {now} samples, {least} before")
                    least = max(least, now if phase == "stopping" else 0)
                if phase == "stopping":
                    process.popen.send_signal(signal.SIGTERM)
                    time.sleep(rng.uniform(0.0, STOPS_S))
                progress((k + 1) / kills)
            process.kill()
            process.start()
            until(lambda: process.samples() >= sent, ARRIVED_S)
            time.sleep(2.0)
            found = process.samples()
            status = process.end()
        finally:
            process.kill()
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


def left_out(trouble: Trouble) -> str | None:
    """Why a trouble cannot be tried on this machine; None where it can."""
    if trouble.mqtt and MOSQUITTO is None:
        return "no mosquitto here"
    return "needs root, to mount a small disk" if trouble.disk is not None and os.getuid() != 0 else None


def troubles(
    out: OutOption = FOLDER,
    kills: Annotated[int, typer.Option(min=0, max=10_000, help="SIGKILLs; 0 leaves them out.")] = 500,
    seed: Annotated[int, typer.Option(min=0, max=10_000, help="Of the instants of the kills.")] = 7,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="This one, or `kills`; may be repeated.")
    ] = None,
) -> None:
    """Try every trouble of the service itself, and report what was said and lost (Linux, some need root)."""
    require_folder(out)
    known = {*(t.tried for t in TROUBLES), "kills"}
    wanted = set(only or known)
    if unknown := wanted - known:
        raise InputError(f"no trouble {min(unknown)!r}", mend=f"give one of {', '.join(sorted(known))}")
    without, outcomes = {}, []
    with progress("troubling the service", 1.0) as advance:
        for number, trouble in enumerate(TROUBLES, 1):
            if trouble.tried in wanted and (why := left_out(trouble)):
                without[trouble.tried] = why
            elif trouble.tried in wanted:
                outcomes.append(trouble.attempt())
            advance(0.5 * number / len(TROUBLES))
        if kills and "kills" in wanted and MOSQUITTO is None:
            without["kills"] = "no mosquitto here"
        elif kills and "kills" in wanted:
            outcomes.append(killed(kills, seed, lambda share: advance(0.5 + 0.5 * share)))
    wrong = [o.tried for o in outcomes if o.wrong or o.lost]
    told = "".join(f"; not {name}" for name in wrong)
    print(f"{len(outcomes) - len(wrong)} of {len(outcomes)} as they should be{told}")
    write_report(out / "troubles.md", report_lines(outcomes, without))


def report_lines(outcomes: Sequence[Outcome], without: dict[str, str]) -> list[str]:
    """The report as Markdown."""
    lines = [
        "# What troubles the service itself, and what is lost",
        "",
        f"{made_by('troubles')}. "
        "Each is tried on the real `fdd serve`: a run of a minute that "
        "leaks from its middle on is sent, a third before the trouble, a third while it lasts, a third after "
        "it; then the service is killed (SIGKILL) and started again. *Accepted* are the samples it had taken "
        "before the kill, *lost* those of them that are not there after it. The leak must be found and its "
        "alarm raised once, health must say what is wrong and then nothing, and page, API and metrics must "
        "answer meanwhile.",
        "",
        *table(
            ["tried", "how", "what the service said", "sent", "accepted", "lost", "verdict"],
            [[o.tried, _cell(o.how), _cell(o.said), str(o.sent), str(o.accepted), str(o.lost), _verdict(o)]
             for o in outcomes],
            "lllrrrl",
        ),
    ]  # fmt: skip
    return lines + [f"Left out: {name} ({why})." for name, why in without.items()]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _verdict(outcome: Outcome) -> str:
    if outcome.wrong or outcome.lost:
        return f"WRONG: {_cell('; '.join(outcome.wrong))}"
    return "as it should be"
