"""What all reports share: where they are written, on which machine, and how their pictures are drawn."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from fdd import __version__
from fdd.errors import InputError
from fdd.files import require_writable, whole_file, write_text, written

FOLDER = Path("reports")
STYLE = {
    "font.size": 10, "axes.grid": True, "grid.color": "0.9", "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": True, "legend.edgecolor": "none", "legend.framealpha": 0.9,
    "lines.markersize": 5,
}  # fmt: skip
"""Of all pictures, for `matplotlib.rc_context`."""
OutOption = Annotated[Path, typer.Option("--out", "-o", help="Folder of the report and its pictures.")]


def made_by(command: str) -> str:
    """With what, and on which machine, a report was made."""
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"Made by `python -m reports {command}` of fdd {__version__} on {machine}"


def load_now() -> str:
    """How busy the machine was, as the end of a sentence."""
    return f"load average {os.getloadavg()[0]:.1f} at the end of the run."


def timed(run: Callable[[], object]) -> float:
    """s of processor time."""
    began = time.process_time()
    run()
    return time.process_time() - began


def require_folder(out: Path, *, pictures: bool = False) -> None:
    """Refuse (`InputError`) before anything is measured what cannot be written or drawn after it."""
    require_writable(out, folder=True)
    if pictures and find_spec("matplotlib") is None:
        problem = "matplotlib, which draws the pictures, is not installed"
        raise InputError(problem, mend="install fdd[reports]")


def write_report(path: Path, text: str) -> None:
    """Write a report (Markdown) and say where it is."""
    with written(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text.rstrip() + "\n")
    print(f"Written to {path}")


def render(path: Path, block: str = "", /, **figures: Any) -> str:
    """A report's text, or a block of it, from a Jinja template with what was measured.

    ``{{ x|f(".1f") }}`` formats a number, ``number`` by its significant digits; ``cell`` is one of a table.
    """
    environment = Environment(
        loader=FileSystemLoader(path.parent), extensions=["jinja2.ext.do"], undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"f": format, "number": number_text, "cell": _cell}
    page = environment.get_template(path.name)
    return "".join(page.blocks[block](page.new_context(figures))) if block else page.render(figures)


def number_text(number: float, digits: int = 3) -> str:
    """A number with its significant digits, without an exponent, never ``-0``."""
    if number != number or number == 0.0:
        return "0" if number == 0.0 else "none"
    return format(Decimal(f"{number:.{digits - 1}e}"), "f")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


Curve = tuple[Any, Any, str, str | None]
"""x, y, matplotlib's format string, and label: None for no entry in the legend."""


@dataclass(frozen=True)
class Panel:
    """One panel of a picture; `settings` are those of ``Axes.set``, `at_x` and `at_y` lines across it."""

    curves: Sequence[Curve]
    settings: Mapping[str, Any]
    at_x: Mapping[float, str] = field(default_factory=dict)
    at_y: Mapping[float, str] = field(default_factory=dict)


def draw(path: Path, panels: Sequence[Panel], *, columns: int = 1, height: float = 4.2) -> None:
    """Draw panels, row by row, as a PNG of 900 pixels width; all of a column have one x axis."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.0, height), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        places = figure.subplots(len(panels) // columns, columns, sharex="col", squeeze=False).flat
        for axes, panel in zip(places, panels, strict=True):
            for x, y, style, label in panel.curves:
                axes.plot(x, y, style, label=label, linewidth=1.2, markersize=4)
            for value, label in panel.at_x.items():
                axes.axvline(value, color="k", linestyle=":", linewidth=1.0, label=label)
            for value, label in panel.at_y.items():
                axes.axhline(value, color="k", linestyle="--", linewidth=1.0, label=label)
            axes.set(**panel.settings)
            axes.legend(fontsize=8)
        with written(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            # No name of the program in the file: its version would change the bytes.
            figure.savefig(temporary, format="png", metadata={"Software": None})
