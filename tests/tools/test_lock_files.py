"""Lock files: every installed package has a locked version and the hashes of its files."""

import json
import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOCKS = ("requirements.lock", "requirements-node.lock", "tools/stubs-rp2.lock", "tools/stubs-esp32.lock")


@pytest.mark.parametrize("name", LOCKS)
def test_every_version_of_a_lock_file_has_hashes(name):
    text = (ROOT / name).read_text().replace("\\\n", " ")
    pins = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    assert pins
    for pin, *hashes in pins:
        assert re.fullmatch(r"[\w.-]+==[\w.]+", pin), pin
        assert hashes and all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", digest) for digest in hashes), pin


def test_the_set_up_installs_nothing_from_a_lock_file_without_its_hash():
    script = (ROOT / "tools" / "setup").read_text().replace("\\\n", " ")
    installs = [shlex.split(line) for line in script.splitlines() if " pip install " in line]
    locked = [command for command in installs if "-r" in command]
    assert {command[command.index("-r") + 1] for command in locked} == {
        "requirements.lock", "tools/stubs-$board.lock", "requirements-node.lock"
    }  # fmt: skip
    assert all("--require-hashes" in command for command in locked)
    others = [command for command in installs if command not in locked]
    assert others and all({"--no-deps", "--no-build-isolation"} <= set(command) for command in others)


def test_every_package_of_node_has_its_integrity():
    packages = json.loads((ROOT / "package-lock.json").read_text())["packages"]
    assert all("integrity" in package for name, package in packages.items() if name)
