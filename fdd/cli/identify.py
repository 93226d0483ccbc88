"""``fdd identify``: a unit's own profile from its healthy logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fdd.cli.completion import units
from fdd.cli.experiment import Experiment
from fdd.cli.experiment import experiment as run_experiment
from fdd.cli.options import AxisOption, MapOption, argument, option, require_outputs, write_json
from fdd.errors import InputError


def identify(
    logs: Annotated[list[Path], argument("Logs of this unit while healthy.", "HEALTHY_LOG...")],
    out: Annotated[
        Path | None, option("Profile to write (YAML); of an experiment its page.", "--out", "-o")
    ] = None,
    base: Annotated[
        str,
        typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.", autocompletion=units),
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    name: Annotated[str | None, option("Name of the new profile; by default base, date, hash.")] = None,
    add: Annotated[
        Path | None, option("Narrow this identified profile with more logs.", metavar="PROFILE")
    ] = None,
    accept: Annotated[bool, typer.Option(help="Write a profile that would be refused.")] = False,
    json_: Annotated[
        str | None, option("Write the result as JSON; - is standard output.", "--json", metavar="FILE|-")
    ] = None,
    verbose: Annotated[bool, typer.Option(help="Sensors and notes too.")] = False,
    experiment: Annotated[
        Experiment | None, option("Make no profile but `fdd experiment` of this kind, against --base.")
    ] = None,
) -> None:
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    import json

    from fdd.cli.console import progress
    from fdd.cli.identify_tables import as_data, print_result
    from fdd.identification.from_logs import identify_logs

    if experiment is not None:
        run_experiment(experiment, logs, base, map_, axis, html=out, json_=json_)
        return
    if out is None:
        raise InputError("no profile to write to", mend="name it with -o, e.g. -o unit.yaml")
    require_outputs(json_, out)
    made = identify_logs(logs, base, map_, add=add, axis=axis, name=name, accept=accept, progress=progress)
    made.unit.save(out)
    write_json(json_, json.dumps(as_data(made), indent=1, ensure_ascii=False))
    if json_ != "-":
        print_result(made, out, verbose=verbose)
