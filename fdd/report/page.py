"""The page: verdict, plots and tables in one HTML file that needs no network."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from datetime import UTC, datetime
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from fdd.diagnosis.findings import Diagnosis, Trajectories
from fdd.files import whole_file
from fdd.report import tables
from fdd.report.plots import sections
from fdd.report.words import span, verdict_words
from fdd.samples import Samples
from fdd.unit import Unit


def render_report(
    diagnosis: Diagnosis,
    trajectories: Trajectories,
    samples: Samples,
    unit: Unit,
    settings: dict[str, str],
    *,
    made: datetime | None = None,
) -> str:
    """The report of one diagnosis as HTML.

    Parameters
    ----------
    diagnosis : the answer.
    trajectories : what is behind it over time (SI).
    samples : the log that was diagnosed.
    unit : the profile it was diagnosed with.
    settings : what the diagnosis was run with, name to value, shown as they are.
    made : when; now, where None.

    Returns
    -------
    One self-contained page, plotly.js included (about 5 MB). Text from the log is
    escaped, and the page's own policy lets nothing but its two scripts run.
    """
    found = sections(diagnosis, trajectories, samples)
    figures = [
        {"id": f.id, "data": f.data, "layout": f.layout, "height": f.height} for s in found for f in s.figures
    ]
    bundle, bundle_hash = _bundle()
    script = _part("page.js")
    return _template().render(
        verdict=verdict_words(diagnosis),
        diagnosis=diagnosis,
        duration=span(diagnosis.duration_s),
        sample_count=tables.grouped(diagnosis.samples),
        made=(made or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M %Z").strip(),
        sections=found,
        probabilities=tables.probability_rows(diagnosis),
        estimates=tables.estimate_rows(diagnosis),
        quality=tables.quality_rows(diagnosis),
        sensors=tables.sensor_rows(diagnosis),
        invisible=tables.invisible_rows(diagnosis),
        unit_rows=tables.unit_rows(unit),
        versions=tables.version_rows(),
        settings=sorted(settings.items()),
        figures=_embedded_json(figures),
        style=Markup(_part("page.css")),
        bundle=bundle,
        script=Markup(script),
        script_hashes=f"'sha256-{bundle_hash}' 'sha256-{_sha256(script)}'",
    )


def write_report(
    path: str | Path,
    diagnosis: Diagnosis,
    trajectories: Trajectories,
    samples: Samples,
    unit: Unit,
    settings: dict[str, str],
) -> None:
    """Write the report whole or not at all; see `render_report`.

    Raises
    ------
    InputError : the folder does not exist or cannot be written to.

    Examples
    --------
    >>> write_report("run.html", diagnosis, trajectories, samples, unit, {})  # doctest: +SKIP
    """
    page = render_report(diagnosis, trajectories, samples, unit, settings).encode("utf-8")
    with whole_file(path) as temporary:
        temporary.write_bytes(page)


def _embedded_json(figures: list[dict[str, Any]]) -> Markup:
    """JSON that cannot end the script element that holds it."""
    text = json.dumps(figures, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _unbroken(text: str) -> str:
    """The text with numbers kept on one line with the unit that follows."""
    return re.sub(r"(?<=\d) (?=(?:%|s|min|h)\b|%)", "\u00a0", text)


@lru_cache(maxsize=1)
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["unbroken"] = _unbroken
    return environment.from_string(_part("page.html.j2"))


@lru_cache(maxsize=4)
def _part(name: str) -> str:
    suffix = "" if name.endswith(".j2") else ".j2"
    return (resources.files("fdd.report") / f"{name}{suffix}").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _bundle() -> tuple[Markup, str]:
    """plotly.js and its hash. `plotly.offline` would import the figure classes, which takes a second."""
    text = (resources.files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    # As HTML defines scripts, only these can change where one ends; both stand in strings or comments.
    text = text.replace("</script", "<\\/script").replace("<!--", "<\\!--").replace("\r", "")
    return Markup(text), _sha256(text)


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
