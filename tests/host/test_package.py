"""What `pip install hubodo` brings to an environment of its own: everything, without checkout or compiler."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest

import hubodo
from hubodo.flash.image import firmware_folder, read_sources

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
OPEN = """
import hubodo
from pathlib import Path
(path,) = Path("demo").rglob("drive.mcap")
log = hubodo.open(path)
print(Path(hubodo.__file__).parent)
print(list(log.nodes), len(log.fuse().t) > 50)
"""


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """The folder with the source archive of this tree, and the wheel that was built from it alone."""
    tree = tmp_path_factory.mktemp("tree")
    for name in ("host", "protocol", "firmware"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", "images")
        shutil.copytree(ROOT / name, tree / name, ignore=ignored)
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    build = [sys.executable, "-m", "build", "--no-isolation"]
    done = subprocess.run(build, cwd=tree, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return tree / "dist"


@pytest.fixture(scope="module")
def fresh(dist, tmp_path_factory):
    """A new environment with the wheel in it, which borrows the packages that it depends on from this one."""
    home = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    python = home / "bin" / "python"
    (wheel,) = dist.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-index", "--no-deps"]
    subprocess.run([*pip, wheel], check=True, capture_output=True)
    (site,) = home.glob("lib/python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return home


def run(fresh, folder, *words):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment["OPENBLAS_NUM_THREADS"] = "1"
    command = [fresh / "bin" / words[0], *words[1:]]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


def test_the_wheel_is_for_every_computer_and_needs_no_compiler(dist):
    assert [path.name.partition("-py3")[2] for path in dist.glob("*.whl")] == ["-none-any.whl"]


def test_an_installed_package_holds_the_firmware_file_by_file(fresh, tmp_path):
    find = "from hubodo.flash.image import firmware_folder; print(firmware_folder())"
    said = run(fresh, tmp_path, "python", "-c", find)
    folder = Path(said.stdout.strip())
    assert folder.is_relative_to(fresh), said.stderr
    assert read_sources(folder) == read_sources(firmware_folder())
    said = run(fresh, tmp_path, "hubodo", "flash", "--help")
    assert said.returncode == 0 and "--roll-back" in said.stdout, said.stderr


def test_an_installed_package_drives_virtual_nodes_and_opens_their_log(fresh, tmp_path):
    said = run(fresh, tmp_path, "hubodo", "demo", "--on", "cpython", "--moving", "5", "-o", "demo")
    assert said.returncode == 0, said.stderr
    said = run(fresh, tmp_path, "python", "-c", OPEN)
    place, found = said.stdout.splitlines()
    assert Path(place).is_relative_to(fresh) and found == "['left', 'right'] True", said.stderr


def test_every_import_is_of_a_package_that_is_declared():
    extras = PROJECT["optional-dependencies"]
    used = [word for name, words in extras.items() if name not in ("dev", "docs") for word in words]
    declared = {_plain(re.split(r"[\[<>=~; ]", word)[0]) for word in (*PROJECT["dependencies"], *used)}
    owned = set().union(*map(_modules, declared))
    for path in (ROOT / "host" / "hubodo").rglob("*.py"):
        if "interpreters" in path.parts:
            continue
        for name in _imported(path):
            if name in sys.stdlib_module_names or name in ("hubodo", "hubowire"):
                continue
            assert name in owned, f"{path}: {name} is of no package that is declared"


def _plain(name):
    return name.lower().replace("_", "-")


def _modules(package):
    """What can be imported of an installed package; of one that is not, what has its name."""
    try:
        found = files(package) or ()
    except PackageNotFoundError:
        return {package.replace("-", "_")}
    return {file.parts[0].removesuffix(".py") for file in found}


def _imported(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.partition(".")[0]


def test_every_extra_is_explained():
    page = (ROOT / "host" / "docs" / "reference" / "extras.md").read_text("utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == set(PROJECT["optional-dependencies"])


def test_the_version_is_the_same_wherever_it_stands():
    newest = re.search(r"^## ([\d.]+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert newest[1] == cited[1] == hubodo.__version__
