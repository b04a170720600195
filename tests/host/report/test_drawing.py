"""Matplotlib figures as SVG within a page and as files."""

import argparse
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.pages import drawing
from hubodo.pages.drawing import (
    add_legend_above,
    figure_to_svg,
    new_figure,
    parse_drawing_path,
    render_drawing,
    save_figure,
)
from hubodo.sensors.allan.figure import _plain_powers


def _figure(title: str = "bias & drift") -> object:
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [1.0, 2.0])
    axes.set_title(title)
    return figure


@pytest.mark.parametrize("name", ["a.png", "a.SVG", "folder.x/b.pdf"])
def test_the_suffix_gives_the_format(name: str) -> None:
    assert parse_drawing_path(name) == Path(name)


@pytest.mark.parametrize("name", ["a.jpg", "png", ".png", ""])
def test_another_suffix_is_refused_with_those_that_are_possible(name: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"name a file that ends in \.png, \.svg, \.pdf"):
        parse_drawing_path(name)


@pytest.mark.parametrize(("suffix", "magic"), [("png", b"\x89PNG"), ("PDF", b"%PDF"), ("svg", b"<?xml")])
def test_a_file_has_the_format_of_its_suffix_and_nothing_else_is_left_behind(
    tmp_path: Path, suffix: str, magic: bytes
) -> None:
    save_figure(_figure(), tmp_path / f"plot.{suffix}")
    assert (tmp_path / f"plot.{suffix}").read_bytes().startswith(magic)
    assert len(list(tmp_path.iterdir())) == 1


def test_an_svg_in_a_page_is_valid_scales_with_it_and_keeps_its_text() -> None:
    svg = figure_to_svg(_figure())
    root = ET.fromstring(svg)
    assert root.get("viewBox") == "0 0 288 216"
    assert root.get("width") is None and root.get("height") is None
    assert "bias &amp; drift" in svg
    assert "date" not in svg.lower()


def test_an_svg_is_the_same_in_each_run_and_its_ids_differ_from_those_of_another_figure() -> None:
    def ids(svg: str) -> set[str]:
        return {value for element in ET.fromstring(svg).iter() for value in [element.get("id")] if value}

    assert figure_to_svg(_figure()) == figure_to_svg(_figure())
    clips = [{it for it in ids(figure_to_svg(_figure(title))) if it.startswith("p")} for title in ("x", "y")]
    clips = [{it for it in names if not it.startswith("patch")} for names in clips]
    assert clips[0] and not clips[0] & clips[1]


def test_a_page_has_another_svg_for_phones_with_wrapped_labels_and_fewer_legend_columns() -> None:
    def draw() -> object:
        figure = new_figure(9.0, 3.0)
        axes = figure.subplots()
        for name in "abcdef":
            axes.plot([0.0, 1.0], [1.0, 2.0], label=f"a rather long name of curve {name}")
        axes.set_xlabel("time since power-on in minutes, with the residual of the exponential")
        add_legend_above(figure)
        return figure

    wide, narrow = render_drawing(draw).html.split('<div class="on-narrow">')
    assert wide.startswith('<div class="on-wide"><svg viewBox="0 0 648 216"')
    assert narrow.startswith('<svg viewBox="0 0 316.8 194.4"')
    label = "time since power-on in minutes, with the residual"
    assert label in wide and label not in narrow
    columns = [set(re.findall(r'x="([\d.]+)"[^>]*>a rather', svg)) for svg in (wide, narrow)]
    assert [len(places) for places in columns] == [3, 1]


def test_without_matplotlib_a_page_names_the_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> object:
        raise InputError(drawing._MATPLOTLIB_MISSING)

    html = render_drawing(fail).html
    assert html.startswith('<p class="dim">a figure needs matplotlib') and "<svg" not in html
    assert "matplotlib&gt;=3.8" in html
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"pip install 'matplotlib>=3\.8'"):
        new_figure(1.0, 1.0)


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (r"$\mathdefault{10^{-3}}$", "10⁻³"),
        (r"$\mathdefault{2\times10^{12}}$", "2×10¹²"),
        (r"$\mathdefault{10^{0}}$", "10⁰"),
        ("0.5", "0.5"),
    ],
)
def test_powers_of_ten_are_plain_text(formula: str, text: str) -> None:
    assert _plain_powers(formula) == text
