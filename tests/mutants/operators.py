"""Mutants: small changes of meaning at single positions of a source file, found in its syntax tree.

The operators are the defaults of mutmut and cosmic-ray, one mutant of each kind per position:

- An arithmetic, bitwise or logical operator becomes its opposite; a minus or a `not` is removed; True becomes
False. - A comparison is negated, as in cosmic-ray. Replacing `<` by `<=`, as in mutmut, would mostly be
equivalent, as measured numbers rarely equal their bound. - A number in a function is increased by 1, as in
both, or by half if an increment of 1 would be negligible, such as 1,000,000,001 ns for a second. Constants in
functions are thereby mutated, physical or tuned. - A number outside functions is unchanged, as in mutmut:
these are tables of data sheets, typical sizes, and named thresholds with a documented origin, which no test
should repeat. - Beyond both tools: min becomes max, sin becomes cos, any becomes all, and a call for its side
effect is removed. Strings are unchanged.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_SWAPPED_OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"), ast.Mod: ("%", "*"), ast.Pow: ("**", "*"), ast.MatMult: ("@", "*"),
    ast.LShift: ("<<", ">>"), ast.RShift: (">>", "<<"), ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&"),
    ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
_EXCLUDED_FIELDS = ("annotation", "returns", "decorator_list", "type_params")
_LARGE_INTEGER = 1000
"""Above this, an integer is increased by half, as an increment of 1 would be negligible."""
_SWAPPED_CALLS = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """A change of one source file.

    path: of the file, relative to the root of the project
    start, end: range of bytes that `new` replaces
    """

    path: str
    line: int
    start: int
    end: int
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.old.strip()} -> {self.new.strip()}"


def list_mutants(path: str, source: str) -> Iterator[Mutant]:
    """Yield all mutants of a file in order, without annotations, docstrings, defaults and error texts.

    Assertions and `zip(..., strict=True)` are excluded: removing one that holds changes nothing.
    """
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    code = source.encode()

    def offset(node: Any, end: bool = False) -> int:
        line, column = (node.end_lineno, node.end_col_offset) if end else (node.lineno, node.col_offset)
        return starts[line - 1] + int(column)

    def mutate_operator(left: ast.AST, right: ast.AST, operator: ast.AST) -> Iterator[Mutant]:
        if type(operator) not in _SWAPPED_OPERATORS:
            return
        old, new = _SWAPPED_OPERATORS[type(operator)]
        first, last = offset(left, end=True), offset(right)
        position = code[first:last].find(old.encode())
        if position >= 0:
            yield build_mutant(right, first + position, first + position + len(old), new)

    def build_mutant(node: Any, start: int, end: int, new: str) -> Mutant:
        return Mutant(path, node.lineno, start, end, code[start:end].decode(), new)

    for node, in_function in _walk_behaviour(ast.parse(source)):
        if isinstance(node, ast.Constant) and not in_function:
            continue
        if isinstance(node, ast.BinOp):
            yield from mutate_operator(node.left, node.right, node.op)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from mutate_operator(left, right, node.op)
        elif isinstance(node, ast.Compare):
            for left, right, operator in zip(
                [node.left, *node.comparators], node.comparators, node.ops, strict=False
            ):
                yield from mutate_operator(left, right, operator)
        elif isinstance(node, ast.AugAssign):
            yield from mutate_operator(node.target, node.value, node.op)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
            yield build_mutant(node, offset(node), offset(node.operand), "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
            yield build_mutant(node, offset(node), offset(node, end=True), _change_constant(node.value))
        elif isinstance(node, ast.Call) and (name := _called_name(node.func)) in _SWAPPED_CALLS:
            end = offset(node.func, end=True)
            yield build_mutant(node, end - len(name), end, _SWAPPED_CALLS[name])
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield build_mutant(node, offset(node), offset(node, end=True), "None")


def _change_constant(value: bool | int | float) -> str:
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return repr(value + max(1, value // 2 if value > _LARGE_INTEGER else 0))
    return repr(value + max(1.0, value / 2.0))


def _called_name(function: ast.expr) -> str:
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def _walk_behaviour(node: ast.AST, in_function: bool = False) -> Iterator[tuple[ast.AST, bool]]:
    """Yield every node that affects behaviour, and whether it is inside a function."""
    yield node, in_function
    in_function = in_function or isinstance(node, ast.FunctionDef | ast.Lambda)
    for name, value in ast.iter_fields(node):
        if name in _EXCLUDED_FIELDS or isinstance(node, ast.Raise | ast.Assert):
            continue
        if isinstance(node, ast.keyword) and node.arg == "strict":
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_text(child) and not isinstance(child, ast.arguments):
                yield from _walk_behaviour(child, in_function)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Expr):
        node = node.value
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
