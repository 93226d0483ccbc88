"""What commands have in common: options, exit statuses, one line on standard error instead of a traceback."""

from __future__ import annotations

import atexit
import gc
import importlib.util
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fdd.engines import Engine
from fdd.errors import InputError
from fdd.files import require_writable, write_text

USAGE, INTERNAL, INTERRUPTED, BROKEN_PIPE, TERMINATED = 2, 70, 130, 141, 143

# Typer exports this one subclass of its usage errors, whichever click it stands on.
UsageError: Any = typer.BadParameter.__mro__[1]


class Commands(TyperGroup):
    """The group of all commands; whatever goes wrong in one of them ends here.

    Exit statuses: 0 done, 2 wrong usage or unusable input, 70 a fault of fdd itself (the
    traceback is shown where ``FDD_DEBUG`` is set), 130 interrupted, 141 broken pipe.
    """

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run and exit with a status, or return it where `standalone_mode` is False."""
        status = self._status(*args, **{"prog_name": "fdd", **extra})
        if not standalone_mode:
            return status
        sys.exit(status)

    def _status(self, *args: Any, **extra: Any) -> int:
        try:
            result = super().main(*args, **{**extra, "standalone_mode": False})
            sys.stdout.flush()
            return result if isinstance(result, int) else 0
        except InputError as error:
            return _told(str(error), USAGE)
        except UsageError as error:
            command = error.ctx.command_path if error.ctx else "fdd"
            return _told(f"{error.format_message().rstrip('.')}; see {command} --help", USAGE)
        except (KeyboardInterrupt, typer.Abort):
            return INTERRUPTED
        except BrokenPipeError:
            _silence_stdout()
            return BROKEN_PIPE
        except MemoryError:
            return _internal("not enough memory for this")
        except Exception as error:
            name = type(error).__name__
            return _internal(f"{name}: {error}" if str(error) else name)


def _told(text: str, status: int, kind: str = "error") -> int:
    print(f"fdd: {kind}: {' '.join(text.split())}", file=sys.stderr)
    return status


def _internal(text: str) -> int:
    if os.environ.get("FDD_DEBUG"):
        import traceback

        traceback.print_exc()
    return _told(text[:500], INTERNAL, "internal error")


def _silence_stdout() -> None:
    """Give the interpreter somewhere to flush what nobody reads any more."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # standard output is no file, as in a test
        return


def prepare_process() -> None:
    """Set the process up for a command: streams that take any text, quiet libraries, a clean SIGTERM."""
    # Matrices here have some ten rows: a second thread only waits for the first, at a third of the time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    if not os.environ.get("FDD_DEBUG"):
        warnings.simplefilter("ignore")
    signal.signal(signal.SIGTERM, _terminated)
    # On its way out the interpreter collects garbage several times over. All of it goes with the process:
    # looking for it takes a twentieth of the time of a minute's log.
    atexit.register(gc.freeze)


def _terminated(number: int, frame: FrameType | None) -> None:
    # Raised as an exit, so that temporary files are cleared away on the way out.
    raise SystemExit(TERMINATED)


@contextmanager
def stopped_by_signals(stop: threading.Event) -> Iterator[None]:
    """Ctrl-C and SIGTERM set `stop`, so that what runs can end in order; a second one ends it at once."""
    numbers, asked = (signal.SIGINT, signal.SIGTERM), False

    def ask(number: int, frame: FrameType | None) -> None:
        # Not by the event's own flag: a second signal while it is being set would wait for its lock for ever.
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        stop.set()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [signal.signal(number, ask) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def option(help: str, *names: str, **more: Any) -> Any:
    """An option for `Annotated`; its default is not shown unless asked for."""
    return typer.Option(*names, help=help, **{"show_default": False, **more})


def argument(help: str, metavar: str | None = None) -> Any:
    """An argument for `Annotated`."""
    return typer.Argument(help=help, metavar=metavar, show_default=False)


UnitOption = Annotated[
    str | None, option("Unit profile: a YAML file or a shipped one (axis_a, axis_b).", "--unit")
]
MapOption = Annotated[Path | None, option("Channel map (YAML) of the logs.", "--map")]
ModelOption = Annotated[Path | None, option("Trained model; the shipped one else.", "--model")]
JsonOption = Annotated[
    str | None, option("Write the answer as JSON; - is standard output.", "--json", metavar="FILE|-")
]
AxisOption = Annotated[str | None, option("Axis of an MCAP file with several.", "--axis")]
ReportOption = Annotated[Path | None, option("Write a page.", "--report", metavar="FILE.html")]
SpeedOption = Annotated[str, typer.Option(help="Times real time, or max.")]
WorkersOption = Annotated[
    int | None, option("Processes for several jobs; one for each core else.", min=1, max=256)
]
EngineOption = Annotated[
    Engine, typer.Option(help="What runs them: this machine, or the Ray cluster that RAY_ADDRESS names.")
]
DatasetArgument = Annotated[Path, argument("Folder that fdd generate made.")]


def require_outputs(json_: str | None, *files: Path | None, inputs: Iterable[Path] = ()) -> None:
    """Refuse outputs before minutes are spent on them."""
    read = {path.resolve() for path in inputs}
    for path in filter(None, (None if json_ in (None, "-") else Path(str(json_)), *files)):
        require_writable(path)
        if path.resolve() in read:
            problem = "would be written over, it is a log to diagnose"
            raise InputError(problem, where=path, mend="name another")


def write_json(target: str | None, text: str) -> None:
    """JSON to a file or, for ``-``, standard output; nowhere for None."""
    if target == "-":
        print(text)
    elif target is not None:
        write_text(target, f"{text}\n")


def require_packages(extra: str, *names: str) -> None:
    """Refuse what an extra is missing for."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise InputError(f"needs the package {name}", mend=f"install fdd[{extra}]")
