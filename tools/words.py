"""Check that names, docstrings, comments and documents use the words of the field.

    python tools/words.py [--under FOLDER] [--all]

Prints each place that breaks `tools/banned_words.toml`, one a line, and exits with 1 if there is one. Without
an option it checks the rooms that the file lists; `--under` lists one folder or file, `--all` everything.
`tools/check` runs it.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("host", "protocol", "firmware", "tests", "tools")
SKIPPED = ("host/docs/out/*", "*/node_modules/*", "tests/fakes/micropython/*", "tests/tools/test_words.py")
"""Generated files, files of others, and the test that plants banned words."""

_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


@dataclass(frozen=True)
class Rules:
    """The lists of `banned_words.toml`."""

    rooms: Sequence[str]
    parts: frozenset[str]
    whole: frozenset[str]
    starts: Sequence[str]
    phrases: re.Pattern[str]
    exceptions: Sequence[dict[str, str]]

    def allows(self, word: str, path: str) -> bool:
        """Return True if an exception permits `word` in the file `path`."""
        return any(it["word"] == word and fnmatch(path, it["where"]) for it in self.exceptions)


def read_rules(path: Path = ROOT / "tools" / "banned_words.toml") -> Rules:
    """Read the lists of banned words."""
    data: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    phrases = "|".join(re.escape(phrase).replace(r"\ ", r"\s+") for phrase in data["text"]["phrases"])
    return Rules(
        data["rooms"],
        frozenset(data["names"]["parts"]),
        frozenset(data["names"]["whole"]),
        data["docstrings"]["starts"],
        re.compile(rf"\b(?:{phrases})\b", re.IGNORECASE),
        data.get("exceptions", ()),
    )


def check_python(path: str, text: str, rules: Rules) -> Iterator[str]:
    """Yield a line for each banned name, docstring, comment or string in a Python file."""
    tree = ast.parse(text)
    for line, name in defined_names(tree):
        bare = name.strip("_")
        bad = {bare} & rules.whole or {part.lower() for part in _PART.findall(bare)} & rules.parts
        for word in sorted(bad):
            if not rules.allows(word, path):
                yield f"{path}:{line}: name {name}: {word!r} is a banned word"
    for line, doc in docstrings(tree):
        first = doc.strip().split("\n\n")[0].lower()
        start = next((it for it in rules.starts if re.match(rf"{it}\b", first)), None)
        if start and not rules.allows(start, path):
            yield f"{path}:{line}: docstring begins with {start!r}: write a whole sentence"
    for line, sentence in written_text(tree, text):
        yield from _check_phrases(path, line, sentence, rules)


def check_document(path: str, text: str, rules: Rules) -> Iterator[str]:
    """Yield a line for each banned phrase of a document or page."""
    for number, line in enumerate(text.split("\n"), 1):
        yield from _check_phrases(path, number, line, rules)


def defined_names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of every class, function, argument and assigned variable or attribute."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of every docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            doc = ast.get_docstring(node)
            if doc:
                yield node.body[0].lineno, doc


def written_text(tree: ast.AST, text: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string and comment."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def _check_phrases(path: str, line: int, sentence: str, rules: Rules) -> Iterator[str]:
    for match in rules.phrases.finditer(sentence):
        word = re.sub(r"\s+", " ", match.group().lower())
        if not rules.allows(word, path):
            at = line + sentence.count("\n", 0, match.start())
            yield f"{path}:{at}: {word!r} is a banned phrase"


def check_file(path: str, rules: Rules) -> Iterator[str]:
    """Yield a line for each broken rule of one file, its path relative to the root."""
    text = (ROOT / path).read_text("utf-8")
    yield from (check_python if path.endswith(".py") else check_document)(path, text, rules)


def files(under: Sequence[str]) -> Iterator[str]:
    """Yield the checked files in any of the folders, or those files themselves, relative to the root."""
    listed = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")] + list(ROOT.glob("*.md"))
    for path in sorted(listed):
        name = path.relative_to(ROOT).as_posix()
        if path.suffix not in (".py", ".md", ".html", ".js") or any(fnmatch(name, it) for it in SKIPPED):
            continue
        if any(name == it or name.startswith(it.rstrip("/") + "/") for it in under):
            yield name


def main() -> int:
    """Run the check; return 1 if a rule is broken."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--under", metavar="FOLDER", action="append", help="list one folder or file")
    parser.add_argument("--all", action="store_true", help="list everything")
    args = parser.parse_args()
    rules = read_rules()
    under = args.under or ([*FOLDERS, *(it.name for it in ROOT.glob("*.md"))] if args.all else rules.rooms)
    broken = [line for path in files(under) for line in check_file(path, rules)]
    print("\n".join(broken), end="\n" if broken else "")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
