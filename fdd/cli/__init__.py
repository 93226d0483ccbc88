"""The command line: one module a command, thin over the library.

Nothing here imports NumPy or anything heavier before a command runs, so that ``fdd --help``
answers at once.
"""

from __future__ import annotations


def main() -> None:
    """Run ``fdd``; the entry point of the installed script."""
    from fdd.cli.app import app
    from fdd.cli.command import prepare_process

    prepare_process()
    app(prog_name="fdd")
