"""gap.json conforms to its published schema and has no further fields."""

import copy

import jsonschema
import pytest

from gap_runs import run_gap
from gap_schema import read_schema, validate_result
from hubodo.effects import BY_NAME
from hubodo.gap.explain.missing_effects import SCHEMA_VERSION


def test_the_schema_is_valid_and_has_the_current_version():
    jsonschema.Draft202012Validator.check_schema(read_schema())
    assert read_schema()["properties"]["version"] == {"const": SCHEMA_VERSION, "description": "of this form"}


def test_a_result_conforms_to_the_published_schema(camber_run):
    result = camber_run.result
    validate_result(result)
    assert result["finished"] is True
    assert result["found"]
    for finding in result["found"]:
        assert finding["effect"] in BY_NAME or finding["effect"].startswith("empirical:")
        assert finding["scope"] in ("left", "right", "all", "vehicle")
    gaps = [result["gap"]["before"], *(item["gap"]["after"] for item in result["found"])]
    assert [item["gap"]["before"] for item in result["found"]] == gaps[:-1]


def test_a_result_without_findings_conforms_too(clean_log, tmp_path):
    result = run_gap(tmp_path / "out", clean_log / "model.toml", clean_log).result
    validate_result(result)
    assert result["found"] == []
    assert result["verdict"] == "no_gap"


@pytest.mark.parametrize(
    "corrupt",
    [
        lambda result: result.pop("version"),
        lambda result: result.update(version=SCHEMA_VERSION + 1),
        lambda result: result.update(verdict="perhaps"),
        lambda result: result.update(beside=1),
        lambda result: result["gap"].pop("after"),
        lambda result: result["found"][0].update(confidence=1.5),
        lambda result: result["found"][0].update(runner_up="nobody"),
        lambda result: result["found"][0]["parameters"]["angle"].pop("unit"),
    ],
)
def test_a_corrupted_result_fails_validation(camber_run, corrupt):
    result = copy.deepcopy(camber_run.result)
    corrupt(result)
    with pytest.raises(jsonschema.ValidationError):
        validate_result(result)
