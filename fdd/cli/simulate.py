"""``fdd simulate``: one run of the simulated actuator, single or dual, healthy or faulty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fdd.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fdd.cli.console import Advance
    from fdd.logs.mcap_runs import RunBlock
    from fdd.plant.scenario import Scenario
    from fdd.unit import Unit

SUFFIXES = (".mcap", ".parquet", ".csv")


def _list_faults(wanted: bool) -> None:
    if wanted:
        from fdd.cli.fault_table import show_faults

        show_faults()
        raise typer.Exit(0)


def simulate(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="MCAP (with the truth), Parquet or CSV.", show_default=False)
    ],
    scenario: Annotated[
        Path | None,
        typer.Option(
            help="A whole scenario from a YAML file; other options override it.", show_default=False
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(help="Unit profile: a YAML file or a shipped one.", show_default="axis_a"),
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option(
            help="Duty: standstill, steps, sines, sweep, prbs, sawtooth, strokes, flight, "
            "constant_speed, one_way or levels; with parameters as in steps:amplitude=0.03,hold=1 or "
            "levels:points=0:0.02/5:-0.02.",
            show_default="steps",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="ID:severity=0.4,onset=20; also profile, ramp, period, duty, side, variant, axis. "
            "Repeatable.",
            show_default=False,
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds.", show_default="60")] = None,
    seed: Annotated[int | None, typer.Option(help="Fixes everything random.", show_default="0")] = None,
    load: Annotated[
        str | None,
        typer.Option(
            help="none, constant, spring, inertia, gust or throttle; with parameters as in spring:rate=2e4.",
            show_default="none",
        ),
    ] = None,
    control: Annotated[
        str | None,
        typer.Option(help="position or speed.", show_default="position; speed for constant_speed"),
    ] = None,
    partner: Annotated[
        str | None,
        typer.Option(
            help="Second axis on the same rod: its unit profile, as in axis_b:drive=still,power=0; drive is "
            "same or still.",
            show_default=False,
        ),
    ] = None,
    valve: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=OPENING, 0 to 1 or time:opening/time:opening; b.NAME for the partner's. connect_1, "
            "connect_2, bypass, throttle, external_leakage, charging, blocked. Repeatable.",
            show_default=False,
        ),
    ] = None,
    temperature: Annotated[
        float | None, typer.Option(help="Oil temperature at the start, °C.", show_default="40")
    ] = None,
    warming: Annotated[float | None, typer.Option(help="Warming of the oil, °C/s.", show_default="0")] = None,
    charge: Annotated[
        float | None, typer.Option(help="Accumulator charge over the unit's.", show_default="1")
    ] = None,
    ambient: Annotated[
        float | None, typer.Option(help="Absolute ambient pressure, Pa.", show_default="101325")
    ] = None,
    load_force: Annotated[bool, typer.Option("--load-force", help="Measure the load force as well.")] = False,
    perfect: Annotated[bool, typer.Option("--perfect", help="No dropped, late or missing samples.")] = False,
    truth: Annotated[bool, typer.Option(help="Write the truth beside the measurement (MCAP).")] = True,
    list_faults: Annotated[
        bool,
        typer.Option(
            "--list-faults", callback=_list_faults, is_eager=True, help="Show the fault catalogue and stop."
        ),
    ] = False,
) -> None:
    """Simulate an actuator, alone or as one of a dual rig, and write its log.

    A dual run's MCAP holds both axes; Parquet and CSV get a file for each, with the axis in its name.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"files of kind {out.suffix or 'none'} are not written",
            where=out,
            mend=f"use {', '.join(SUFFIXES)}",
        )
    from fdd.files import require_writable

    require_writable(out)

    from fdd.cli import scenario_options as options
    from fdd.cli.console import progress
    from fdd.plant.scenario import Scenario
    from fdd.plant.scenario_file import scenario_data
    from fdd.unit import Unit

    data: dict[str, Any] = {} if scenario is None else scenario_data(scenario)
    plain = {
        "unit": unit, "duration": duration, "seed": seed, "oil_temperature": temperature, "warming": warming,
        "charge_factor": charge, "ambient": ambient,
    }  # fmt: skip
    options.set_plain(data, plain)
    options.set_motion(data, profile, load, control)
    options.set_faults(data, fault or [])
    if partner is not None:
        options.set_partner(data, partner)
    for text in valve or []:
        options.set_valve(data, text)
    if load_force:
        options.section(data, "recording")["load_force"] = True
    if perfect:
        options.section(data, "recording").update(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
    machine = Unit.load(str(data.get("unit", "axis_a")))
    second = None
    if data.get("partner") is not None:
        second = Unit.load(str(options.section(data, "partner").get("unit", "axis_b")))
        data["partner"]["unit"] = second.name
    try:
        whole = Scenario(**{**data, "unit": machine.name})
    except InputError as error:
        raise (error if scenario is None else error.at(scenario)) from None
    from fdd.logs.tabular_writing import axis_file

    axes = [machine.axis] if second is None else [machine.axis, second.axis]
    if len(set(axes)) < len(axes):
        raise InputError(
            f"both units are of axis {axes[0]}", mend="give the partner's profile another axis name"
        )
    table = out.suffix.lower() != ".mcap"
    for axis in axes if table else ():
        require_writable(axis_file(out, axis, axes))
    with progress(f"simulating {whole.duration:g} s", total=float(whole.rows)) as advance:
        _write(out, _blocks(machine, whole, second, axes, truth, advance), axes, machine, second, whole)


def _blocks(
    machine: Unit, scenario: Scenario, second: Unit | None, axes: list[str], truth: bool, advance: Advance
) -> Iterator[RunBlock]:
    """The run's blocks as a log takes them; an hour passes through the memory of a minute."""
    # Its compiled code takes a second to load: not before everything is known to be right.
    from fdd.logs.mcap_runs import RunBlock
    from fdd.plant.simulate import BLOCK, stream

    for k, parts in enumerate(stream(machine, scenario, partner=second)):
        for axis, part in zip(axes, parts, strict=True):
            beside = {"time": part.truth.time, **part.truth.as_columns()} if truth else None
            yield RunBlock(part.samples, beside, axis)
        advance(float(min((k + 1) * BLOCK, scenario.rows)))


def _write(
    out: Path,
    blocks: Iterator[RunBlock],
    axes: list[str],
    machine: Unit,
    second: Unit | None,
    scenario: Scenario,
) -> None:
    from fdd.logs.mcap_runs import write_blocks
    from fdd.logs.tabular_writing import write_table_blocks

    if out.suffix.lower() != ".mcap":
        write_table_blocks(out, blocks, axes=axes)
        return
    units = {machine.axis: machine.to_yaml()}
    if second is not None:
        units[second.axis] = second.to_yaml()
    write_blocks(
        out,
        blocks,
        axes=axes,
        units=units,
        scenario_json=scenario.model_dump_json(),
        labels={"faults": [spec.label() for spec in scenario.faults]},
    )
