"""``fdd serve``: many axes watched as their samples come."""

from __future__ import annotations

import logging
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fdd.cli.failures import stopped_by_signals
from fdd.cli.options import EngineOption, argument, option, require_packages
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.service.config import Serve

DEMO = "fdd-demo-"


def serve(
    config: Annotated[Path | None, argument("What is watched: fdd schema serve.", "[SERVE.YAML]")] = None,
    demo: Annotated[
        bool, option("Watch three simulated axes, one of which begins to leak.", "--demo")
    ] = False,
    port: Annotated[int | None, option("Instead of the file's.", min=0, max=65535)] = None,
    engine: EngineOption = "local",
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
    from fdd.service.service import Service

    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO, stream=sys.stderr)
    with ExitStack() as kept:
        if demo:
            settings = _demo(kept.enter_context(_demo_folder()))
        else:
            assert config is not None
            settings = Serve.load(config)
        if port is not None:
            listen = settings.listen.model_copy(update={"port": port})
            settings = settings.model_copy(update={"listen": listen})
        if engine == "ray":
            from fdd.service.shards import part_of
            from fdd.service.watch import Share

            part_of(settings, Share(0, settings.shards))
        if check:
            from fdd.service.watch import check as check_files

            check_files(settings)
            many = "1 source" if len(settings.sources) == 1 else f"{len(settings.sources)} sources"
            print(f"{config or 'demo'}: {many}, store {settings.store_url}")
            return
        service = Service(settings, engine)
        stop = threading.Event()
        with stopped_by_signals(stop):
            service.run(
                stop, lambda: print(f"Watching. Page: {service.address}  (Ctrl-C ends it)", flush=True)
            )


def _make_token(text: str) -> None:
    from fdd.service.http.tokens import ROLES, new_token

    name, colon, role = text.partition(":")
    if not colon or not name or role not in ROLES:
        raise InputError(
            f"--token {text!r} is no name and role", mend=f"write NAME:ROLE of {', '.join(ROLES)}"
        )
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
    from fdd.logs.tabular_writing import write_parquet
    from fdd.plant.scenario import Scenario
    from fdd.plant.simulate import simulate
    from fdd.service.config import Serve
    from fdd.unit import Unit

    profile = folder / "demo.yaml"
    profile.write_text((resources.files("fdd") / "demo" / "unit.yaml").read_text("utf-8"), "utf-8")
    unit = Unit.load(profile)
    leak = {"fault": "internal_leakage", "severity": 0.5, "onset": 30.0}
    names = ("elevator-left", "elevator-right", "rudder")
    with progress("simulating three axes"):
        for seed, name in enumerate(names, 11):
            faults = [leak] if name == "elevator-right" else []
            scenario = Scenario(duration=600.0, duty={"name": "flight"}, faults=faults, seed=seed)
            write_parquet(folder / f"{name}.parquet", simulate(unit, scenario).samples)
    logs = "\n".join(f"    {name}: {name}.parquet" for name in names)
    text = f"schema: fdd.serve/1\nfallback: {profile}\nsources:\n- type: replay\n  logs:\n{logs}\n"
    return Serve.from_yaml(text, where="demo", folder=folder)
