"""Public names say what they do, and every example in a docstring gives what it shows."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
from types import ModuleType

import pytest

import estimators
import fdd

# Examples run on imported modules: a module run as a script would leave compiled functions in
# Numba's cache that belong to `__main__`.
NAMES = sorted(
    found.name
    for package in (fdd, estimators)
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public(module: ModuleType) -> dict[str, object]:
    """Functions and classes that a module defines and does not hide."""
    found = {}
    for name, value in vars(module).items():
        plain = inspect.unwrap(value) if callable(value) else value
        defined_here = getattr(plain, "__module__", None) == module.__name__
        if not name.startswith("_") and defined_here and (inspect.isroutine(plain) or inspect.isclass(plain)):
            found[name] = plain
    return found


def undocumented(name: str) -> list[str]:
    """Of a module, what lacks a docstring."""
    module = importlib.import_module(name)
    bare = [] if (module.__doc__ or "").strip() else [name]
    for label, value in public(module).items():
        if not (value.__doc__ or "").strip():
            bare.append(f"{name}.{label}")
        if inspect.isclass(value):
            bare += [
                f"{name}.{label}.{method}"
                for method, code in vars(value).items()
                if inspect.isfunction(code) and not method.startswith("_") and not inspect.getdoc(code)
            ]
    exported = getattr(module, "__all__", [])
    return bare + [f"{name}.{x}" for x in exported if not inspect.getdoc(getattr(module, x))]


def test_public_names_are_documented() -> None:
    assert [bare for name in NAMES for bare in undocumented(name)] == []


@pytest.mark.parametrize("room", sorted({".".join(name.split(".")[:2]) for name in NAMES}))
def test_examples_hold(room: str, monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.chdir(str(tmp_path))
    runner = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False)
    said: list[str] = []
    for name in (n for n in NAMES if f"{n}.".startswith(f"{room}.")):
        for example in doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(name), name):
            runner.run(example, out=said.append)
    assert runner.failures == 0, "".join(said)


def test_examples_are_found_in_compiled_and_in_plain_functions() -> None:
    finder = doctest.DocTestFinder()

    def examples(name: str) -> set[str]:
        return {t.name for t in finder.find(importlib.import_module(name)) if t.examples}

    assert "estimators.kernels.predict_covariance" in examples("estimators.kernels")
    assert "fdd.measures.measure" in examples("fdd.measures")
