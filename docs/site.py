"""What the site takes from elsewhere in the repository: reports, faults, commands, equations as MathML.

MkDocs calls the functions ``on_...`` (``hooks`` in mkdocs.yml).
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from typer.main import get_command

from fdd.cli.app import app
from fdd.faults import ADDED_BY, CATALOGUE, FAMILIES, Fault
from fdd.samples import CHANNELS

ROOT = Path(__file__).parents[1]
PAGES = {"datasets/README.md": "datasets.md", "estimators/README.md": "estimators.md"}
"""Pages that stand beside what they describe, and what they are on the site."""
SOURCES = {page: source for source, page in PAGES.items()}
MOVED = {"README.md": "index.md", **PAGES}
LINK = re.compile(r"\[([^\]]*)\]\((?![a-z]+:)([^)#\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add what stands outside docs/."""
    reports = ROOT / "reports"
    named = PAGES | {f"reports/{p.relative_to(reports).as_posix()}": "" for p in reports.rglob("*")
                     if p.suffix in (".md", ".png")}  # fmt: skip
    for source, page in named.items():
        files.append(File.generated(config, page or source, abs_src_path=str(ROOT / source)))
    files.append(File.generated(config, "faults.md", content=faults_page()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Equations as MathML, links out of docs/ as the site has them, generated tables."""
    markdown = re.sub(r"^```math\n(.*?)^```$", _display, markdown, flags=re.M | re.S)
    # In a span, or an equation that begins a line would be a paragraph.
    markdown = re.sub(r"\$`(.+?)`\$", lambda m: f"<span>{convert(m[1])}</span>", markdown)
    markdown = LINK.sub(lambda m: _link(m, page.file.src_uri), markdown)
    for mark, made in (("channels", channels_table), ("commands", commands_reference)):
        markdown = markdown.replace(f"<!-- {mark} -->", made())
    return markdown


def _display(match: re.Match[str]) -> str:
    return convert(match[1].strip().replace("\n", " "), display="block")


def _link(match: re.Match[str], page: str) -> str:
    """A link as it stands in the repository, as one between the site's pages; other files are named."""
    words, target, anchor = match.groups()
    here = posixpath.dirname(SOURCES.get(page, page if page.startswith("reports/") else f"docs/{page}"))
    file = posixpath.normpath(posixpath.join(here, target))
    there = MOVED.get(file, file.removeprefix("docs/"))
    if file in MOVED or file.startswith(("reports/", "docs/")):
        return f"[{words}]({posixpath.relpath(there, posixpath.dirname(page) or '.')}{anchor or ''})"
    if not (ROOT / file).exists():
        raise ValueError(f"{page}: {match[0]}: there is no {file}")
    return f"`{file}`" if words in file else f"{words} (`{file}`)"


def channels_table() -> str:
    """The channels of `fdd.samples`."""
    rows = [f"| `{c.name}` | {c.unit} | {c.meaning} |" for c in CHANNELS.values()]
    return "\n".join(["| channel | unit | meaning |", "| --- | --- | --- |", *rows])


def commands_reference() -> str:
    """Each command with its arguments, options and defaults, as `--help` prints them."""
    text = []
    for name, command in _commands("fdd", get_command(app)):
        context = command.context_class(command, info_name=name)
        usage, entries = name, []
        for parameter in command.params:
            written, words = parameter.get_help_record(context)
            if parameter.param_type_name == "argument":
                written = written.split(" <")[0]
                usage += f" {written}"
            written = re.sub(r"<(\w+) range>", r"<\1>", written)
            # A default or a bound ends the text in brackets, two blanks before them.
            words = re.sub(r"  \[(.*)\]$", r" (\1)", words)
            entries.append(f"- <code>{_plain(written)}</code> {_plain(words)}")
        text += [f"## {name}\n", f"{command.help}\n", f"```text\n{usage} [OPTIONS]\n```\n", *entries, ""]
    return "\n".join(text)


def _commands(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    if hasattr(command, "commands"):
        for each, below in command.commands.items():
            yield from _commands(f"{name} {each}", below)
    else:
        yield name, command


def _plain(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return re.sub(r"[*_\[\]`]", lambda m: f"&#{ord(m[0])};", escape(text, quote=False))


def faults_page() -> str:
    """The fault catalogue as a page, by families."""
    text = [
        "# Fault catalogue\n",
        "Made from `fdd.faults` when the site is built, so a fault that is added stands here by itself. "
        "Severity 1 is gross; what it means in other sizes of machine, `fdd generate` scales. "
        "`fdd simulate --list-faults` prints the same. Of variants and laws the first is usual; "
        "`--fault pressure_sensor_drift:severity=0.5,law=root` takes another.\n",
    ]
    for family in FAMILIES:
        entries = [f for f in CATALOGUE.values() if f.family == family and f.id != "unknown"]
        if entries:
            text += [f"## {family.replace('_', ' ').capitalize()}\n", *map(_fault, entries)]
    text.append("## Unknown\n\n`unknown` is the answer where no fault explains half of what changed.\n")
    return "\n".join(text)


def _fault(entry: Fault) -> str:
    origin = f"; added by the package {ADDED_BY[entry.id]}" if entry.id in ADDED_BY else ""
    rows = {
        "in the plant": entry.plant
        + ("." if entry.simulated else ", which the simulator does not have.")
        + origin,
        "severity 1": entry.severity,
        "variants": ", ".join(f"`{v}`" for v in entry.variants),
        "laws": "; ".join(f"`{law}`: {words}" for law, words in entry.laws.items()),
        "sides": ", ".join(map(str, entry.sides)),
        "told as": "; ".join(dict.fromkeys(s.label for s in entry.signatures)),
        "next check": entry.next_check,
        "thesis": entry.thesis,
        "scale from": entry.source,
    }
    body = "\n".join(f"| {k} | {v.replace('|', '&#124;')} |" for k, v in rows.items() if v)
    return f"### {entry.title.capitalize()}\n\n`{entry.id}`\n\n| | |\n| --- | --- |\n{body}\n"
