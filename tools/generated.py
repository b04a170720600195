"""Shared code of the tools that generate files: fill marked blocks, write the files or check them."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path


def fill(text: str, blocks: dict[str, str]) -> str:
    """Return `text` with each block between its markers replaced.

    Raises ValueError when a block has no pair of markers in the text.
    """
    for name, block in blocks.items():
        opening, closing = f"<!-- generated: {name} -->", f"<!-- end: {name} -->"
        head, has_opening, remainder = text.partition(opening)
        _, has_closing, tail = remainder.partition(closing)
        if not (has_opening and has_closing):
            raise ValueError(f"no markers {opening} .. {closing}")
        text = f"{head}{opening}\n{block}\n{closing}{tail}"
    return text


def write_or_check(
    outputs: Callable[[], dict[Path, str]],
    root: Path,
    tool: str,
    description: str | None,
    arguments: list[str] | None,
) -> int:
    """Run the command line of a tool that generates files; return its exit code.

    outputs: function that returns every generated file with its text. root: printed names are relative to it.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit 1 when a file is out of date"
    )
    check = parser.parse_args(arguments).check
    wanted = outputs()
    stale = [p for p, text in wanted.items() if not p.exists() or p.read_text(encoding="utf-8") != text]
    if check and stale:
        names = ", ".join(str(path.relative_to(root)) for path in stale)
        print(f"out of date: {names}; run {tool}", file=sys.stderr)
        return 1
    for path in stale:
        path.write_text(wanted[path], encoding="utf-8")
        print(f"wrote {path.relative_to(root)}")
    return 0
