"""Test files that import a source file, directly or indirectly, nearest first."""

from __future__ import annotations

import ast
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

_STEPS_WITHOUT_IMPORT = 4
"""Distance of a firmware file from a test that runs the firmware without importing it."""
_FIRMWARE_TEST_FOLDERS = ("tests/firmware/", "tests/signal_path/")


def nearest_tests(root: Path, paths: Iterable[str]) -> dict[str, list[str]]:
    """Return for each path the test files that import it, ranked by the number of import steps.

    Tests of the firmware and of complete nodes may load firmware files into another interpreter; they are
    listed for every firmware file, after tests that import it. Each word that a test name shares with the
    name of the file or its folder counts as one step less. Of equal tests, the smaller file comes first.
    """
    path_by_module = {_module_name(root, path): path for path in _list_sources(root)}
    imports = {
        module: set(_list_imports(path, module, path_by_module)) for module, path in path_by_module.items()
    }
    for module, path in path_by_module.items():
        # A package that imports its modules by name at run time, such as the verbs, uses all of them.
        if path.name == "__init__.py" and "import_module" in path.read_text("utf-8"):
            imports[module] |= {name for name in path_by_module if name.rpartition(".")[0] == module}
    importers: dict[str, set[str]] = {module: set() for module in path_by_module}
    for module, imported in imports.items():
        for name in imported:
            importers[name].add(module)
    return {path: _rank_tests(root, path, path_by_module, importers) for path in paths}


def _rank_tests(
    root: Path, path: str, path_by_module: dict[str, Path], importers: dict[str, set[str]]
) -> list[str]:
    start_module = _module_name(root, root / path)
    steps = {start_module: 0}
    queue = deque([start_module])
    while queue:
        module = queue.popleft()
        for user in importers.get(module, ()):
            if user not in steps:
                steps[user] = steps[module] + 1
                queue.append(user)
    name_parts = {word for part in Path(path).with_suffix("").parts[-2:] for word in part.split("_")}
    ranked: list[tuple[tuple[int, int, int], str]] = []
    for module, file in path_by_module.items():
        name = str(file.relative_to(root))
        if not file.name.startswith("test_"):
            continue
        runs_firmware = path.startswith("firmware/") and name.startswith(_FIRMWARE_TEST_FOLDERS)
        if module in steps or runs_firmware:
            n_shared = len(name_parts & set(file.stem.split("_")))
            ranked.append(
                ((steps.get(module, _STEPS_WITHOUT_IMPORT) - n_shared, -n_shared, file.stat().st_size), name)
            )
    return [name for _, name in sorted(ranked)]


def _list_sources(root: Path) -> Iterator[Path]:
    for folder in ("host", "protocol", "firmware", "tests"):
        yield from sorted((root / folder).rglob("*.py"))


def _module_name(root: Path, path: Path) -> str:
    parts = list(path.relative_to(root).with_suffix("").parts)
    if parts[0] in ("host", "protocol", "firmware", "tests"):
        parts = parts[1:]
    return ".".join(part for part in parts if part != "__init__")


def _list_imports(path: Path, module: str, path_by_module: dict[str, Path]) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            # A helper in the folder of a test is imported without its package.
            sibling = f"{module.rpartition('.')[0]}.{name}"
            yield from (candidate for candidate in (name, sibling) if candidate in path_by_module)
