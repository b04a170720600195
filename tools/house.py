"""Check that names of public classes and of test files are unique, and that functions and files are short.

Docstrings do not count towards the lengths: public functions document each parameter.

    python tools/house.py

Prints one line for each violation, with exit code 1. `tools/check` runs it.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("host/hubodo", "protocol/hubowire", "firmware")
MAX_FUNCTION_LINES, MAX_FILE_LINES = 60, 400
# Code that runs on a board, real or emulated, uses the names of the modules it replaces.
BOARD_FOLDERS = (
    "firmware",
    "host/hubodo/emulator/interpreters/cpython",
    "host/hubodo/emulator/interpreters/modules",
)


def main() -> int:
    """Print all violations and return the exit code."""
    violations = list(_violations())
    for line in violations:
        print(line)
    return int(bool(violations))


def _violations() -> Iterator[str]:
    classes: dict[str, list[str]] = defaultdict(list)
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text("utf-8")
            tree = ast.parse(text)
            documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
            prose = sum(_docstring_lines(node) for node in ast.walk(tree) if isinstance(node, documented))
            if (lines := text.count("\n") - prose) > MAX_FILE_LINES:
                yield f"{name}: {lines} lines; at most {MAX_FILE_LINES}"
            yield from _long_functions(name, tree)
            for node in tree.body:
                if (
                    isinstance(node, ast.ClassDef)
                    and not node.name.startswith("_")
                    and not name.startswith(BOARD_FOLDERS)
                ):
                    classes[node.name].append(name)
    for name, places in sorted(classes.items()):
        if len(places) > 1:
            yield f"class {name} is defined {len(places)} times: {', '.join(places)}"
    yield from _equal_test_names(ROOT / "tests")


def _equal_test_names(folder: Path) -> Iterator[str]:
    """Yield a line for each name of several test files, which pytest cannot import beside each other."""
    places = defaultdict(list)
    for path in sorted(folder.rglob("test_*.py")):
        places[path.name].append(path.parent.relative_to(folder).as_posix())
    for name, folders in places.items():
        if len(folders) > 1:
            yield f"{name} is the name of {len(folders)} test files: in {', '.join(folders)}"


def _long_functions(name: str, tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1 - _docstring_lines(node)
            if lines > MAX_FUNCTION_LINES:
                yield f"{name}:{node.lineno}: {node.name} has {lines} lines; at most {MAX_FUNCTION_LINES}"


def _docstring_lines(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of lines of a docstring."""
    if ast.get_docstring(node, clean=False) is None:
        return 0
    first = node.body[0]
    return (first.end_lineno or first.lineno) - first.lineno + 1


if __name__ == "__main__":
    sys.exit(main())
