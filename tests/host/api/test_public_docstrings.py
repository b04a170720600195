"""Each public name has a NumPy-style docstring with all required sections and parameters."""

import dataclasses
import inspect
import re

import pytest

import hubodo

PUBLIC = sorted(set(hubodo.__all__) - {"__version__"})
HEADING = re.compile(r"^(\w+)\n-{3,}$", re.MULTILINE)


def sections(public_object) -> dict[str, str]:
    """Return the text of each section by its heading, with "" for the text before the first heading."""
    text = inspect.getdoc(public_object) or ""
    parts = HEADING.split(text)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries(section: str) -> set[str]:
    """Return the names that a section documents: lines without indent, up to a colon, split at commas."""
    lines = [line for line in section.splitlines() if line and not line.startswith(" ")]
    return {name.strip() for line in lines for name in line.partition(" :")[0].replace("*", "").split(",")}


def missing_sections(name: str) -> list[str]:
    public_object = getattr(hubodo, name)
    if not inspect.isclass(public_object):
        return missing_of_function(name, public_object)
    lacking = [] if sections(public_object)[""].strip() else [f"{name}: a docstring"]
    if dataclasses.is_dataclass(public_object):
        documented = entries(sections(public_object).get("Attributes", ""))
        fields = {field.name for field in dataclasses.fields(public_object) if not field.name.startswith("_")}
        lacking += [f"{name}: Attributes {field}" for field in sorted(fields - documented)]
    for key, member in vars(public_object).items():
        if not key.startswith("_") and isinstance(member, property):
            lacking += [] if inspect.getdoc(member) else [f"{name}.{key}: a docstring"]
        elif not key.startswith("_") and inspect.isfunction(member):
            lacking += missing_of_function(f"{name}.{key}", member)
    return lacking


def missing_of_function(name: str, function) -> list[str]:
    parts, signature = sections(function), inspect.signature(function)
    lacking = [] if parts[""].strip() else [f"{name}: a docstring"]
    parameters = set(signature.parameters) - {"self", "cls"}
    lacking += [f"{name}: Parameters {p}" for p in sorted(parameters - entries(parts.get("Parameters", "")))]
    if signature.return_annotation not in (None, "None", inspect.Signature.empty) and "Returns" not in parts:
        lacking.append(f"{name}: Returns")
    if re.search(r"^\s+raise \w", inspect.getsource(function), re.MULTILINE) and "Raises" not in parts:
        lacking.append(f"{name}: Raises")
    return lacking


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_has_all_required_sections(name):
    assert missing_sections(name) == []


def test_missing_sections_are_detected():
    def area(width: float, height: float) -> float:
        """Return the area.

        Parameters
        ----------
        width : float
            m.
        """
        if width < 0.0:
            raise ValueError(width)
        return width * height

    assert missing_of_function("area", area) == ["area: Parameters height", "area: Returns", "area: Raises"]
