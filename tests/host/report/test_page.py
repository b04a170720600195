"""A page opens alone: no request leaves it, what is in it is escaped, and its figures are drawn."""

import re
from html.parser import HTMLParser

from hubodo.pages.page import PageTable, Section, new_plotly_figure, render_page


class Links(HTMLParser):
    """Every address that the markup itself would fetch."""

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
