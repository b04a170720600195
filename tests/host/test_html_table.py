"""HTML tables escape the texts of logs."""

from hubodo.html_table import html_lines, html_table


def test_cells_and_lines_are_escaped():
    assert html_table(("a",), [("<b>",)]).count("<b>") == 0
    assert html_lines(["<b>", "x"]) == "<p>&lt;b&gt;</p><p>x</p>"


def test_numbers_are_right_aligned_and_words_left():
    text = html_table(("name", "value", "note"), [("a", "+0.12 ± 0.03", "1 of 2"), ("b", "", "3 m")])
    assert text.count('<td class="number">') == 2
    assert '<td class="text">1 of 2</td>' in text and "data-label" not in text
    # A number with its unit is text that stays on one line on a wide screen.
    assert '<td class="text quantity">3 m</td>' in text


def test_a_table_without_headings_has_no_empty_row_and_text_on_the_left():
    text = html_table(("", ""), [("seed", "1")])
    assert "<thead>" not in text and '<td class="text">1</td>' in text


def test_each_cell_of_a_wide_table_names_its_column_for_narrow_screens():
    text = html_table("abcde", ["12345"])
    assert text.startswith('<table class="wide">') and '<td class="number" data-label="e">5</td>' in text


def test_three_columns_with_a_sentence_are_wide_and_two_are_not():
    sentence = "the mean over t has a standard deviation of N/√t, the integral one of N·√t"
    assert 'data-label="meaning"' in html_table(("term", "value", "meaning"), [("N", "0.5", sentence)])
    assert "data-label" not in html_table(("term", "meaning"), [("N", sentence)])
