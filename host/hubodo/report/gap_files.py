"""The files of a gap result: `gap.json`, the model with what was found, and the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError
from hubodo.gap.explain.result import GapResult
from hubodo.gap.explain.summary import describe_verdict, list_model_comments
from hubodo.model.model_file import model_toml
from hubodo.report.gap_page import gap_page
from hubodo.safe_text import json_text

FILES = ("gap.json", "model.toml", "report.html")


def gap_json(result: GapResult) -> dict[str, Any]:
    """What `gap.json` holds: numbers that are none are null."""
    made = plain(result.as_json())
    assert isinstance(made, dict)
    return made


def plain(value: Any) -> Any:
    """The same with None for numbers that are none."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_gap_folder(output: Path, model: Path | None) -> None:
    """Refuses a folder whose model.toml is not an earlier result; model: the file that is read, if any."""
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; name a folder for {', '.join(FILES)}")
    there = output / "model.toml"
    if model is not None and there.exists() and model.exists() and there.samefile(model):
        raise InputError(f"{there}: is the model that is read; name another folder with -o")
    if there.exists() and not (output / "gap.json").exists():
        raise InputError(f"{there}: exists and is no result of gap; name another folder with -o")


def gap_contents(result: GapResult, *, log: str, model: str) -> dict[str, str]:
    """The text of each of FILES; log, model: what they are called."""
    before, after = result.gap.before, result.gap.after
    head = [
        f"# {model} with what hubodo gap found in {log}: gap {before:.3f} → {after:.3f}.",
        f"# {describe_verdict(result)}",
    ]
    written = "\n".join(head) + "\n\n" + model_toml(result.model, list_model_comments(result, log))
    text = json_text(gap_json(result), indent=1, ascii_only=False)
    page = gap_page(result, log=log, model=model, written=written)
    return dict(zip(FILES, (text + "\n", written, page), strict=True))


def write_texts(folder: Path, contents: Mapping[str, str]) -> None:
    """All of them whole, or none; the folder is made where it is missing."""
    with atomic_files(*(folder / name for name in contents), create_folder=True) as parts:
        for part, content in zip(parts, contents.values(), strict=True):
            part.write_text(content, "utf-8", "backslashreplace")
