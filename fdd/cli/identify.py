"""``fdd identify``: a unit's own profile from its healthy logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.cli.experiment import Experiment
from fdd.cli.experiment import experiment as run_experiment
from fdd.cli.options import AxisOption, MapOption
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.identify import Identification
    from fdd.identify.noise import NoiseFit
    from fdd.logs import Log
    from fdd.unit import Unit


def identify(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="HEALTHY_LOG...", help="Logs of this unit while healthy.", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Profile to write (YAML); of an experiment its page.", show_default=False
        ),
    ] = None,
    base: Annotated[
        str, typer.Option(help="Profile of a similar unit: a YAML file or a shipped one.")
    ] = "axis_a",
    map_: MapOption = None,
    axis: AxisOption = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name of the new profile; by default base, date, hash.", show_default=False),
    ] = None,
    add: Annotated[
        Path | None,
        typer.Option(
            metavar="PROFILE", help="Narrow this identified profile with more logs.", show_default=False
        ),
    ] = None,
    accept: Annotated[bool, typer.Option(help="Write a profile that would be refused.")] = False,
    json_: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE|-", help="Write the result as JSON; - is standard output."),
    ] = None,
    verbose: Annotated[
        bool, typer.Option(help="Sensors, filters' noise, innovation tests and notes too.")
    ] = False,
    noise: Annotated[bool, typer.Option(help="Fit the filters' noise too.")] = True,
    experiment: Annotated[
        Experiment | None,
        typer.Option(
            help="Make no profile but `fdd experiment` of this kind, against --base.", show_default=False
        ),
    ] = None,
) -> None:
    """Identify a unit from its healthy logs, so that its own spread is no fault."""
    import json

    from fdd.cli.console import progress
    from fdd.cli.identify_tables import as_data, print_result
    from fdd.cli.which_logs import read_logs
    from fdd.files import require_writable, write_text
    from fdd.identify.judgement import judge
    from fdd.identify.origin import named, origin_of
    from fdd.logs import ChannelMap
    from fdd.unit import Unit

    if experiment is not None:
        run_experiment(experiment, logs, base, map_, axis, html=out, json_=json_)
        return
    if out is None:
        raise InputError("no profile to write to", mend="name it with -o, e.g. -o unit.yaml")
    require_writable(out)
    if json_ not in (None, "-"):
        require_writable(Path(json_))
    profile = Unit.load(add if add is not None else base)
    named(profile, name)
    channel_map = None if map_ is None else ChannelMap.load(map_)
    origin = origin_of(profile, logs, channel_map, more=add is not None)
    read = read_logs(logs, channel_map, axis)
    samples, labels = [log.samples for log in read], [str(path) for path in logs]
    if add is None:
        found, unit, fit = _identified(read, labels, profile, noise=noise)
    else:
        found, unit, fit = *_added(read, labels, profile), None
    with progress("judging"):
        judged = judge(found, unit, profile, samples, labels, more=add is not None)
    if judged.refusals and not accept:
        mend = "mend or leave out what is named, or --accept makes the profile all the same"
        raise InputError(judged.sentence, mend=mend)
    unit = named(unit, name or origin.name_for(profile, read[0].start_ns))
    unit.origin = origin.section.model_copy(update={"limits": judged.limits, "accepted": judged.refusals})
    unit.save(out)
    data = json.dumps(as_data(found, judged, unit), indent=1, ensure_ascii=False)
    if json_ == "-":
        print(data)
        return
    if json_ is not None:
        write_text(json_, data + "\n")
    print_result(found, judged, unit, fit, out, verbose=verbose)


def _identified(
    logs: list[Log], labels: list[str], base: Unit, *, noise: bool
) -> tuple[Identification, Unit, NoiseFit | None]:
    from fdd.cli.console import progress
    from fdd.diagnosis.baseline import add_baseline
    from fdd.identify import identify_unit
    from fdd.identify.noise import fit_noise

    samples = [log.samples for log in logs]
    with progress("identifying"):
        try:
            found = identify_unit(samples, base, labels=labels)
        except InputError as error:
            raise InputError(f"not usable, because {_inner(error)}", mend=error.mend) from None
    fit = None
    if noise:
        with progress("fitting the filters' noise"):
            fit = fit_noise(samples, found.unit)
        found.unit.estimation = None if fit is None else fit.estimation
    with progress("measuring the healthy baseline"):
        return found, add_baseline(found.unit, samples), fit


def _added(logs: list[Log], labels: list[str], profile: Unit) -> tuple[Identification, Unit]:
    from fdd.cli.console import progress
    from fdd.identify.adding import add_logs

    with progress("adding"):
        try:
            return add_logs([log.samples for log in logs], profile, labels)
        except InputError as error:
            raise InputError(f"not usable, because {_inner(error)}", mend=error.mend) from None


def _inner(error: InputError) -> str:
    return error.problem if error.where is None else f"{error.where}: {error.problem}"
