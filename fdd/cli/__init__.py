"""The command line: one module a command, thin over the library.

Nothing here imports NumPy or anything heavier before a command runs, so that ``fdd --help``
answers at once.
"""

from __future__ import annotations


def main() -> None:
    """Run ``fdd``; the entry point of the installed script."""
    import sys
    from copy import copy

    from fdd.cli.app import app
    from fdd.cli.command import prepare_process

    prepare_process()
    # Typer works out the options of all commands at each start; a command that is named needs its own alone.
    named = [command for command in app.registered_commands if sys.argv[1:2] == [command.name]]
    if named:
        app = copy(app)
        app.registered_commands, app.registered_groups = named, []
    app(prog_name="fdd")
