"""The picture of error over work."""

from __future__ import annotations

from pathlib import Path

from evidence.plant.speed import Work
from fdd.files import whole_file
from fdd.pictures import require_matplotlib

_MARKERS = {"this plant": "o", "SciPy RK45": "s", "SciPy LSODA": "^", "SciPy Radau": "D"}


def draw_work(work: list[Work], path: Path) -> None:
    """Draw error over processor time, position and pressure side by side, as a PNG.

    Parameters
    ----------
    work : points of every solver.
    path : file.

    Raises
    ------
    InputError : it cannot be written, or matplotlib is missing.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    for place, (quantity, title, unit) in enumerate(
        (("position", "position", "m"), ("pressure", "pressure difference", "Pa")), start=1
    ):
        axes = figure.add_subplot(1, 2, place)
        for solver in dict.fromkeys(point.solver for point in work):
            points = [point for point in work if point.solver == solver]
            axes.loglog(
                [point.cpu for point in points],
                [getattr(point, quantity) for point in points],
                marker=_MARKERS.get(solver, "x"),
                label=solver,
            )
        axes.axvline(1.0, color="0.6", linestyle=":", linewidth=1.0)
        axes.set_xlabel("processor time per second simulated (s); dotted: real time")
        axes.set_ylabel(f"rms error of {title} ({unit})")
        axes.grid(True, which="major", alpha=0.3)
    figure.axes[0].legend()
    with whole_file(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
