"""``fdd simulate``: one run of the simulated actuator, single or dual, healthy or faulty."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fdd.cli.completion import CONTROLS, DUTIES, LOADS, begins, faults, units
from fdd.cli.options import option
from fdd.errors import InputError

RIG, CONDITIONS, RECORDING = "Load, control and circuit", "Conditions", "Recording"


def _list_faults(wanted: bool) -> None:
    if wanted:
        from fdd.cli.console import output
        from fdd.cli.fault_table import WIDTH_IN_A_FILE, fault_table

        console = output()
        if not console.is_terminal:
            console.width = WIDTH_IN_A_FILE
        console.print(fault_table())
        raise typer.Exit(0)


def simulate(
    out: Annotated[Path, option("MCAP (with the truth), Parquet or CSV.", "--out", "-o")],
    scenario: Annotated[
        Path | None, option("A whole scenario from a YAML file; other options override it.")
    ] = None,
    unit: Annotated[
        str | None,
        option("Unit profile: a YAML file or a shipped one.", show_default="axis_a", autocompletion=units),
    ] = None,
    profile: Annotated[
        str | None,
        option(
            "Duty: standstill, steps, sines, sweep, prbs, sawtooth, strokes, flight, constant_speed, one_way "
            "or levels; with parameters as in steps:amplitude=0.03,hold=1 or levels:points=0:0.02/5:-0.02.",
            show_default="steps", autocompletion=begins(DUTIES),
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        option(
            "ID:severity=0.4,onset=20; also profile, ramp, period, duty, seed, side, variant, law, axis. "
            "Repeatable.",
            autocompletion=faults,
        ),
    ] = None,
    duration: Annotated[float | None, option("Seconds.", show_default="60")] = None,
    seed: Annotated[int | None, option("Fixes everything random.", show_default="0")] = None,
    load: Annotated[
        str | None,
        option("none, constant, spring, inertia, gust or throttle; with parameters as in spring:rate=2e4.",
               show_default="none", autocompletion=begins(LOADS), rich_help_panel=RIG),
    ] = None,
    control: Annotated[
        str | None,
        option("position or speed.", show_default="position; speed for constant_speed",
               autocompletion=begins(CONTROLS), rich_help_panel=RIG),
    ] = None,
    partner: Annotated[
        str | None,
        option("Second axis on the same rod: its unit profile, as in axis_b:drive=still,power=0; drive is "
               "same or still.", autocompletion=units, rich_help_panel=RIG),
    ] = None,
    valve: Annotated[
        list[str] | None,
        option("NAME=OPENING, 0 to 1 or time:opening/time:opening; b.NAME for the partner's. connect_1, "
               "connect_2, bypass, throttle, external_leakage, charging, blocked. Repeatable.",
               rich_help_panel=RIG),
    ] = None,
    temperature: Annotated[
        float | None,
        option("Oil temperature at the start, °C.", show_default="40", rich_help_panel=CONDITIONS),
    ] = None,
    warming: Annotated[
        float | None, option("Warming of the oil, °C/s.", show_default="0", rich_help_panel=CONDITIONS)
    ] = None,
    load_force: Annotated[
        bool, option("Measure the load force as well.", "--load-force", rich_help_panel=RECORDING)
    ] = False,
    perfect: Annotated[
        bool, option("No dropped, late or missing samples.", "--perfect", rich_help_panel=RECORDING)
    ] = False,
    truth: Annotated[
        bool, typer.Option(help="Write the truth beside the measurement (MCAP).", rich_help_panel=RECORDING)
    ] = True,
    list_faults: Annotated[
        bool,
        option("Show the fault catalogue and stop.", "--list-faults", callback=_list_faults, is_eager=True),
    ] = False,
) -> None:  # fmt: skip
    """Simulate an actuator, alone or as one of a dual rig, and write its log.

    A dual run's MCAP holds both axes; Parquet and CSV get a file for each, with the axis in its name.
    """
    from fdd.plant.to_file import require_kind, write_simulation

    require_kind(out)

    from fdd.cli import scenario_options as options
    from fdd.cli.console import progress
    from fdd.plant.duty import Steps
    from fdd.plant.faults.spec import parse_fault
    from fdd.plant.scenario import Scenario, scenario_data
    from fdd.unit import Unit

    data: dict[str, Any] = {} if scenario is None else scenario_data(scenario)
    plain = {
        "unit": unit, "duration": duration, "seed": seed, "oil_temperature": temperature, "warming": warming,
    }  # fmt: skip
    data.update({name: value for name, value in plain.items() if value is not None})
    options.set_motion(data, profile, load, control)
    if fault:
        data["faults"] = [parse_fault(text) for text in fault]
    if partner is not None:
        options.set_partner(data, partner)
    for text in valve or []:
        options.set_valve(data, text)
    if load_force:
        options.section(data, "recording")["load_force"] = True
    if perfect:
        options.section(data, "recording").update(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
    machine = Unit.load(str(data.get("unit", "axis_a")))
    if data.get("duty") is None:  # nothing was asked for: steps that any stroke holds
        data["duty"] = Steps(amplitude=min(Steps().amplitude, 0.3 * machine.cylinder.stroke)).model_dump()
    second = None
    if data.get("partner") is not None:
        second = Unit.load(str(options.section(data, "partner").get("unit", "axis_b")))
        data["partner"]["unit"] = second.name
    try:
        whole = Scenario(**{**data, "unit": machine.name})
    except InputError as error:
        raise (error if scenario is None else error.at(scenario)) from None
    with progress(f"simulating {whole.duration:g} s", total=float(whole.rows)) as advance:
        write_simulation(out, machine, whole, partner=second, truth=truth, advance=advance)
