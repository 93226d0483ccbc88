"""``fdd serve``: many axes watched as their samples come; ``fdd publish``: logs sent to it as live blocks."""

from __future__ import annotations

import heapq
import logging
import math
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlsplit

import typer

from fdd.cli import command
from fdd.cli.command import argument, option, require_packages, stopped_by_signals
from fdd.cli.monitor import replay_speed
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.service.config import Serve
    from fdd.service.config_sources import Broker

DEMO = "fdd-demo-"


def serve(
    config: Annotated[Path | None, argument("What is watched: fdd schema serve.", "[SERVE.YAML]")] = None,
    demo: Annotated[
        bool, option("Watch three simulated axes, one of which begins to leak.", "--demo")
    ] = False,
    port: Annotated[int | None, option("Instead of the file's.", min=0, max=65535)] = None,
    check: Annotated[bool, option("Read the file and all that it names, and end.", "--check")] = False,
    token: Annotated[
        str | None,
        option("Make a token of the role view, acknowledge or admin, and its line for the file of tokens.",
               metavar="NAME:ROLE"),
    ] = None,
) -> None:  # fmt: skip
    """Watch many axes: alarms, a page, metrics. Ctrl-C or SIGTERM ends it, and it goes on where it was."""
    require_packages("serve", "sqlalchemy", "fastapi", "uvicorn", "httpx")
    if token is not None:
        _make_token(token)
        return
    if (config is None) == (not demo):
        raise InputError("fdd serve needs a serve.yaml, or --demo", mend="see fdd schema serve for its keys")
    from fdd.service.config import Serve
    from fdd.service.service import Service, check_files

    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO, stream=sys.stderr)
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # which tells its threads
    with ExitStack() as kept:
        settings = _demo(kept.enter_context(_demo_folder())) if config is None else Serve.load(config)
        if port is not None:
            listen = settings.listen.model_copy(update={"port": port})
            settings = settings.model_copy(update={"listen": listen})
        if check:
            check_files(settings)
            many = "1 source" if len(settings.sources) == 1 else f"{len(settings.sources)} sources"
            print(f"{config or 'demo'}: {many}, store {settings.store_url}")
            return
        service, stop = Service(settings), threading.Event()
        with stopped_by_signals(stop):
            service.run(
                stop, lambda: print(f"Watching. Page: {service.address}  (Ctrl-C ends it)", flush=True)
            )


def _make_token(text: str) -> None:
    from fdd.service.tokens import ROLES, new_token

    name, colon, role = text.partition(":")
    if not colon or not name or role not in ROLES:
        mend = f"write NAME:ROLE of {', '.join(ROLES)}"
        raise InputError(f"--token {text!r} is no name and role", mend=mend)
    secret, line = new_token(name, role)
    print(f"Token (shown this once): {secret}")
    print(f"Line for the file of tokens: {line}")


