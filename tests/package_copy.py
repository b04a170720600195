"""A copy of the package in which a recipe of CONTRIBUTING.md is carried out, and runs of Python with it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


class PackageCopy:
    """A copy of `host/hubodo` in a folder, which `run` imports instead of the original.

    Attributes
    ----------
    package : the folder `hubodo` of the copy.
    """

    def __init__(self, folder: Path) -> None:
        self.package = folder / "hubodo"
        # With times of change and bytecode, so that only changed files are compiled again.
        shutil.copytree(ROOT / "host/hubodo", self.package)
        paths = (folder, ROOT / "protocol", ROOT / "tests")
        self._environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "COLUMNS": "200"}

    def replace(self, file: str, *changes: tuple[str, str]) -> None:
        """Replace texts, each of which occurs once, in a file of the package."""
        path = self.package / file
        text = path.read_text("utf-8")
        for old, new in changes:
            assert text.count(old) == 1, f"{file}: {old!r} occurs {text.count(old)} times"
            text = text.replace(old, new)
        path.write_text(text, "utf-8")

    def add_lines(self, file: str, *lines: tuple[str, str]) -> None:
        """Add a line after each line of a file, given as (line, line to add)."""
        self.replace(file, *((anchor, f"{anchor}\n{line}") for anchor, line in lines))

    def run(self, *arguments: object) -> str:
        """Run Python with arguments in the folder of the tests and return its output; it must succeed."""
        command = [sys.executable, *map(str, arguments)]
        completed = subprocess.run(
            command, cwd=ROOT / "tests", env=self._environment, capture_output=True, text=True, timeout=300
        )
        assert completed.returncode == 0, completed.stdout[-3000:] + completed.stderr[-3000:]
        return completed.stdout

    def run_tests(self, *arguments: str) -> list[str]:
        """Run tests, whose paths are relative to the folder of the tests, and return those that passed.

        None may fail.
        """
        options = ("-o", "addopts=", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:anyio", "-rp")
        return re.findall(r"^PASSED (.+)$", self.run("-m", "pytest", *options, *arguments), re.MULTILINE)
