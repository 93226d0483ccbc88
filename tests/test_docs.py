"""The pages of docs/: tutorials and code run, files that are named are there, the site needs no network."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from typer.main import get_command

import fdd
from fdd.cli.app import app
from fdd.faults import CATALOGUE, Fault
from fdd.faults import _problem as problem_of
from fdd.logs.formats import Format
from fdd.plant.details import Details
from fdd.plant.faults import PARAMETERS
from fdd.residuals.added_tracker import TAKEN, Tracker
from fdd.residuals.balances import BALANCES
from fdd.samples import CHANNELS
from fdd.unit import Unit

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf-8")
DOCS = ROOT / "docs"


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted(p.stem for p in (DOCS / "tutorials").glob("*.md")))
def test_a_tutorial_runs_as_it_stands(page: str, tmp_path: Path) -> None:
    """Its shell and its Python, in order, as one script in an empty folder of a clone."""
    if page == "fleet" and not (shutil.which("mosquitto") and shutil.which("curl")):
        pytest.skip("needs mosquitto and curl")
    text = (DOCS / "tutorials" / f"{page}.md").read_text("utf-8")
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```", text, flags=re.M | re.S)
    assert len(blocks) >= 4
    steps = [b if kind == "sh" else f"python - <<'END_OF_PYTHON'\n{b}END_OF_PYTHON\n" for kind, b in blocks]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    script = "set -euo pipefail\ntrap 'kill $(jobs -p) 2> /dev/null || true; wait' EXIT\n" + "\n".join(steps)
    tools = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=os.environ | tools,
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]


def test_a_newcomers_task_needs_three_files_at_most_and_they_are_there() -> None:
    text = (DOCS / "newcomer.md").read_text("utf-8")
    tasks = [line.split(" | ") for line in text.splitlines() if line.startswith("| **")]
    assert len(tasks) == 10
    for most, (task, files) in zip([2] * 4 + [3] * 6, tasks, strict=True):
        named = re.findall(r"`([^`]+)`", files)
        assert 1 <= len(named) <= most and all((ROOT / name).is_file() for name in named), task


def test_the_readme_is_short_and_its_links_lead_somewhere() -> None:
    assert len(README.splitlines()) <= 120
    for target, anchor in re.findall(r"\]\(([^)#:\s]+)(?:#([^)]*))?\)", README):
        assert (ROOT / target).exists(), target
        headings = re.findall(r"^#+ (.*)$", (ROOT / target).read_text("utf-8") if anchor else "", flags=re.M)
        assert not anchor or anchor in [h.lower().replace(" ", "-") for h in headings], (target, anchor)


def commands() -> dict[str, Any]:
    """Each command of the tree by its words, as ``fdd profile new``."""
    found: dict[str, Any] = {}
    waiting = [("fdd", get_command(app))]
    while waiting:
        name, command = waiting.pop()
        if hasattr(command, "commands"):
            waiting += [(f"{name} {each}", below) for each, below in command.commands.items()]
        else:
            found[name] = command
    return found


PAGES = [ROOT / "README.md", *sorted(p for p in DOCS.glob("**/*.md") if p.name != "dropped.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_and_options_that_a_page_shows_are_there(page: Path) -> None:
    text = page.read_text("utf-8").replace("\\\n", " ")
    lines = "".join(re.findall(r"^```(?:sh|text)?\n(.*?)^```", text, flags=re.M | re.S))
    shown = re.findall(r"^(?:[A-Z_]+=\S+ )?(fdd [a-z][^#\n]*)", lines, flags=re.M)
    shown += re.findall(r"`(fdd [a-z][^`\n]*)`", text)
    known = commands()
    for line in shown:
        name = next((n for n in known if f"{line} ".startswith(f"{n} ")), None)
        assert name is not None, line
        options = {o for p in known[name].params for o in p.opts + p.secondary_opts} | {"--help"}
        assert set(re.findall(r"(?<=\s)--?[a-z][a-z-]*", line)) <= options, line


def test_the_channels_of_the_page_on_logs_are_those_of_fdd() -> None:
    table = (DOCS / "logs.md").read_text("utf-8").split("## Channels")[1].split("## ")[0]
    named = re.findall(r"`([a-z_0-9]+)`", table)
    assert sorted(named) == sorted(CHANNELS)


class Loaded(HTMLParser):
    """Addresses that a page loads by itself, unlike links that someone has to follow."""

    TAGS = ("script", "img", "iframe", "source", "embed", "object", "video", "audio", "input")

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in self.TAGS or (tag == "link" and "canonical" not in dict(attrs).values()):
            self.addresses += [v or "" for k, v in attrs if k in ("src", "srcset", "href", "data")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly: a page that is missing or a link that leads nowhere ends it."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", folder],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_the_site_loads_nothing_from_the_network(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        loaded = Loaded()
        loaded.feed(page.read_text("utf-8"))
        assert loaded.addresses
        assert "mermaid" not in page.read_text("utf-8"), "the theme would fetch its script"
        assert not [a for a in loaded.addresses if re.match(r"(https?:)?//", a)], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", sheet.read_text("utf-8")), sheet


@pytest.mark.slow
def test_the_site_is_searched_from_a_disk(site: Path) -> None:
    chromium = shutil.which("chromium") or pytest.skip("no Chromium on this machine")
    flags = ("--headless", "--no-sandbox", "--virtual-time-budget=20000", "--dump-dom")
    page = (site / "index.html").as_uri() + "?q=bulk%20modulus"
    assert subprocess.check_output([chromium, *flags, page], timeout=120).count(b"md-search-result__item") > 5


@pytest.mark.slow
def test_what_links_of_the_site_lead_to_is_there(site: Path) -> None:
    """Pictures and pages, also those that Markdown does not check: HTML, search, styles."""
    for page in site.rglob("*.html"):
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text("utf-8")):
            if page.name != "404.html" and not re.match(r"[a-z]+:", target):
                assert (page.parent / unquote(target)).exists(), f"{page.name}: {target}"


@pytest.mark.slow
def test_every_fault_door_command_and_equation_is_on_its_page(site: Path) -> None:
    faults, reference = ((site / f"{name}.html").read_text("utf-8") for name in ("faults", "reference"))
    for entry in CATALOGUE.values():
        assert f"<code>{entry.id}</code>" in faults, entry.id
    for name in fdd.__all__:
        assert re.search(rf'id="fdd\.[a-z_.]*\b{name}"', reference), name
    reference = (site / "commands.html").read_text("utf-8")
    for name, command in commands().items():
        assert f'id="{name.replace(" ", "-")}"' in reference, name
        section = reference.split(f'id="{name.replace(" ", "-")}"')[1].split("<h2")[0]
        for option in (o for p in command.params if p.param_type_name == "option" for o in p.opts):
            assert option in section, (name, option)
    for name in ("method", "filters"):
        text = (DOCS / f"{name}.md").read_text("utf-8")
        built = (site / f"{name}.html").read_text("utf-8")
        assert built.count("<math") == text.count("```math") + text.count("$`") > 5
        assert "$`" not in built and "```" not in built


BLOCKS = re.findall(r"```python\n(.*?)```", (DOCS / "extending.md").read_text("utf-8"), flags=re.DOTALL)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    def block(number: int) -> dict[str, Any]:
        path = tmp_path / "block.py"
        path.write_text(BLOCKS[number], "utf-8")
        return runpy.run_path(str(path))

    return block


def test_the_fault_could_stand_in_the_catalogue(run) -> None:
    entry = run(0)["FAULT"]
    assert isinstance(entry, Fault) and problem_of(entry, CATALOGUE) == ""
    figures = {figure.name for figure in entry.figures}
    assert figures <= {n for e in entry.effects for n in e.numbers}
    assert not figures & set(Details.model_fields)
    assert {e.parameter for e in entry.effects} <= set(PARAMETERS)
    (columns,) = (s.columns(None) for s in entry.signatures)
    assert all(set(changes) <= set(BALANCES[name].columns) for name, changes in columns.items())


def test_the_format_reads_its_files(run, tmp_path: Path) -> None:
    found = run(1)["FORMAT"]
    assert isinstance(found, Format) and found.sniff(b' {"position"') and not found.sniff(b"time,position")
    path = tmp_path / "a.pairs"
    path.write_text(json.dumps({"position": [0.0, 0.1, None], "pump_speed": [1.0, 2.0, 3.0]}), "utf-8")
    log = found.opener(path)
    np.testing.assert_array_equal(log.read(["position"])["position"], [0.0, 0.1, np.nan])
    assert log.stamps("").tolist() == [0.0, 1e-3, 2e-3] and list(log.signals) == ["position", "pump_speed"]


def test_the_tracker_finds_a_leak_at_the_load_that_it_was_made_for(run) -> None:
    unit = Unit.load("axis_a")
    tracker = run(2)["make"](unit, tuple(TAKEN), 0.01)
    assert isinstance(tracker, Tracker) and {*tracker.inputs, *tracker.measurements} <= set(TAKEN)
    # The pump makes up for a leak of twice the profile's, and the piston stands.
    speed = 2.0 * unit.pump.total_leakage * 1e6 / unit.pump.displacement
    for _ in range(3000):
        tracker.filter.predict(u=np.array([speed]))
        tracker.filter.update(np.array([0.0]))
    leakage = tracker.quantities["leakage"](np.ravel(tracker.filter.x))
    assert leakage == pytest.approx(2.0 * unit.pump.total_leakage, rel=0.02)