@contextmanager
def _demo_folder() -> Iterator[Path]:
    """A temporary folder, locked while it is used; those that a killed demo has left are removed."""
    import fcntl
    import shutil

    for left in Path(tempfile.gettempdir()).glob(f"{DEMO}*/.lock"):
        with suppress(OSError), left.open("wb") as lock:  # OSError: another user's, or one that is used
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(left.parent, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=DEMO) as folder, (Path(folder) / ".lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield Path(folder)


def _demo(folder: Path) -> Serve:
    """Three flights of the demo's actuator, made now; the second axis leaks after half a minute."""
    from importlib import resources

    from fdd.cli.console import progress
    from fdd.logs.tabular_writing import write_table
    from fdd.plant.scenario import Scenario
    from fdd.plant.simulate import simulate
    from fdd.service.config import Serve
    from fdd.unit import Unit

    profile = folder / "demo.yaml"
    profile.write_text((resources.files("fdd") / "demo" / "unit.yaml").read_text("utf-8"), "utf-8")
    unit = Unit.load(profile)
    leak = {"fault": "internal_leakage", "severity": 0.5, "onset": 30.0}
    text = f"schema: fdd.serve/1\nfallback: {profile}\nsources:\n- type: replay\n  logs:\n"
    with progress("simulating three axes"):
        for seed, name in enumerate(("elevator-left", "elevator-right", "rudder"), 11):
            faults = [leak] if name == "elevator-right" else []
            scenario = Scenario(duration=600.0, duty={"name": "flight"}, faults=faults, seed=seed)
            write_table(folder / f"{name}.parquet", simulate(unit, scenario).samples)
            text += f"    {name}: {name}.parquet\n"
    return Serve.from_yaml(text, where="demo", folder=folder)


def publish(
    logs: Annotated[list[Path], argument("Each becomes an axis of its name.", "LOG...")],
    mqtt: Annotated[
        str, option("Broker: mqtt://[USER@]HOST[:PORT], or mqtts:// with TLS.", metavar="URL")
    ],
    topic: Annotated[str, typer.Option(help="{axis} becomes the axis's name.")] = "fdd/{axis}/blocks",
    map_: command.MapOption = None,
    axis: command.AxisOption = None,
    speed: command.SpeedOption = "1",
    jitter: Annotated[float, typer.Option(min=0.0, help="s that a block is held up at most.")] = 0.0,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of blocks that are never sent.")] = 0.0,
    shuffle: Annotated[
        int, typer.Option(min=1, help="So many neighbours come in any order (fdd serve: up to 5).")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of what comes by chance.")] = 0,
    password_file: Annotated[Path | None, option("Its first line is USER's password.")] = None,
    ca: Annotated[Path | None, option("PEM file of the broker's authority, for mqtts.")] = None,
) -> None:  # fmt: skip
    """Send logs to an MQTT broker as live axes, in blocks of 100 ms: to try fdd serve out, bad lines too."""
    require_packages("serve", "paho")
    import numpy as np

    from fdd.logs import read_log
    from fdd.monitor import pieces
    from fdd.service.blocks import axis_name
    from fdd.service.sources.mqtt import publish as send
    from fdd.service.sources.mqtt import sendings

    broker = broker_of(mqtt, password_file, ca)
    if any(c in topic for c in "+#\0") or not topic:
        raise InputError(f"--topic {topic!r} is no topic to publish on", mend="leave + and # out")
    link = replay_speed(speed) or math.inf, jitter, loss, shuffle, seed
    names = [axis_name(log.stem) for log in logs]
    if len(set(names)) < len(names):
        raise InputError("two logs of one name would be one axis", mend="rename one, or publish them apart")
    sent = []
    for name, path in zip(names, logs, strict=True):
        samples = read_log(path, map_, axis).samples
        mine = sendings(name, samples, *link)
        numbers = np.array([block.sequence for _, block in mine], dtype=np.int64)
        overtaken = int((numbers < np.maximum.accumulate(numbers)).sum())
        whole = sum(1 for _ in pieces(samples))
        print(f"{name}: {len(mine)} of {whole} blocks are sent, {overtaken} of them overtaken", flush=True)
        sent.append(mine)
    stop = threading.Event()
    with stopped_by_signals(stop):
        send(broker, topic, heapq.merge(*sent, key=lambda one: one[0]), stop)


def broker_of(url: str, password_file: Path | None, ca: Path | None) -> Broker:
    """The broker that a URL names."""
    from fdd.service.config_sources import Broker, ClientTls

    try:
        parts = urlsplit(url)
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path or parts.password:
            raise ValueError
        return Broker(
            host=parts.hostname, port=parts.port, user=parts.username, password_file=password_file,
            tls=ClientTls(ca=ca) if parts.scheme == "mqtts" else None,
        )  # fmt: skip
    except ValueError:  # pydantic's too
        mend = "write mqtt://[USER@]HOST[:PORT], or mqtts:// with TLS"
        raise InputError("--mqtt is no URL of a broker", mend=mend) from None
