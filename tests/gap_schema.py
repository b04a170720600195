"""The schema of gap.json and strict validation against it."""

import json
from importlib import resources

import jsonschema


def read_schema():
    """Read the schema of gap.json that comes with the package."""
    text = resources.files("hubodo.gap.explain").joinpath("gap.schema.json").read_text("utf-8")
    return json.loads(text)


def forbid_extra_fields(node):
    """Return a copy of a schema that refuses fields it does not name."""
    if isinstance(node, dict):
        node = {key: forbid_extra_fields(value) for key, value in node.items()}
        if "properties" in node and isinstance(node["properties"], dict):
            node.setdefault("additionalProperties", False)
    return [forbid_extra_fields(item) for item in node] if isinstance(node, list) else node


def validate_result(result):
    """Raise ValidationError if a result does not have exactly the form of the schema."""
    jsonschema.Draft202012Validator(forbid_extra_fields(read_schema())).validate(result)
