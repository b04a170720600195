"""HTML tables escape the texts of logs."""

from hubodo.html_table import html_lines, html_table


def test_cells_and_lines_are_escaped():
    assert html_table(("a",), [("<b>",)]).count("<b>") == 0
    assert html_lines(["<b>", "x"]) == "<p>&lt;b&gt;</p><p>x</p>"
