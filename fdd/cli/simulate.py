"""``fdd simulate``: one run of the simulated actuator, single or dual, healthy or faulty."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fdd.cli.command import option
from fdd.engines import Advance
from fdd.errors import InputError
from fdd.files import require_writable

if TYPE_CHECKING:
    from fdd.logs.mcap_writing import RunBlock
    from fdd.plant.scenario import Scenario
    from fdd.unit import Unit

Data = dict[str, Any]
RIG = "Load, control and circuit"
WIDTH_IN_A_FILE = 160
"""Columns of the list of faults where it does not go to a terminal."""


def _list_faults(wanted: bool) -> None:
    if not wanted:
        return
    from rich.text import Text

    from fdd.cli.console import grid, output
    from fdd.faults import ADDED_BY, CATALOGUE

    whole, caption = ("fault", "family", "sides"), "Of variants, sides and laws the first is the default."
    heads = ("fault", "family", "what the plant does", "severity 1.0", "variants", "sides")
    table = grid(heads, whole=whole, pad_edge=False, caption=caption)
    for entry in CATALOGUE.values():
        origin = f" (package {ADDED_BY[entry.id]})" if entry.id in ADDED_BY else ""
        plant = entry.plant + ("" if entry.simulated else " (not simulated)") + origin
        plain = (entry.id, entry.family, plant, entry.severity, ", ".join(entry.variants),
                 ", ".join(map(str, entry.sides)))  # fmt: skip
        table.add_row(*map(Text, plain), style="" if entry.simulated else "dim")
        for law, words in entry.laws.items():
            table.add_row(Text(f"  law={law}"), "", Text(words))
    console = output()
    if not console.is_terminal:
        console.width = WIDTH_IN_A_FILE
    console.print(table)
    raise typer.Exit(0)


def simulate(
    out: Annotated[Path, option("MCAP (with the truth), Parquet or CSV.", "--out", "-o")],
    scenario: Annotated[
        Path | None, option("A whole scenario from a YAML file; other options override it.")
    ] = None,
    unit: Annotated[
        str | None, option("Unit profile: a YAML file or a shipped one.", show_default="axis_a")
    ] = None,
    profile: Annotated[
        str | None,
        option(
            "Duty: standstill, steps, sines, sweep, prbs, sawtooth, strokes, flight, constant_speed or "
            "levels; with parameters as in steps:amplitude=0.03,hold=1 or levels:points=0:0.02/5:-0.02.",
            show_default="steps",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        option(
            "ID:severity=0.4,onset=20; also profile, ramp, period, duty, seed, side, variant, law, axis. "
            "Repeatable."
        ),
    ] = None,
    duration: Annotated[float | None, option("Seconds.", show_default="60")] = None,
    seed: Annotated[int | None, option("Fixes everything random.", show_default="0")] = None,
    load: Annotated[
        str | None,
        option("none, constant, spring, inertia, gust or throttle; with parameters as in spring:rate=2e4.",
               show_default="none", rich_help_panel=RIG),
    ] = None,
    control: Annotated[
        str | None,
        option("position or speed.", show_default="position; speed for constant_speed",
               rich_help_panel=RIG),
    ] = None,
    partner: Annotated[
        str | None,
        option("Second axis on the same rod: its unit profile, as in axis_b:drive=still,power=0; drive is "
               "same or still.", rich_help_panel=RIG),
    ] = None,
    temperature: Annotated[
        float | None, option("Oil temperature at the start, °C.", show_default="40")
    ] = None,
    truth: Annotated[bool, typer.Option(help="Write the truth beside the measurement (MCAP).")] = True,
    list_faults: Annotated[
        bool,
        option("Show the fault catalogue and stop.", "--list-faults", callback=_list_faults, is_eager=True),
    ] = False,
) -> None:  # fmt: skip
    """Simulate an actuator, alone or as one of a dual rig, and write its log.

    A dual run's MCAP holds both axes; Parquet and CSV get a file for each, with the axis in its name.
    """
    require_kind(out)

    from fdd.cli.console import progress
    from fdd.plant.duty import Steps
    from fdd.plant.faults import parse_fault
    from fdd.plant.scenario import Scenario, scenario_data
    from fdd.unit import Unit

    data: Data = {} if scenario is None else scenario_data(scenario)
    plain = {"unit": unit, "duration": duration, "seed": seed, "oil_temperature": temperature}
    data.update({name: value for name, value in plain.items() if value is not None})
    _set_motion(data, profile, load, control)
    if fault:
        data["faults"] = [parse_fault(text) for text in fault]
    if partner is not None:
        _set_partner(data, partner)
    machine = Unit.load(str(data.get("unit", "axis_a")))
    if data.get("duty") is None:  # nothing was asked for: steps that any stroke holds
        data["duty"] = Steps(amplitude=min(Steps().amplitude, 0.3 * machine.cylinder.stroke)).model_dump()
    second = None
    if data.get("partner") is not None:
        second = Unit.load(str(_section(data, "partner").get("unit", "axis_b")))
        data["partner"]["unit"] = second.name
    try:
        whole = Scenario(**{**data, "unit": machine.name})
    except InputError as error:
        raise (error if scenario is None else error.at(scenario)) from None
    with progress(f"simulating {whole.duration:g} s", total=float(whole.rows)) as advance:
        write_simulation(out, machine, whole, partner=second, truth=truth, advance=advance)


def _section(data: Data, name: str) -> Data:
    """A part of the scenario to write into; made where it is not there."""
    inner: Data = data.get(name) or {}
    if not isinstance(inner, dict):
        raise InputError(f"{name} {inner!r:.60} has no fields", where="scenario", mend="write its fields")
    data[name] = inner
    return inner


def _set_motion(data: Data, profile: str | None, load: str | None, control: str | None) -> None:
    from fdd.plant import named, named_parameters
    from fdd.plant.duty import DUTIES
    from fdd.plant.rig import LOADS

    if profile is not None:
        name, parameters = named_parameters(profile, "--profile")
        data["duty"] = named(DUTIES, "profile", name)(**parameters).model_dump()
        if control is None and name == "constant_speed":
            control = "speed"
    if load is not None:
        name, parameters = named_parameters(load, "--load")
        data["load"] = named(LOADS, "load", name)(**parameters).model_dump()
    if control is not None:
        _section(data, "control")["mode"] = control


def _set_partner(data: Data, text: str) -> None:
    from fdd.plant import named_parameters

    name, parameters = named_parameters(text, "--partner")
    if odd := parameters.keys() - {"drive", "power"}:
        mend = "use drive or power; its valves stand in a scenario file (--scenario)"
        raise InputError(f"--partner {text}: unknown parameter {min(odd)}", mend=mend)
    _section(data, "partner").update({"unit": name, **parameters})


def require_kind(path: Path) -> None:
    """Refuse a file that could not be written, with an `InputError`, before anything is simulated."""
    if path.suffix.lower() not in (".mcap", ".parquet", ".csv"):
        problem = f"files of kind {path.suffix or 'none'} are not written"
        raise InputError(problem, where=path, mend="use .mcap, .parquet, .csv")
    require_writable(path)


def write_simulation(
    path: Path, unit: Unit, scenario: Scenario, *, partner: Unit | None = None, truth: bool = True,
    advance: Advance = lambda done: None,
) -> None:  # fmt: skip
    """Simulate a run into a log: MCAP, which holds both axes, and the `truth` beside the measurement if it is
    asked for; or Parquet or CSV, a file for each axis, with its name in the file's. `advance` is told how
    many milliseconds are done.

    Raises InputError: as `fdd.plant.simulate.simulate`, units of one axis, a file that cannot be written.
    """
    require_kind(path)
    from fdd.logs.tabular_writing import axis_file, write_tables

    units = [unit] if partner is None else [unit, partner]
    axes = [each.axis for each in units]
    if len(set(axes)) < len(axes):
        problem = f"both units are of axis {axes[0]}"
        raise InputError(problem, mend="give the partner's profile another axis name")
    table = path.suffix.lower() != ".mcap"
    for axis in axes if table else ():
        require_writable(axis_file(path, axis, axes))

    def made() -> Iterator[RunBlock]:
        # Its compiled code takes a second to load: not before everything is known to be right.
        from fdd.logs.mcap_writing import RunBlock
        from fdd.plant.simulate import BLOCK, stream

        for k, parts in enumerate(stream(unit, scenario, partner=partner)):
            for axis, (samples, true) in zip(axes, parts, strict=True):
                yield RunBlock(samples, {"time": true.time, **true.as_columns()} if truth else None, axis)
            advance(float(min((k + 1) * BLOCK, scenario.rows)))

    blocks = made()
    if table:
        write_tables(path, blocks, axes=axes)
        return
    from fdd.logs.mcap_writing import write_blocks

    write_blocks(
        path, blocks, axes=axes, units={each.axis: each.to_yaml() for each in units},
        scenario_json=scenario.model_dump_json(), labels={"faults": [s.label() for s in scenario.faults]},
    )  # fmt: skip
