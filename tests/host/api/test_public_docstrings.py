"""Each public name has a NumPy-style docstring with the sections that it needs, and each argument in them."""

import dataclasses
import inspect
import re

import pytest

import hubodo

PUBLIC = sorted(set(hubodo.__all__) - {"__version__"})
HEADING = re.compile(r"^(\w+)\n-{3,}$", re.MULTILINE)


def sections(thing) -> dict[str, str]:
    """The text of each section by its heading, "" for what stands before the first."""
    text = inspect.getdoc(thing) or ""
    parts = HEADING.split(text)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}


def entries(section: str) -> set[str]:
    """The names that a section documents: its lines without indent, before a colon, split at commas."""
    lines = [line for line in section.splitlines() if line and not line.startswith(" ")]
    return {name.strip() for line in lines for name in line.partition(" :")[0].replace("*", "").split(",")}


def missing(name: str) -> list[str]:
    thing = getattr(hubodo, name)
    if not inspect.isclass(thing):
        return missing_of_function(name, thing)
    lacking = [] if sections(thing)[""].strip() else [f"{name}: a docstring"]
    if dataclasses.is_dataclass(thing):
        documented = entries(sections(thing).get("Attributes", ""))
        fields = {field.name for field in dataclasses.fields(thing) if not field.name.startswith("_")}
        lacking += [f"{name}: Attributes {field}" for field in sorted(fields - documented)]
    for key, member in vars(thing).items():
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
def test_a_public_name_has_the_sections_that_it_needs(name):
    assert missing(name) == []


def test_a_missing_section_is_noticed():
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
