"""What the documentation's pages take from elsewhere: equations as drawings, verbs, READMEs of rooms.

mkdocs calls it. On a page `$$ … $$` becomes a drawing, `<!-- verbs -->` the help of every verb, and
`<!-- include PATH -->` the README of that path, without its links into the tree, which is not on the site.
"""

from __future__ import annotations

import html
import io
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_EQUATION = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)
_INCLUDE = re.compile(r"^<!-- include (\S+) -->$", re.MULTILINE)
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!https?:)[^)]+\)")
_FOREIGN = re.compile(
    r"<script(?: [^>]*)?>(?:(?!</script>).)*(?:mermaid|MathJax)(?:(?!</script>).)*</script>", re.DOTALL
)
_SIZE = 12.0


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page's text with all of it in place."""
    markdown = _INCLUDE.sub(lambda found: _readme(ROOT / found[1]), markdown)
    markdown = _EQUATION.sub(lambda found: _equations(found[1]), markdown)
    return markdown.replace("<!-- verbs -->", _verbs() if "<!-- verbs -->" in markdown else "")


def on_post_page(output: str, **_: Any) -> str:
    """Without the scripts from the net that a notebook brings along for diagrams and TeX; it has none."""
    return _FOREIGN.sub("", output)


def _readme(path: Path) -> str:
    text = path.read_text("utf-8")
    return _LINK.sub(r"\1", text.partition("\n")[2])


def _equations(lines: str) -> str:
    """A drawing of each line, beside one another in height; what TeX says of it is its text."""
    drawn = "\n".join(f"<div>{_drawing(line.strip())}</div>" for line in lines.splitlines())
    return f'<div class="equation">\n{drawn}\n</div>'


def _drawing(tex: str) -> str:
    import matplotlib as mpl
    from matplotlib.mathtext import math_to_image

    out = io.StringIO()
    with mpl.rc_context({"mathtext.fontset": "cm", "font.size": _SIZE, "svg.hashsalt": tex}):
        math_to_image(f"${tex}$".replace(r"\frac", r"\dfrac"), out, format="svg", color="#010203")
    text = out.getvalue()
    body = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # No empty line: to Markdown it would end the element.
    body = re.sub(r"\n\s*\n", "\n", body.replace("#010203", "currentColor"))
    return body.replace("<svg ", f'<svg role="img" aria-label="{html.escape(tex)}" ', 1).strip()


def _verbs() -> str:
    """A heading and the help of each verb."""
    from hubodo.cli import build_parser
    from hubodo.verbs import VERBS

    parts = []
    for verb, does in VERBS.items():
        parser = build_parser([verb])
        (commands,) = (action for action in parser._actions if action.dest == "verb")
        assert isinstance(commands.choices, dict)
        text = commands.choices[verb].format_help()
        parts.append(f"## {verb}\n\n{does[0].upper()}{does[1:]}.\n\n```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts)
