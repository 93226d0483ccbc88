"""Options that several commands share, and what is refused before minutes are spent."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from fdd.engines import Engine
from fdd.errors import InputError
from fdd.files import require_writable, write_text


def option(help: str, *names: str, **more: Any) -> Any:
    """An option for `Annotated`; its default is not shown unless asked for."""
    return typer.Option(*names, help=help, **{"show_default": False, **more})


def argument(help: str, metavar: str | None = None) -> Any:
    """An argument for `Annotated`."""
    return typer.Argument(help=help, metavar=metavar, show_default=False)


def faults(incomplete: str) -> list[tuple[str, str]]:
    """Ids of the catalogue's faults with their titles, as the shell offers them."""
    from fdd.faults import CATALOGUE

    return [(name, fault.title) for name, fault in CATALOGUE.items() if name.startswith(incomplete)]


def units(incomplete: str) -> list[str]:
    """Shipped profiles; where none fits the shell offers files."""
    from importlib import resources

    names = (file.name.partition(".yaml")[0] for file in (resources.files("fdd") / "units").iterdir())
    return sorted(name for name in names if name.startswith(incomplete))


UnitOption = Annotated[
    str | None,
    option("Unit profile: a YAML file or a shipped one (axis_a, axis_b).", "--unit", autocompletion=units),
]
MapOption = Annotated[Path | None, option("Channel map (YAML) of the logs.", "--map")]
ModelOption = Annotated[Path | None, option("Trained model; the shipped one else.", "--model")]
JsonOption = Annotated[
    str | None, option("Write the answer as JSON; - is standard output.", "--json", metavar="FILE|-")
]
AxisOption = Annotated[str | None, option("Axis of an MCAP file, or a store, with several.", "--axis")]
ReportOption = Annotated[Path | None, option("Write a page.", "--report", metavar="FILE.html")]
FolderOption = Annotated[
    Path | None,
    option("Folder for all of it: index.html with its tables, as CSV and JSON too, and reports.",
           "--output", "-o", metavar="DIR"),
]  # fmt: skip
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
