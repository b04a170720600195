"""Files of a gap result: `gap.json`, the resulting model, and the page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError
from hubodo.gap.explain.page import gap_page
from hubodo.gap.explain.summary import describe_verdict, list_model_comments
from hubodo.gap.explain.terminal import GAP_FILES
from hubodo.model.model_text import model_toml
from hubodo.safe_text import json_text

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects


def check_gap_folder(output: Path, model: Path | None, *, replace: bool = True) -> None:
    """Raise InputError for a folder whose model.toml is not an earlier result; model: input file, or None.

    replace: an earlier result may be replaced.
    """
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; name a folder for {', '.join(GAP_FILES)}")
    model_file = output / "model.toml"
    if model is not None and model_file.exists() and model.exists() and model_file.samefile(model):
        raise InputError(f"{model_file}: is the input model; choose another folder with -o")
    if model_file.exists() and not (output / "gap.json").exists():
        raise InputError(f"{model_file}: exists and is not a result of gap; choose another folder with -o")
    if model_file.exists() and not replace:
        raise InputError(f"{model_file}: exists already; choose another name, or give --force to replace it")


def gap_file_contents(result: MissingEffects) -> dict[str, str]:
    """Return the text of each of `GAP_FILES`."""
    before, after = result.gap.before, result.gap.after
    head = [
        f"# {result.given} with what hubodo gap found in {result.log}: gap {before:.3f} → {after:.3f}.",
        f"# {describe_verdict(result)}",
    ]
    written = "\n".join(head) + "\n\n" + model_toml(result.model, list_model_comments(result, result.log))
    text = json_text(result.as_json(), indent=1, ascii_only=False)
    page = gap_page(result, written)
    return dict(zip(GAP_FILES, (text + "\n", written, page), strict=True))


def write_files(folder: Path, contents: Mapping[str, str]) -> None:
    """Write all files, or none if one fails; create the folder if it is missing."""
    with atomic_files(*(folder / name for name in contents), create_folder=True) as parts:
        for part, content in zip(parts, contents.values(), strict=True):
            part.write_text(content, "utf-8", "backslashreplace")
