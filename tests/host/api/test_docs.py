"""The documentation site builds without a warning, is complete and loads nothing from the network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import hubodo
from hubodo.verbs import VERBS

pytestmark = pytest.mark.release

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site with the stored notebook, which runs in a separate test."""
    folder = tmp_path_factory.mktemp("site")
    arguments = ("build", "--strict", "--quiet", "-f", ROOT / "host" / "mkdocs.yml", "-d", folder)
    environment = {**os.environ, "DOCS_EXECUTE": "false", "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", *arguments], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    return folder


def test_a_page_loads_nothing_from_the_network(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 15
    for page in pages:
        text = page.read_text("utf-8")
        external = re.findall(
            r"<(?!a )[^>]*(?:src|href)=.?https?://|import\(.?https?://|url\(.?https?://", text
        )
        assert not external, page
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(.?https?:|@import", style.read_text("utf-8")), style


def test_equations_are_images_with_a_text_for_screen_readers(site):
    page = (site / "methods" / "allan.html").read_text("utf-8")
    assert page.count('<svg role="img"') == 3 and "$$" not in page
    assert "currentColor" in page and 'aria-label="\\sigma^2(\\tau) = ' in page


def test_the_reference_has_every_public_name_and_every_verb(site):
    python = (site / "reference" / "python.html").read_text("utf-8")
    for name in set(hubodo.__all__) - {"__version__"}:
        assert f'id="hubodo.{name}"' in python, name
    assert python.count("Raises") > 5
    commands = (site / "reference" / "command-line.html").read_text("utf-8")
    for verb in VERBS:
        assert f"usage: hubodo {verb}" in commands, verb


def test_a_readme_on_the_site_has_no_link_to_source_files(site):
    page = (site / "reference" / "effects.html").read_text("utf-8")
    assert "wheel_camber" in page
    assert not re.search(r'href="[^"#]*\.md', page)


@pytest.mark.repeat
def test_the_notebook_runs(tmp_path):
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(ROOT / "host" / "docs" / "notebook.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "store the notebook without outputs"
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}})
    client.execute()
    shown = [out["data"] for cell in notebook.cells for out in cell.get("outputs", ()) if "data" in out]
    assert sum("<svg" in data.get("text/html", "") for data in shown) == 4
    assert "wheel_camber" in shown[-2]["text/html"]
