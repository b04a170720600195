"""What a mutant is: one small change of meaning in one place of a source file, found in its syntax tree.

The changes are those that mutmut and cosmic-ray make by default, one of each kind in each place:

- an operator of arithmetic, of bits or of logic becomes its opposite; a minus or a `not` is dropped; True is
  False;
- a comparison is turned round, as cosmic-ray does: of measured numbers none is equal to its bound, so that
  `<=` in place of `<`, as in mutmut, would mostly mean the same;
- a number in a function becomes larger by one, as in both, or by half where one would be lost in it: a second
  of 1,000,000,001 ns is no mistake that people make. So inner constants count, physical or tuned;
- a number outside functions stays, as in mutmut: these are tables of a data sheet, usual sizes, and named
  thresholds whose docstring says where they come from. No test should say them a second time;
- beyond both: min is max, sin is cos, any is all, and a call for its effect alone is left out. Texts stay.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_SWAPS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"), ast.Mod: ("%", "*"), ast.Pow: ("**", "*"), ast.MatMult: ("@", "*"),
    ast.LShift: ("<<", ">>"), ast.RShift: (">>", "<<"), ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&"),
    ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
_SILENT = ("annotation", "returns", "decorator_list", "type_params")
_LARGE = 1000
"""Above this one more of an integer is lost in it."""
_CALLS = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """path: of the file, from the root of the project. start, end: bytes that `new` replaces."""

    path: str
    line: int
    start: int
    end: int
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.old.strip()} -> {self.new.strip()}"


def mutants(path: str, source: str) -> Iterator[Mutant]:
    """All mutants of a file, in its order; nothing in annotations, docstrings, defaults or error texts.

    An assertion that holds, `zip(..., strict=True)` among them, changes nothing by its absence.
    """
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    code = source.encode()

    def place(node: Any, end: bool = False) -> int:
        line, column = (node.end_lineno, node.end_col_offset) if end else (node.lineno, node.col_offset)
        return starts[line - 1] + int(column)

    def between(left: ast.AST, right: ast.AST, operator: ast.AST) -> Iterator[Mutant]:
        if type(operator) not in _SWAPS:
            return
        old, new = _SWAPS[type(operator)]
        first, last = place(left, end=True), place(right)
        at = code[first:last].find(old.encode())
        if at >= 0:
            yield change(right, first + at, first + at + len(old), new)

    def change(node: Any, start: int, end: int, new: str) -> Mutant:
        return Mutant(path, node.lineno, start, end, code[start:end].decode(), new)

    for node, inside in _worth_changing(ast.parse(source)):
        if isinstance(node, ast.Constant) and not inside:
            continue
        if isinstance(node, ast.BinOp):
            yield from between(node.left, node.right, node.op)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from between(left, right, node.op)
        elif isinstance(node, ast.Compare):
            for left, right, operator in zip(
                [node.left, *node.comparators], node.comparators, node.ops, strict=False
            ):
                yield from between(left, right, operator)
        elif isinstance(node, ast.AugAssign):
            yield from between(node.target, node.value, node.op)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield change(node, place(node), place(node.operand), "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield change(node, place(node), place(node, end=True), _other(node.value))
        elif isinstance(node, ast.Call) and (name := _name(node.func)) in _CALLS:
            end = place(node.func, end=True)
            yield change(node, end - len(name), end, _CALLS[name])
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield change(node, place(node), place(node, end=True), "None")


def _other(value: bool | int | float) -> str:
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return repr(value + max(1, value // 2 if value > _LARGE else 0))
    return repr(value + max(1.0, value / 2.0))


def _name(function: ast.expr) -> str:
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _worth_changing(node: ast.AST, inside: bool = False) -> Iterator[tuple[ast.AST, bool]]:
    """Every node but those that say nothing about behaviour, and whether it stands inside a function."""
    yield node, inside
    inside = inside or isinstance(node, ast.FunctionDef | ast.Lambda)
    for name, value in ast.iter_fields(node):
        if name in _SILENT or isinstance(node, ast.Raise | ast.Assert):
            continue
        if isinstance(node, ast.keyword) and node.arg == "strict":
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_text(child) and not isinstance(child, ast.arguments):
                yield from _worth_changing(child, inside)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Expr):
        node = node.value
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
