"""How a command starts and what it loads; ``fdd map`` and ``fdd inspect`` on a foreign log."""

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from fdd import __version__
from fdd.cli.rig_logs import _proposal_table
from fdd.logs import ChannelMap, read_log

UNUSED = [
    "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats", "pandas", "pyarrow",
    "sklearn", "numpy.f2py", "numba.np.arraymath", "matplotlib", "jinja2", "h5py", "pint", "fdd.plant",
    "fdd.monitor", "fdd.campaign",
]  # fmt: skip


def process(program: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """A Python program about the command line, in a process of its own."""
    begun = f"import os, sys; from fdd.cli import main\n{program}"
    command, given = [sys.executable, "-c", begun, *map(str, arguments)], os.environ | environment
    done = subprocess.run(command, env=given, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done


def loaded(names: list[str], *arguments: object) -> list[str]:
    """Which of some modules a command loads."""
    program = f"try: main()\nfinally: print(*(m for m in {names} if m in sys.modules), file=sys.stderr)"
    return process(program, *arguments).stderr.splitlines()[-1].split()


def test_diagnose_and_help_load_nothing_that_they_do_not_use(logs, tiny_model_file):
    command = ("diagnose", logs["healthy"], "--unit", "axis_a", "--model", tiny_model_file)
    loaded(UNUSED, *command)  # the first one here may have to compile, which loads the compiler
    assert loaded(UNUSED, *command) == []
    libraries = ["numpy", "numba", "scipy", "pandas", "pyarrow", "sklearn", "pydantic", "mcap", "yaml"]
    assert loaded([*libraries, "fdd.packages"], "--help") == []


def test_commands_are_found_one_after_the_other():
    names = ["inspect", "map", "profile", "diagnose", "--version"]
    program = (
        "for name in sys.argv[1:]:\n"
        "    sys.argv = ['fdd', name, '--help']\n"
        "    try: main()\n"
        "    except SystemExit as end: assert not end.code\n"
    )
    lines = process(program, *names).stdout.splitlines()
    usages = [line.split() for line in lines if "Usage:" in line]
    assert [u[u.index("fdd") + 1] for u in usages] == names[:-1]
    assert lines[-1].startswith("fdd ")


def test_the_shell_offers_commands_and_options():
    """What bash would show after a line; its last word is being typed."""
    offered = {"fdd d": ["diagnose", "demo"], "fdd identify run.mcap --ba": ["--base"]}
    program = (
        "for line in sys.argv[1:]:\n"
        "    os.environ |= {'COMP_WORDS': line, 'COMP_CWORD': str(line.count(' '))}\n"
        "    sys.argv = ['fdd']\n"
        "    try: main()\n"
        "    except SystemExit as end: print('|')\n"
    )
    done = process(program, *offered, _FDD_COMPLETE="complete_bash")
    assert done.stderr == ""
    assert [each.split() for each in done.stdout.split("|")[:-1]] == list(offered.values())


def test_help_is_grouped(run):
    shown = run("--help").stdout
    places = [shown.index(f" {title} ─") for title in ("Use", "Rigs", "Research")]
    use, rigs, research = places
    assert places == sorted(places)
    for command, (start, stop) in {
        "diagnose": (use, rigs), "identify": (rigs, research), "profile": (rigs, research),
        "simulate": (research, len(shown)),
    }.items():  # fmt: skip
        assert start < shown.index(f"│ {command} ") < stop
    assert "--install-completion" in shown and run("--version").stdout == f"fdd {__version__}\n"


@pytest.fixture(scope="module")
def foreign(logs, tmp_path_factory):
    """The healthy log under names of a rig's own, pressures in kPa without saying so."""
    samples = read_log(logs["healthy"]).samples
    path = tmp_path_factory.mktemp("foreign") / "rig.csv"
    columns = {
        "t": samples.time, "pump_rpm": samples["pump_speed"] * 30 / np.pi,
        "cyl_mm": 1e3 * samples["position"], "p1": samples["pressure_1"] / 1e3,
        "p2": samples["pressure_2"] / 1e3,
    }  # fmt: skip
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_an_answered_question_gives_a_map(ran, logs, foreign, tmp_path):
    out = tmp_path / "map.yaml"
    result = ran("map", foreign, "-o", out, "--set", "pressure=:kPa", "--axis", "axis_a")
    assert "as it should" in result.stdout, result.stderr
    assert ChannelMap.load(out).axis == "axis_a"
    read, wanted = read_log(foreign, out).samples, read_log(logs["healthy"]).samples
    for channel in ("position", "pump_speed", "pressure_1", "pressure_2"):
        np.testing.assert_allclose(read[channel], wanted[channel], rtol=1e-9, atol=1e-9)


def test_no_channels_name_is_broken_at_80_columns(capsys):
    source = SimpleNamespace(scale=31.416, column="accumulator_bar", sign=1, unit="bar")
    row = SimpleNamespace(source=source, confidence=0.9, why="its name and unit; it rests " * 5)
    Console(width=80).print(_proposal_table(SimpleNamespace(rows={"pressure_accumulator": row})))
    assert " pressure_accumulator " in capsys.readouterr().out


def test_open_questions_and_wrong_answers_are_told(run, one_line, foreign, tmp_path):
    out = tmp_path / "map.yaml"
    result = run("map", foreign, "-o", out)
    assert result.exit_code == 2 and "--set pressure=:" in result.stderr and "--yes" in result.stderr
    for given, said in (("pressur=:kPa", "did you mean 'pressure"), ("position=x", "no column 'x'")):
        one_line(run("map", foreign, "-o", out, "--yes", "--set", given), said)
    assert not out.exists() and run("map", foreign, "-o", out, "--yes").exit_code == 0
    text = out.read_text()
    assert "In which unit are p1, p2? Assumed: " in text and " assumed" in text


def test_inspect_shows_every_signal(run, logs, foreign):
    result = run("inspect", foreign)
    assert [name for name in ("pump_rpm", "cyl_mm", "p1") if name not in result.stdout] == []
    assert "1000" in result.stdout
    messages = run("inspect", logs["healthy"]).stdout
    assert "  /eha/axis_a/measurement " in messages and "    pressure_difference " in messages


def test_the_command_may_stand_in_for_the_speed(foreign):
    channel_map = ChannelMap.from_yaml(
        "time: {column: t}\ncommand: {column: pump_rpm, unit: rpm}\npump_speed: {from: command}\n"
        "position: {column: cyl_mm, unit: mm}\n"
        "pressure_1: {column: p1, unit: kPa}\npressure_2: {column: p2, unit: kPa}\n"
    )
    log = read_log(foreign, channel_map)
    np.testing.assert_array_equal(log.samples["pump_speed"], log.samples["command"])
    assert any("the command stands in" in note for note in log.quality.notes)
