"""The pages of docs/: tutorials run, files that are named are there, the site needs no network."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

import fdd
from fdd.faults import CATALOGUE

ROOT = Path(__file__).parents[1]
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
    for task, files in tasks:
        named = re.findall(r"`([^`]+)`", files)
        assert 1 <= len(named) <= 3 and all((ROOT / name).is_file() for name in named), task


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
        assert loaded.addresses and "mermaid" not in page.read_text(
            "utf-8"
        )  # the theme would fetch its script
        assert not [a for a in loaded.addresses if re.match(r"(https?:)?//", a)], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", sheet.read_text("utf-8")), sheet


@pytest.mark.slow
def test_what_links_of_the_site_lead_to_is_there(site: Path) -> None:
    """Pictures and pages, also those that Markdown does not check: HTML, search, styles."""
    for page in site.rglob("*.html"):
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text("utf-8")):
            if page.name != "404.html" and not re.match(r"[a-z]+:", target):
                assert (page.parent / unquote(target)).exists(), f"{page.name}: {target}"


@pytest.mark.slow
def test_every_fault_every_door_and_equation_is_on_its_page(site: Path) -> None:
    faults, reference = ((site / f"{name}.html").read_text("utf-8") for name in ("faults", "reference"))
    for entry in CATALOGUE.values():
        assert f"<code>{entry.id}</code>" in faults, entry.id
    for name in fdd.__all__:
        assert re.search(rf'id="fdd\.[a-z_.]*\b{name}"', reference), name
    for name in ("method", "filters"):
        text = (DOCS / f"{name}.md").read_text("utf-8")
        built = (site / f"{name}.html").read_text("utf-8")
        assert built.count("<math") == text.count("```math") + text.count("$`") > 5
        assert "$`" not in built and "```" not in built
