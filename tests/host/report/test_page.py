"""A page is self-contained: it loads nothing, its texts are escaped, and its figures are drawn."""

import re
from html.parser import HTMLParser

import numpy as np

from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.page import COLOURS, PageTable, Section, new_plotly_figure, render_page


class Links(HTMLParser):
    """Return every address that the markup itself would fetch."""

    def __init__(self):
        super().__init__()
        self.links = []

    def handle_starttag(self, tag, attrs):
        self.links += [value for key, value in attrs if key in ("src", "href")]


def test_nothing_is_fetched_and_text_is_escaped():
    built = new_plotly_figure("t", "v")
    built.add_scatter(x=[0, 1], y=[1, 2])
    text = render_page(
        "A <title>",
        "lead & more",
        [Section("one", "a < b", [PageTable(("h",), [("<script>x</script>",)])], [built])],
    )
    links = Links()
    links.feed(text)
    assert links.links == []
    assert "<title>A &lt;title&gt;</title>" in text
    assert "&lt;script&gt;x&lt;/script&gt;" in text
    assert not re.search(r"@import|url\(http", text.split("<script>")[0])


def test_a_folded_section_opens_by_its_title_and_figures_follow_the_colours_of_the_page():
    figure = draw_curves([Curve(np.arange(3.0), np.arange(3.0), "a", COLOURS["left"])], "x", "y")
    page = render_page("t", "l", [Section("closed", "text", figures=[figure], is_folded=True)])
    start, end = page.index("<details><summary><h2>closed</h2></summary>"), page.index("</details>")
    assert start < page.index("<svg") < end
    assert "stroke: var(--c1b6ca8, #1b6ca8)" in page and "--c1b6ca8: #62aee8" in page
