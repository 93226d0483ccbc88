"""All troubles tried, and the table of what was said and lost."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from evidence.machine import machine
from evidence.troubles import during, strangers
from evidence.troubles.kills import killed
from evidence.troubles.mistakes import mistakes
from evidence.troubles.process import Process
from evidence.troubles.senders import MOSQUITTO, Mqtt, Tcp, shifted
from evidence.troubles.trial import Outcome, Trouble
from fdd import __version__
from fdd.markdown import table

HOUR_S = 3600.0


@contextmanager
def set_in_the_middle(process: Process, sender: Tcp | Mqtt) -> Iterator[None]:
    """From the middle of the run on its stamps are an hour off."""
    yield


TROUBLES = (
    Trouble("broker restarted", during.broker_away, "not connected", mqtt=True),
    Trouble("disk full", during.full, "disk is full", disk=12),
    Trouble("quota reached", during.no_growth, "cannot be read or written"),
    Trouble("store locked", during.locked, "is locked"),
    Trouble("store's file gone", during.renamed_file, "file is gone"),
    Trouble("state folder gone", during.renamed_folder, "file is gone"),
    Trouble("host's clock ahead", during.clock_ahead),
    Trouble("host's clock back", during.clock_back),
    Trouble(
        "sender's clock ahead", set_in_the_middle, change=lambda b: [*b[:300], *shifted(b[300:], HOUR_S)]
    ),
    Trouble(
        "sender's clock back", set_in_the_middle, change=lambda b: [*b[:300], *shifted(b[300:], -HOUR_S)]
    ),
    Trouble("garbage", strangers.garbage_sent, mqtt=True, more=("tcp", "udp")),
)


def left_out(trouble: Trouble) -> str | None:
    """Why a trouble cannot be tried on this machine; None where it can."""
    if trouble.mqtt and MOSQUITTO is None:
        return "no mosquitto here"
    return "needs root, to mount a small disk" if trouble.disk is not None and os.getuid() != 0 else None


def try_all(
    only: Sequence[str], kills: int, seed: int, progress: Callable[[float], None]
) -> tuple[list[Outcome], dict[str, str]]:
    """What became of each, and what was left out and why.

    Parameters
    ----------
    only : names to try, `mistakes` and `kills` among them; all where empty. kills : how many.
    """
    chosen = [t for t in TROUBLES if not only or t.tried in only]
    without = {t.tried: why for t in chosen if (why := left_out(t)) is not None}
    outcomes = []
    for trouble in chosen:
        if trouble.tried not in without:
            outcomes.append(trouble.attempt())
        progress(0.5 / len(chosen))
    if not only or "mistakes" in only:
        outcomes += mistakes()
    if kills and (not only or "kills" in only):
        if MOSQUITTO is None:
            without["kills"] = "no mosquitto here"
        else:
            outcomes.append(killed(kills, seed, lambda part: progress(0.5 * part)))
    return outcomes, without


def report_text(outcomes: Sequence[Outcome], without: dict[str, str]) -> str:
    """The report as Markdown."""
    tried = [o for o in outcomes if o.sent]
    refused = [o for o in outcomes if not o.sent]
    parts = [
        "# What troubles the service itself, and what is lost",
        "",
        f"Made by `python -m evidence troubles` of fdd {__version__} on {machine()}. "
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
             for o in tried],
            "lllrrrl",
        ),
    ]  # fmt: skip
    if refused:
        said = [[o.tried, _cell(o.said), _verdict(o)] for o in refused]
        parts += ["## Mistakes of users", "", *table(["mistake", "what `fdd serve` said", "verdict"], said)]
    parts += [f"Left out: {name} ({why})." for name, why in without.items()]
    return "\n".join(parts).rstrip() + "\n"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _verdict(outcome: Outcome) -> str:
    return (
        "as it should be"
        if not outcome.wrong and not outcome.lost
        else f"WRONG: {_cell('; '.join(outcome.wrong))}"
    )
