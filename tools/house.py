"""What a reader of the package may count on: one meaning for a public class name, short functions and files.

    python tools/house.py

Prints what breaks the rules, one line each; exit code 1 then. `tools/check` runs it.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("host/hubodo", "protocol/hubowire", "firmware")
LONGEST_FUNCTION, LONGEST_FILE = 60, 400
# What is run in an emulated board, or on a real one, has the names of what it stands for there.
OTHER_WORLDS = (
    "firmware",
    "host/hubodo/emulator/interpreters/cpython",
    "host/hubodo/emulator/interpreters/modules",
)


def main() -> int:
    """Looks through all of it."""
    broken = list(_broken())
    for line in broken:
        print(line)
    return int(bool(broken))


def _broken() -> Iterator[str]:
    classes: dict[str, list[str]] = defaultdict(list)
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text("utf-8")
            tree = ast.parse(text)
            if (lines := text.count("\n")) > LONGEST_FILE:
                yield f"{name}: {lines} lines; at most {LONGEST_FILE}"
            yield from _long_functions(name, tree)
            for node in tree.body:
                if (
                    isinstance(node, ast.ClassDef)
                    and not node.name.startswith("_")
                    and not name.startswith(OTHER_WORLDS)
                ):
                    classes[node.name].append(name)
    for name, places in sorted(classes.items()):
        if len(places) > 1:
            yield f"class {name} means {len(places)} things: {', '.join(places)}"


def _long_functions(name: str, tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > LONGEST_FUNCTION:
                yield f"{name}:{node.lineno}: {node.name} has {lines} lines; at most {LONGEST_FUNCTION}"


if __name__ == "__main__":
    sys.exit(main())
