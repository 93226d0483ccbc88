"""The slips that a module's code may have: one operator, figure, condition or statement that is another."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from typing import NamedTuple

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
NAMES = {
    "max": "min", "min": "max", "maximum": "minimum", "minimum": "maximum", "any": "all", "all": "any",
    "argmax": "argmin", "argmin": "argmax", "floor": "ceil", "ceil": "floor", "mean": "median",
    "median": "mean", "sum": "max",
}  # fmt: skip
UNREAD = {"annotation", "returns", "decorator_list", "type_comment"}
SPARED = {"strict", "stacklevel", "dtype", "mend", "where", "title", "help"}
"""Keywords that words and types are given by."""


class Slip(NamedTuple):
    """One change of a module's source: which of all, and whether Numba compiles or keeps what it changes."""

    module: str
    place: int
    line: int
    change: str
    compiled: bool


def others(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in a node's place."""
    if isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            yield _with(node, ops=[*node.ops[:k], OPERATORS[type(op)](), *node.ops[k + 1 :]])
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in OPERATORS:
        if not any(_is_text(getattr(node, side, None)) for side in ("left", "right", "value")):
            yield _with(node, op=OPERATORS[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield _with(node, value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield _with(node, value=node.value + 1 if isinstance(node.value, int) else 2.0 * node.value or 1.0)
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.comprehension):
        for k, test in enumerate(node.ifs):
            yield _with(node, ifs=[*node.ifs[:k], ast.UnaryOp(ast.Not(), test), *node.ifs[k + 1 :]])
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield _with(node, id=NAMES[node.id])
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield _with(node, attr=NAMES[node.attr])
    called = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    kept = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript)
    if called or kept or isinstance(node, ast.AugAssign | ast.Continue | ast.Break):
        yield ast.Pass()


def _with(node: ast.AST, **fields: object) -> ast.AST:
    new = copy.copy(node)
    vars(new).update(fields)
    return new


def _is_text(node: object) -> bool:
    return isinstance(node, ast.JoinedStr) or isinstance(getattr(node, "value", None), str)


def places(node: ast.AST, compiled: bool) -> Iterator[tuple[ast.AST, str, int | None, ast.AST, bool]]:
    """Every change below a node: where it stands, what stands there instead, and whether it is compiled.

    Words, types, decorators and what a unit refuses with are passed over.
    """
    if isinstance(node, ast.JoinedStr | ast.Raise) or getattr(node, "name", "") == "__repr__":
        return
    if isinstance(node, ast.FunctionDef):
        compiled = any("njit" in ast.unparse(d) for d in node.decorator_list)
    for field in (f for f in node._fields if f not in UNREAD):
        value = getattr(node, field, None)
        for k, child in enumerate(value) if isinstance(value, list) else ((None, value),):
            if isinstance(child, ast.AST) and not (isinstance(child, ast.keyword) and child.arg in SPARED):
                table = isinstance(node, ast.Module) and isinstance(getattr(child, "value", None), ast.Dict)
                yield from ((node, field, k, new, compiled) for new in others(child))
                yield from places(child, compiled and not table)


def slips(module: str, source: str) -> list[Slip]:
    """All of a module, in the order of its source."""
    kept = module.startswith("fdd.residuals.")  # its figures may be part of what is compiled
    found = []
    for place, (parent, field, k, new, compiled) in enumerate(places(ast.parse(source), kept)):
        old = getattr(parent, field) if k is None else getattr(parent, field)[k]
        line = getattr(old, "lineno", getattr(parent, "lineno", 1))
        found.append(Slip(module, place, line, f"`{_short(old)}` → `{_short(new)}`", compiled))
    return found


def _short(node: ast.AST) -> str:
    shown = getattr(node, "test", None) or (getattr(node, "ifs", None) or [node])[0]
    return " ".join(ast.unparse(shown).split())[:70]


def changed(source: str, place: int) -> ast.Module:
    """A module's tree with the change of that place."""
    tree = ast.parse(source)
    parent, field, k, new, _ = next(p for i, p in enumerate(places(tree, False)) if i == place)
    if k is None:
        setattr(parent, field, new)
    else:
        getattr(parent, field)[k] = new
    return ast.fix_missing_locations(tree)
