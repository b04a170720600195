"""Which test files reach a source file, nearest first: by who imports whom."""

from __future__ import annotations

import ast
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

_UNSEEN = 4
"""Steps to a firmware file from a test that runs the firmware and does not import it."""
_RUN_FIRMWARE = ("tests/firmware/", "tests/signal_path/")


def nearest_tests(root: Path, paths: Iterable[str]) -> dict[str, list[str]]:
    """For each path the test files that import it, directly or through others, by the number of steps.

    Tests of the firmware and of whole nodes may also load its files into another interpreter: all of them
    reach every one of its files, behind those that import it. A name that shares words with the file's, or
    with its folder's, counts as so many steps less. Between equals the smaller test file goes first.
    """
    files = {_module(root, path): path for path in _sources(root)}
    imports = {module: set(_imports(path, module, files)) for module, path in files.items()}
    for module, path in files.items():
        # A package that imports its modules by name, as that of the verbs, uses all of them.
        if path.name == "__init__.py" and "import_module" in path.read_text("utf-8"):
            imports[module] |= {name for name in files if name.rpartition(".")[0] == module}
    users: dict[str, set[str]] = {module: set() for module in files}
    for module, used in imports.items():
        for name in used:
            users[name].add(module)
    return {path: _tests_of(root, path, files, users) for path in paths}


def _tests_of(root: Path, path: str, files: dict[str, Path], users: dict[str, set[str]]) -> list[str]:
    start = _module(root, root / path)
    steps = {start: 0}
    queue = deque([start])
    while queue:
        module = queue.popleft()
        for user in users.get(module, ()):
            if user not in steps:
                steps[user] = steps[module] + 1
                queue.append(user)
    words = {word for part in Path(path).with_suffix("").parts[-2:] for word in part.split("_")}
    found: list[tuple[tuple[int, int, int], str]] = []
    for module, file in files.items():
        name = str(file.relative_to(root))
        if not file.name.startswith("test_"):
            continue
        by_name = path.startswith("firmware/") and name.startswith(_RUN_FIRMWARE)
        if module in steps or by_name:
            shared = len(words & set(file.stem.split("_")))
            found.append(((steps.get(module, _UNSEEN) - shared, -shared, file.stat().st_size), name))
    return [name for _, name in sorted(found)]


def _sources(root: Path) -> Iterator[Path]:
    for folder in ("host", "protocol", "firmware", "tests"):
        yield from sorted((root / folder).rglob("*.py"))


def _module(root: Path, path: Path) -> str:
    parts = list(path.relative_to(root).with_suffix("").parts)
    if parts[0] in ("host", "protocol", "firmware", "tests"):
        parts = parts[1:]
    return ".".join(part for part in parts if part != "__init__")


def _imports(path: Path, module: str, files: dict[str, Path]) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            # A helper beside a test is imported by its bare name.
            beside = f"{module.rpartition('.')[0]}.{name}"
            yield from (known for known in (name, beside) if known in files)
