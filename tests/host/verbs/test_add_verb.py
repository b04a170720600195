"""The recipe "add a verb" of CONTRIBUTING.md, carried out in a copy of the package."""

import json

import pytest

from package_copy import ROOT, PackageCopy

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
    "host/verbs/test_options.py",
    "host/verbs/test_every_option.py::test_every_option_of_every_verb_has_a_command_line_that_changes_it",
    "host/api/test_public_names.py",
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Return a copy of the package with one more verb: one file and one line."""
    root = tmp_path_factory.mktemp("copy")
    copy = PackageCopy(root / "host")
    for name in ("firmware", "protocol"):
        (root / name).symlink_to(ROOT / name)
    (copy.package / "verbs" / "where.py").write_text(VERB, "utf-8")
    copy.replace("verbs/__init__.py", ('    "completion":', f'{LINE}    "completion":'))
    return copy


def test_a_new_verb_is_one_file_and_one_line(copy: PackageCopy) -> None:
    assert json.loads(copy.run("-m", "hubodo", "where", "--json"))["folder"] == str(copy.package)
    help_text = copy.run("-m", "hubodo", "where", "--help")
    assert "print the folder of the installed package" in help_text and "hubodo where" in help_text
    assert "    where  " in copy.run("-m", "hubodo", "--help")


@pytest.mark.repeat
def test_no_other_test_fails_for_a_new_verb(copy: PackageCopy) -> None:
    assert copy.run_tests(*OTHER_TESTS)
