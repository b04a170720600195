"""The schema of gap.json and strict validation against it."""

import json
from importlib import resources

import jsonschema


def schema():
    """Read the schema of gap.json that comes with the package."""
    text = resources.files("hubodo.gap.explain").joinpath("gap.schema.json").read_text("utf-8")
    return json.loads(text)


def strict(made):
    """Return a schema that also refuses fields it does not name."""
    if isinstance(made, dict):
        made = {key: strict(value) for key, value in made.items()}
        if "properties" in made and isinstance(made["properties"], dict):
            made.setdefault("additionalProperties", False)
    return [strict(item) for item in made] if isinstance(made, list) else made


def check(result):
    """Raise ValidationError if a result does not have exactly the form of the schema."""
    jsonschema.Draft202012Validator(strict(schema())).validate(result)
