"""gap.json has the form that its schema publishes, and nothing beside it."""

import copy

import jsonschema
import pytest

from gap_runs import gap
from gap_schema import check, schema
from hubodo.effects import BY_NAME
from hubodo.gap.explain.result import SCHEMA_VERSION


def test_the_schema_is_one_and_of_this_version():
    jsonschema.Draft202012Validator.check_schema(schema())
    assert schema()["properties"]["version"] == {"const": SCHEMA_VERSION, "description": "of this form"}


def test_a_result_has_the_published_form(named):
    made = named.result
    check(made)
    assert made["finished"] is True
    assert made["found"]
    for found in made["found"]:
        assert found["effect"] in BY_NAME or found["effect"].startswith("empirical:")
        assert found["scope"] in ("left", "right", "all", "vehicle")
    before = [made["gap"]["before"], *(it["gap"]["after"] for it in made["found"])]
    assert [it["gap"]["before"] for it in made["found"]] == before[:-1]


def test_a_result_without_a_finding_has_it_too(nothing, tmp_path):
    made = gap(tmp_path / "out", nothing / "model.toml", nothing).result
    check(made)
    assert made["found"] == []
    assert made["verdict"] == "no_gap"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda made: made.pop("version"),
        lambda made: made.update(version=SCHEMA_VERSION + 1),
        lambda made: made.update(verdict="perhaps"),
        lambda made: made.update(beside=1),
        lambda made: made["gap"].pop("after"),
        lambda made: made["found"][0].update(confidence=1.5),
        lambda made: made["found"][0].update(runner_up="nobody"),
        lambda made: made["found"][0]["parameters"]["angle"].pop("unit"),
    ],
)
def test_what_has_another_form_is_refused(named, spoil):
    made = copy.deepcopy(named.result)
    spoil(made)
    with pytest.raises(jsonschema.ValidationError):
        check(made)
