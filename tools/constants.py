"""Check that a constant's name means one value: no two modules may give one private name different values.

    python tools/constants.py [--under FOLDER]

Prints each such name with its places. With `--under` only names that a module of that folder defines.
Exit code 1 if there is one. Registers and bits in `firmware/drivers` are exempt: their data sheets name them.
`tools/check` runs it for the rooms that `tools/banned_words.toml` lists.
"""

from __future__ import annotations

import argparse
import ast
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("host/hubodo", "protocol/hubowire", "firmware")
EXEMPT = ("firmware/drivers/",)

Definitions = dict[str, dict[str, list[str]]]
"""For each name, for each value as source text, the places that define it so."""


def constants(tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Yield line, name and value of each private constant of a module."""
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        value = getattr(node, "value", None)
        if not isinstance(target, ast.Name) or value is None:
            continue
        if target.id.startswith("_") and target.id.isupper():
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "const":
                value = value.args[0]
            yield node.lineno, target.id, ast.unparse(value)


def definitions() -> Definitions:
    """Collect the private constants of all modules."""
    defined: Definitions = defaultdict(lambda: defaultdict(list))
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            place = path.relative_to(ROOT).as_posix()
            if place.startswith(EXEMPT):
                continue
            for line, name, value in constants(ast.parse(path.read_text("utf-8"))):
                defined[name][value].append(f"{place}:{line}")
    return defined


def collisions(defined: Definitions, under: Sequence[str]) -> Iterator[str]:
    """Yield a line for each name with more than one value of which one is defined in one of the folders."""
    for name, values in sorted(defined.items()):
        places = [place for group in values.values() for place in group]
        if len(values) > 1 and any(place.startswith(tuple(under)) for place in places):
            yield f"{name} has {len(values)} values: {', '.join(places)}"


def main() -> int:
    """Run the check; return 1 if a name has two values."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--under", metavar="FOLDER", action="append", help="names that this folder defines")
    under = parser.parse_args().under
    if under is None:
        under = tomllib.loads((ROOT / "tools" / "banned_words.toml").read_text("utf-8"))["rooms"]
    broken = list(collisions(definitions(), under))
    print("\n".join(broken), end="\n" if broken else "")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
