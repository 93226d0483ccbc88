"""Pictures of the findings as PNG files, by matplotlib."""

from __future__ import annotations

from pathlib import Path

from evidence.thesis.findings import Finding, Picture
from fdd.files import whole_file, written
from fdd.pictures import STYLE, require_matplotlib

WIDTH_INCHES, DOTS_PER_INCH = 9.0, 100


def draw_picture(picture: Picture, path: Path) -> None:
    """Draw one picture as a PNG of 900 pixels width.

    Raises
    ------
    InputError : it cannot be written, or matplotlib is missing.
    """
    require_matplotlib()
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_INCHES, picture.height), dpi=DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)
        picture.draw(figure)
        with whole_file(path) as temporary:
            # No name of the program in the file: its version would change the bytes.
            figure.savefig(temporary, format="png", metadata={"Software": None})


def draw_all(findings: list[Finding], folder: Path) -> list[Path]:
    """Draw every picture of the findings into a folder, which is made.

    Returns
    -------
    The files, in the findings' order.

    Raises
    ------
    InputError : as `draw_picture`.
    """
    with written(folder):
        folder.mkdir(parents=True, exist_ok=True)
    made = []
    for finding in findings:
        for picture in finding.pictures:
            made.append(folder / f"{picture.name}.png")
            draw_picture(picture, made[-1])
    return made
