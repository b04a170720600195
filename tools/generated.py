"""Files that follow from the code: written, or checked to be what they would be written as."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path


def fill(text: str, blocks: dict[str, str]) -> str:
    """`text` with each block between its markers replaced.

    Raises ValueError when a block has no pair of markers in the text.
    """
    for name, block in blocks.items():
        begin, end = f"<!-- generated: {name} -->", f"<!-- end: {name} -->"
        head, found_begin, rest = text.partition(begin)
        _, found_end, tail = rest.partition(end)
        if not (found_begin and found_end):
            raise ValueError(f"no markers {begin} .. {end}")
        text = f"{head}{begin}\n{block}\n{end}{tail}"
    return text


def write_or_check(
    outputs: Callable[[], dict[Path, str]],
    root: Path,
    tool: str,
    description: str | None,
    arguments: list[str] | None,
) -> int:
    """The command line of a tool that generates files; returns its exit code.

    outputs: every generated file with the text it should have. root: what the names are told from.
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
