"""The recipe "add a verb" of CONTRIBUTING.md, carried out in a copy of the package."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
VERB = '''"""`hubodo where`: print the folder of the installed package."""

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

import hubodo

EXAMPLE = "hubodo where"


@dataclass(frozen=True)
class WhereResult:
    """The folder of the installed package."""

    folder: str

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return asdict(self)

    def render(self, console: Console) -> None:
        """Print the folder."""
        console.print(self.folder)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no arguments: the verb has none."""


def run(args: argparse.Namespace) -> WhereResult:
    """Return the folder of the package."""
    return WhereResult(str(Path(hubodo.__file__).parent))
'''
LINE = '    "where": "print the folder of the installed package",\n'
OTHER_TESTS = (
    "verbs/test_options.py",
    "verbs/test_every_option.py::test_every_option_of_every_verb_has_a_command_line_that_changes_it",
    "api/test_public_names.py",
)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    package = tmp_path / "host" / "hubodo"
    shutil.copytree(ROOT / "host" / "hubodo", package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("firmware", "protocol"):
        (tmp_path / name).symlink_to(ROOT / name)
    (package / "verbs" / "where.py").write_text(VERB, "utf-8")
    table = package / "verbs" / "__init__.py"
    text = table.read_text("utf-8")
    assert text.count('    "completion":') == 1
    table.write_text(text.replace('    "completion":', f'{LINE}    "completion":'), "utf-8")
    return tmp_path


def run(copy: Path, *words: str) -> subprocess.CompletedProcess[str]:
    paths = (copy / "host", ROOT / "protocol", ROOT / "tests")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, *words], cwd=copy, env=environment, capture_output=True, text=True, timeout=300
    )


def test_a_new_verb_is_one_file_and_one_line_and_no_other_test_fails(copy: Path):
    done = run(copy, "-m", "hubodo", "where", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["folder"] == str(copy / "host" / "hubodo")
    help_text = run(copy, "-m", "hubodo", "where", "--help").stdout
    assert "print the folder of the installed package" in help_text and "hubodo where" in help_text
    assert "    where  " in run(copy, "-m", "hubodo", "--help").stdout
    files = [str(ROOT / "tests" / "host" / name) for name in OTHER_TESTS]
    done = run(copy, "-m", "pytest", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml"), *files)
    assert done.returncode == 0, done.stdout[-3000:]
