"""`tools/words.py` reports banned words in names, docstrings, comments, strings and documents."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import words

ROOT = Path(__file__).parents[2]
RULES = words.read_rules()
CLEAN = '''"""Read a file."""


class RollbackBuffer:
    """A ring buffer of filter snapshots for rollback."""

    def push(self, snapshot):
        """Append a snapshot."""
        self.newest = snapshot
'''


def reports(source, path="host/hubodo/planted.py", rules=RULES):
    return list(words.check_python(path, source, rules))


def test_plain_code_is_not_reported():
    assert reports(CLEAN) == []


@pytest.mark.parametrize(
    ("planted", "line", "word"),
    [
        ("class Grip:\n    pass\n", 10, "Grip"),
        ("def look(x):\n    return x\n", 10, "look"),
        ("def read(told):\n    return told\n", 10, "told"),
        ("_LONGEST = 5.0\n", 10, "LONGEST"),
        ("def f(self):\n    self.n_kept = 1\n", 11, "kept"),
        ("def f():\n    heardBefore = 1\n", 11, "heard"),
        ('def f():\n    """What was found."""\n', 11, "what"),
        ('def f():\n    """Of all nodes."""\n', 11, "of"),
        ("# the filter starts anew\n", 10, "anew"),
        ('MESSAGE = "what remains is unknown"\n', 10, "what remains"),
        ('TEXT = """Both lines\nare left\nover here."""\n', 11, "left over"),
    ],
)
def test_each_kind_of_banned_word_is_reported_with_its_line(planted, line, word):
    (report,) = reports(CLEAN + planted)
    assert report.startswith(f"host/hubodo/planted.py:{line}: ")
    assert repr(word) in report


def test_a_part_of_a_longer_word_is_not_reported():
    assert reports(CLEAN + "worthless, _MOSTLY, lookup, unheardof = 1, 2, 3, 4\n") == []


def test_an_exception_holds_for_its_word_in_its_files_alone():
    rules = replace(RULES, exceptions=[{"word": "found", "where": "host/hubodo/gap/*", "why": "JSON key"}])
    source = CLEAN + "found = 1\n"
    assert reports(source, "host/hubodo/gap/explain/result.py", rules) == []
    assert len(reports(source, "host/hubodo/log/result.py", rules)) == 1
    assert len(reports(CLEAN + "told = 1\n", "host/hubodo/gap/explain/result.py", rules)) == 1


def test_documents_are_checked_for_phrases_with_their_lines():
    text = "# Title\n\nThe search starts anew.\nMade of steel.\n"
    assert list(words.check_document("README.md", text, RULES)) == ["README.md:3: 'anew' is a banned phrase"]


def test_every_exception_has_a_reason_and_matches_a_file():
    paths = list(words.files([*words.FOLDERS, *(it.name for it in ROOT.glob("*.md"))]))
    for exception in RULES.exceptions:
        assert exception["why"]
        assert any(words.fnmatch(path, exception["where"]) for path in paths), exception


def test_the_check_of_the_project_fails_for_a_word_planted_in_a_copy(tmp_path):
    copy = tmp_path / "project"
    (copy / "tools").mkdir(parents=True)
    for name in ("words.py", "banned_words.toml"):
        shutil.copy(ROOT / "tools" / name, copy / "tools" / name)
    planted = copy / "firmware" / "planted.py"
    planted.parent.mkdir()
    for source, status in ((CLEAN, 0), (CLEAN + "def unhear():\n    pass\n", 1)):
        planted.write_text(source)
        command = [sys.executable, "tools/words.py", "--under", "firmware"]
        run = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
        assert run.returncode == status, run.stdout + run.stderr
        assert ("firmware/planted.py:10" in run.stdout) == bool(status)
