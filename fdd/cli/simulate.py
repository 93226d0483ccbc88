"""``fdd simulate``: one run of the simulated actuator, healthy or faulty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.plant.simulate import Simulation

SUFFIXES = (".mcap", ".parquet", ".csv")


def simulate(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="MCAP (with the truth), Parquet or CSV.", show_default=False)
    ],
    unit: Annotated[str, typer.Option(help="Unit profile: a YAML file or a shipped one.")] = "axis_a",
    profile: Annotated[
        str,
        typer.Option(
            help="Duty: standstill, steps, sines, sweep, prbs, sawtooth, strokes, flight or constant_speed; "
            "with parameters as in steps:amplitude=0.03,hold=1."
        ),
    ] = "steps",
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="ID:severity=0.4,onset=20; also profile, ramp, period, duty, side, variant. Repeatable.",
            show_default=False,
        ),
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Fixes everything random.")] = 0,
    load: Annotated[
        str,
        typer.Option(
            help="none, constant, spring, inertia, gust or throttle; with parameters as in spring:rate=2e4."
        ),
    ] = "none",
    control: Annotated[
        str | None, typer.Option(help="position or speed; speed for constant_speed.", show_default=False)
    ] = None,
    temperature: Annotated[float, typer.Option(help="Oil temperature at the start, °C.")] = 40.0,
    warming: Annotated[float, typer.Option(help="Warming of the oil, °C/s.")] = 0.0,
    charge: Annotated[float, typer.Option(help="Accumulator charge over the unit's.")] = 1.0,
    ambient: Annotated[
        float | None, typer.Option(help="Absolute ambient pressure, Pa.", show_default=False)
    ] = None,
    load_force: Annotated[bool, typer.Option("--load-force", help="Measure the load force as well.")] = False,
    perfect: Annotated[bool, typer.Option("--perfect", help="No dropped, late or missing samples.")] = False,
    truth: Annotated[bool, typer.Option(help="Write the truth beside the measurement (MCAP).")] = True,
) -> None:
    """Simulate an actuator and write its log."""
    if out.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"files of kind {out.suffix or 'none'} are not written",
            where=out,
            mend=f"use {', '.join(SUFFIXES)}",
        )
    from fdd.files import require_writable

    require_writable(out)

    from fdd.cli.console import progress
    from fdd.plant.duty import duty_named
    from fdd.plant.faults.spec import parse_fault
    from fdd.plant.load import load_named
    from fdd.plant.scenario import Scenario
    from fdd.plant.simulate import simulate as run
    from fdd.unit import Unit

    machine = Unit.load(unit)
    name, parameters = named_parameters(profile, "--profile")
    duty = duty_named(name, **parameters)
    load_name, load_parameters = named_parameters(load, "--load")
    recording: dict[str, object] = {"load_force": load_force}
    if perfect:
        recording |= {"dropped": 0.0, "late": 0.0, "nan_bursts_per_minute": 0.0}
    mode = control or ("speed" if name == "constant_speed" else "position")
    data: dict[str, object] = {
        "unit": machine.name, "duration": duration, "duty": duty.model_dump(), "seed": seed,
        "control": {"mode": mode}, "load": load_named(load_name, **load_parameters).model_dump(),  # type: ignore[arg-type]
        "oil_temperature": temperature, "warming": warming, "charge_factor": charge,
        "faults": [parse_fault(f) for f in fault or []], "recording": recording,
    }  # fmt: skip
    if ambient is not None:
        data["ambient"] = ambient
    scenario = Scenario(**data)
    with progress(f"simulating {duration:g} s"):
        result = run(machine, scenario)
    with progress(f"writing {out.name}"):
        _write(out, result, truth)


def named_parameters(text: str, option: str) -> tuple[str, dict[str, object]]:
    """Split ``name:key=value,…``; a value with slashes is a list.

    Raises
    ------
    InputError : a part that is not ``key=value``.

    Examples
    --------
    >>> named_parameters("steps:amplitude=0.03,hold=1", "--profile")
    ('steps', {'amplitude': '0.03', 'hold': '1'})
    """
    name, _, rest = text.partition(":")
    out: dict[str, object] = {}
    for part in filter(None, (p.strip() for p in rest.split(","))):
        key, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not key or key in ("name", "self"):
            raise InputError(
                f"{option} {text}: {part!r} is not a parameter", mend="write NAME:key=value,key=value"
            )
        if key in out:
            raise InputError(f"{option} {text}: {key} is given twice", mend="give it once")
        out[key] = value.split("/") if "/" in value else value
    return name.strip(), out


def _write(out: Path, result: Simulation, truth: bool) -> None:
    from fdd.logs.mcap_writing import write_run
    from fdd.logs.tabular_writing import write_csv, write_parquet

    if out.suffix.lower() == ".mcap":
        write_run(
            out,
            result.samples,
            axis=result.unit.axis,
            truth={"time": result.truth.time, **result.truth.as_columns()} if truth else None,
            unit_yaml=result.unit.to_yaml(),
            scenario_json=result.scenario.model_dump_json(),
            labels={"faults": result.labels},
        )
    elif out.suffix.lower() == ".parquet":
        write_parquet(out, result.samples)
    else:
        write_csv(out, result.samples)
