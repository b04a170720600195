"""The examples in docstrings, README and documentation run and print the output shown."""

import doctest
import math
import pickle
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

import hubodo
from hubodo.api import gap_search
from in_process import hubodo as run

ROOT = Path(__file__).resolve().parents[3]
MODULES = ["hubodo.api.files", "hubodo.api.read", "hubodo.api.channel_methods", "hubodo.api.simulate"]
PAGES = [ROOT / "README.md", *sorted((ROOT / "host" / "docs").rglob("*.md"))]


def blocks(page, language):
    """Return the fenced blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def missing_effects():
    """Return the results of all searches so far."""
    return {}


@pytest.fixture
def search_once(missing_effects, monkeypatch):
    """Search the same log with the same model only once, as several pages show the same search."""
    find = gap_search.find_gap

    def find_or_look_up(recording, model, *, accept, reject, **options):
        asked = pickle.dumps((recording, model, accept, reject))
        if asked not in missing_effects:
            missing_effects[asked] = find(recording, model, accept=accept, reject=reject, **options)
        return missing_effects[asked]

    monkeypatch.setattr(gap_search, "find_gap", find_or_look_up)


def page_params(pages):
    return [pytest.param(page, id=page.relative_to(ROOT).as_posix()) for page in pages]


@pytest.mark.parametrize("module", MODULES)
def test_the_examples_of_a_module_run(module, examples, monkeypatch):
    monkeypatch.chdir(examples)
    done = doctest.testmod(import_module(module))
    assert done.attempted and not done.failed


@pytest.mark.parametrize("page", page_params(page for page in PAGES if blocks(page, "pycon")))
def test_the_python_examples_of_a_page_run(page, examples, search_once, monkeypatch):
    monkeypatch.chdir(examples)
    text = "\n".join(blocks(page, "pycon"))
    test = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    done = doctest.DocTestRunner().run(test)
    assert done.attempted and not done.failed


@pytest.mark.parametrize("page", page_params(page for page in PAGES if blocks(page, "sh")))
def test_the_commands_of_a_page_run(page, examples, monkeypatch):
    monkeypatch.chdir(examples)
    # On a slow computer a verb prints its progress after ten seconds, which is no error.
    monkeypatch.setattr("hubodo.progress._LINE_INTERVAL", math.inf)
    lines = [line.partition("#")[0] for block in blocks(page, "sh") for line in block.splitlines()]
    assert len(lines) > 3
    for line in lines:
        done = run(*shlex.split(line)[1:])
        assert (done.code, done.err) == (0, ""), line


def test_the_files_of_the_first_drive_are_those_of_the_examples(examples):
    vehicle, model_tables = (
        re.sub(r" *#.*", "", text) for text in blocks(ROOT / "host/docs/first-drive.md", "toml")
    )
    assert hubodo.load_vehicle(examples / "vehicle.toml") == hubodo.load_vehicle(examples / "model.toml")
    (examples / "from_page.toml").write_text(vehicle)
    assert hubodo.load_vehicle(examples / "from_page.toml") == hubodo.load_vehicle(examples / "vehicle.toml")
    (examples / "from_page.toml").write_text(vehicle + model_tables)
    assert hubodo.read_model(examples / "from_page.toml") == hubodo.read_model(examples / "model.toml")


def test_every_public_name_is_listed_once_and_accessible():
    listed = set(hubodo._MODULE_OF_NAME) | {"__version__"}
    assert sorted(hubodo.__all__) == sorted(listed)
    for name in hubodo.__all__:
        assert getattr(hubodo, name) is not None
    assert set(hubodo.__all__) <= set(dir(hubodo))
    with pytest.raises(AttributeError, match="no attribute 'opne'"):
        hubodo.opne  # noqa: B018
