"""Hook of mkdocs: draw equations, insert the help of the verbs and READMEs of the tree.

On a page `$$ … $$` becomes a drawing, `<!-- verbs -->` the help of every verb, `<!-- effects -->` the
meaning of every effect, `<!-- include PATH -->` the README of that path,
without its links into the tree, which is not on the site.
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
    """Return the Markdown of a page with equations, verbs and READMEs inserted."""
    markdown = _INCLUDE.sub(lambda match: _readme(ROOT / match[1]), markdown)
    markdown = _EQUATION.sub(lambda match: _equations(match[1]), markdown)
    if "<!-- effects -->" in markdown:
        markdown = markdown.replace("<!-- effects -->", _effects())
    return markdown.replace("<!-- verbs -->", _verbs() if "<!-- verbs -->" in markdown else "")


def on_post_page(output: str, **_: Any) -> str:
    """Return the page without the scripts for diagrams and TeX that notebooks load from the network."""
    return _FOREIGN.sub("", output)


def _readme(path: Path) -> str:
    text = path.read_text("utf-8")
    return _LINK.sub(r"\1", text.partition("\n")[2])


def _equations(lines: str) -> str:
    """Return a drawing of each line, one below the other, with its TeX source as alternative text."""
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
    # No empty line, as that would end the element in Markdown.
    body = re.sub(r"\n\s*\n", "\n", body.replace("#010203", "currentColor"))
    return body.replace("<svg ", f'<svg role="img" aria-label="{html.escape(tex)}" ', 1).strip()


def _effects() -> str:
    """Return a table of all effects: name, meaning, and how to tell it from one that looks alike."""
    from hubodo.effects import EFFECTS

    rows = []
    for effect in EFFECTS:
        advice = "; ".join(dict.fromkeys(effect.confusable_with.values()))
        rows.append(f"| `{effect.name}` | {effect.meaning} | {advice} |")
    return "\n".join(
        ["| effect | what it means | how to tell it from what looks alike |", "|---|---|---|", *rows]
    )


def _verbs() -> str:
    """Return a heading and the help of each verb."""
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
