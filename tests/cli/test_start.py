"""How a command starts: it loads what it uses and no more; what the shell offers, how help is grouped."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

UNUSED = [
    "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats", "pandas", "pyarrow",
    "sklearn", "numpy.f2py", "numba.np.arraymath", "matplotlib", "jinja2", "h5py", "pint", "fdd.plant",
    "fdd.monitor", "fdd.campaign",
]  # fmt: skip


def loaded(*arguments: object) -> list[str]:
    """What of `UNUSED` a command loads."""
    program = (
        "import sys; from fdd.cli import main\n"
        "try: main()\n"
        f"finally: print(*(m for m in {UNUSED} if m in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()[-1].split()


def test_diagnose_loads_nothing_that_it_does_not_use(logs, tiny_model_file) -> None:
    command = ("diagnose", logs["healthy"], "--unit", "axis_a", "--model", tiny_model_file)
    loaded(*command)  # the first one here may have to compile, which loads the compiler
    assert loaded(*command) == []


def test_commands_are_found_one_after_the_other() -> None:
    names = ["inspect", "map", "profile", "diagnose", "--version"]
    program = (
        "import sys; from fdd.cli import main\n"
        "for name in sys.argv[1:]:\n"
        "    sys.argv = ['fdd', name, '--help']\n"
        "    try: main()\n"
        "    except SystemExit as end: assert not end.code\n"
    )
    done = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    usages = [line.split() for line in done.stdout.splitlines() if "Usage:" in line]
    assert [u[u.index("fdd") + 1] for u in usages] == names[:-1]
    assert done.stdout.splitlines()[-1].startswith("fdd ")


def offered(line: str) -> list[str]:
    """What bash would show after this line; the last word is being typed."""
    environment = {
        **os.environ, "_FDD_COMPLETE": "complete_bash", "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", "from fdd.cli import main; main()"], env=environment, capture_output=True,
        text=True, timeout=60,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("fdd d", ["diagnose", "demo"]),
        ("fdd simulate --fault pump", ["pump_wear"]),
        ("fdd diagnose run.mcap --unit ", ["axis_a", "axis_b"]),
        ("fdd identify --base rig", []),
    ],
)
def test_the_shell_offers(line: str, expected: list[str]) -> None:
    assert offered(line) == expected


def test_help_is_grouped(run) -> None:
    shown = run("--help").stdout
    places = [shown.index(f" {title} ─") for title in ("Use", "Rigs", "Research")]
    use, rigs, research = places
    assert places == sorted(places)
    for command, (start, stop) in {
        "diagnose": (use, rigs), "identify": (rigs, research), "profile": (rigs, research),
        "simulate": (research, len(shown)),
    }.items():  # fmt: skip
        assert start < shown.index(f"│ {command} ") < stop
    assert "--install-completion" in shown
