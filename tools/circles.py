"""Check that no modules import each other in a circle, imports within functions included.

    python tools/circles.py

Prints the modules of a circle, with exit code 1. `tools/check` runs it.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("host", "protocol", "firmware")
LOADED_AT_RUN_TIME = {("node", "node_choice")}
"""Imports that are not followed: `main` of node.py loads the kind of node that the settings ask for."""


def main() -> int:
    """Print a circle of each folder and return the exit code."""
    circles = [find_circle(read_modules(ROOT / folder)) for folder in FOLDERS]
    for circle in filter(None, circles):
        print(" -> ".join(circle))
    return int(any(circles))


def read_modules(folder: Path) -> dict[str, str]:
    """Return the source of all modules below a folder, by their dotted names."""
    paths = {path: path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py")}
    return {
        ".".join(name.parts).removesuffix(".__init__"): path.read_text("utf-8")
        for path, name in paths.items()
    }


def find_circle(sources: Mapping[str, str]) -> list[str]:
    """Return the modules of a circle in their order, the first one at both ends, or an empty list."""
    imports = {
        module: {
            name
            for name in _imported(ast.parse(source), sources)
            if name != module and (module, name) not in LOADED_AT_RUN_TIME
        }
        for module, source in sources.items()
    }
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def _imported(tree: ast.AST, modules: Mapping[str, str]) -> Iterator[str]:
    """Yield the modules that a tree imports, without those for type checkers alone."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in modules else node.module for name in names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        yield from _imported(node, modules)


if __name__ == "__main__":
    sys.exit(main())
