"""`pip install hubodo` in a new environment: complete, without checkout or compiler."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

import hubodo
from hubodo.flash.image import firmware_folder, read_sources

pytestmark = pytest.mark.release

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
OPEN_LOG = """
import hubodo
from pathlib import Path
(path,) = Path("demo").rglob("drive.mcap")
log = hubodo.open(path)
print(Path(hubodo.__file__).parent)
print(list(log.nodes), len(log.fuse().t) > 50)
"""


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Build the source archive of this tree and the wheel from that archive; return their folder."""
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
def environment_folder(dist, tmp_path_factory):
    """Create an environment with the wheel; its dependencies are those of this environment."""
    home = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    python = home / "bin" / "python"
    (wheel,) = dist.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-index", "--no-deps"]
    # Compile only the files that are run.
    subprocess.run([*pip, "--no-compile", wheel], check=True, capture_output=True)
    (site,) = home.glob("lib/python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return home


def run(environment_folder, folder, *words):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment["OPENBLAS_NUM_THREADS"] = "1"
    command = [environment_folder / "bin" / words[0], *words[1:]]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


def test_the_wheel_is_pure_python(dist):
    assert [path.name.partition("-py3")[2] for path in dist.glob("*.whl")] == ["-none-any.whl"]


def test_the_installed_package_contains_every_firmware_file(environment_folder, tmp_path):
    find = "from hubodo.flash.image import firmware_folder; print(firmware_folder())"
    done = run(environment_folder, tmp_path, "python", "-c", find)
    folder = Path(done.stdout.strip())
    assert folder.is_relative_to(environment_folder), done.stderr
    assert read_sources(folder) == read_sources(firmware_folder())
    done = run(environment_folder, tmp_path, "hubodo", "flash", "--help")
    assert done.returncode == 0 and "--roll-back" in done.stdout, done.stderr


@pytest.mark.repeat
def test_the_installed_package_runs_the_demo_and_opens_its_log(environment_folder, tmp_path):
    done = run(
        environment_folder, tmp_path, "hubodo", "demo", "--on", "cpython", "--moving", "5", "-o", "demo"
    )
    assert done.returncode == 0, done.stderr
    done = run(environment_folder, tmp_path, "python", "-c", OPEN_LOG)
    package_folder, summary = done.stdout.splitlines()
    assert Path(package_folder).is_relative_to(environment_folder) and summary == "['left', 'right'] True", (
        done.stderr
    )


def test_every_imported_package_is_declared():
    extras = PROJECT["optional-dependencies"]
    requirements = [
        requirement
        for name, required in extras.items()
        if name not in ("dev", "docs")
        for requirement in required
    ]
    declared = {
        _normalised_name(re.split(r"[\[<>=~; ]", requirement)[0])
        for requirement in (*PROJECT["dependencies"], *requirements)
    }
    importable = set().union(*map(_importable_names, declared))
    for path in (ROOT / "host" / "hubodo").rglob("*.py"):
        if "interpreters" in path.parts:
            continue
        for name in _imported_names(path):
            if name in sys.stdlib_module_names or name in ("hubodo", "hubowire"):
                continue
            assert name in importable, f"{path}: {name} belongs to no declared package"


def _normalised_name(name):
    return name.lower().replace("_", "-")


def _importable_names(package):
    """Return the importable top-level names of a package; if it is not installed, its own name."""
    try:
        installed = distribution(package)
    except PackageNotFoundError:
        return {package.replace("-", "_")}
    listed = installed.read_text("top_level.txt")
    names = listed.split() if listed else [file.parts[0] for file in installed.files or ()]
    return {name.removesuffix(".py") for name in names}


def _statements(node):
    """Yield the statements in a node, at any depth; most nodes of a file are expressions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        if isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _statements(child)


def _imported_names(path):
    for node in _statements(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.partition(".")[0]


def test_every_extra_is_explained():
    page = (ROOT / "host" / "docs" / "reference" / "extras.md").read_text("utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == set(PROJECT["optional-dependencies"])


def test_the_version_is_the_same_in_package_changelog_and_citation():
    newest = re.search(r"^## ([\d.]+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert newest[1] == cited[1] == hubodo.__version__
