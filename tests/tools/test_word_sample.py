"""`tools/word_sample.py` draws the same names and texts for the same seed."""

import ast

import word_sample

SOURCE = '''"""Module text."""

LIMIT = 3  # m


class Track:
    """A track."""

    n: int

    def length(self, start, *, end):
        """Return the length."""

    def _private(self):
        # Why it is so,
        # in two lines.
        pass
'''


def test_public_names_are_classes_functions_with_arguments_fields_and_constants():
    names = [name for _, name in word_sample.public_names(ast.parse(SOURCE))]
    assert names == ["LIMIT = 3", "class Track", "Track.n = ...", "def Track.length(start, end)"]


def test_texts_are_docstrings_and_comments_with_successive_lines_as_one():
    texts = [text for _, text in word_sample.texts(SOURCE, ast.parse(SOURCE))]
    assert texts == [
        "Module text.",
        "A track.",
        "Return the length.",
        "LIMIT = 3  # m",
        "Why it is so, in two lines.",
    ]


def test_the_same_seed_draws_the_same_sample(capsys, monkeypatch):
    def drawn(seed):
        monkeypatch.setattr("sys.argv", ["word_sample.py", "--seed", str(seed), "--under", "tools"])
        assert word_sample.main() == 0
        return capsys.readouterr().out

    assert drawn(3) == drawn(3) != drawn(4)
