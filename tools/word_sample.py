"""Print random public names and random docstrings or comments with file and line, for a reader to judge.

    python tools/word_sample.py --seed N [--under FOLDER]

The reader, an engineer of the field who does not know this code, marks each as clear, odd or misleading.
"""

from __future__ import annotations

import argparse
import ast
import io
import random
import sys
import textwrap
import tokenize
from collections.abc import Iterator
from pathlib import Path

from words import docstrings, files

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("host", "protocol", "firmware", "tools")
N_NAMES = N_TEXTS = 120


def public_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and description of each public class, function with its arguments, field and constant."""
    for node in tree.body:
        yield from _names_of(node, "")
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for member in node.body:
                yield from _names_of(member, f"{node.name}.")


def _names_of(node: ast.stmt, prefix: str) -> Iterator[tuple[int, str]]:
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
        yield node.lineno, f"class {prefix}{node.name}"
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
        arguments = ", ".join(it.arg for it in node.args.args + node.args.kwonlyargs if it.arg != "self")
        yield node.lineno, f"def {prefix}{node.name}({arguments})"
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            if isinstance(target, ast.Name) and not target.id.startswith("_"):
                yield (
                    node.lineno,
                    f"{prefix}{target.id} = {ast.unparse(node.value)[:60] if node.value else '...'}",
                )


def texts(source: str, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of each docstring and comment: lines of one comment together, code before it."""
    yield from docstrings(tree)
    block: list[str] = []
    start = last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or token.string.startswith(("#!", "# type:", "# noqa", "# fmt:")):
            continue
        text = token.string.lstrip("# ")
        if not token.line.lstrip().startswith("#"):
            yield token.start[0], f"{token.line[: token.start[1]].strip()}  # {text}"
            continue
        if block and token.start[0] != last + 1:
            yield start, " ".join(block)
            block = []
        if not block:
            start = token.start[0]
        last = token.start[0]
        block.append(text)
    if block:
        yield start, " ".join(block)


def main() -> int:
    """Print the sample of a seed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument(
        "--seed", type=int, required=True, help="seed of the draw; the same seed, the same draw"
    )
    parser.add_argument("--under", metavar="FOLDER", action="append", help="draw from this folder alone")
    args = parser.parse_args()
    names: list[tuple[str, str]] = []
    sentences: list[tuple[str, str]] = []
    for path in files(args.under or ROOMS):
        if path.endswith(".py"):
            source = (ROOT / path).read_text("utf-8")
            tree = ast.parse(source)
            names += [(f"{path}:{line}", text) for line, text in public_names(tree)]
            sentences += [(f"{path}:{line}", text) for line, text in texts(source, tree)]
    rng = random.Random(args.seed)
    print(f"seed {args.seed}: {N_NAMES} of {len(names)} names")
    print(f"and {N_TEXTS} of {len(sentences)} docstrings and comments\n")
    for number, (place, text) in enumerate(rng.sample(names, min(N_NAMES, len(names))), 1):
        print(f"N{number:03} {place}: {text}")
    print()
    for number, (place, text) in enumerate(rng.sample(sentences, min(N_TEXTS, len(sentences))), 1):
        print(f"T{number:03} {place}:\n{textwrap.indent(text, '     ')}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
