"""Scaffolding of a new effect."""

from hubodo.gap.explain.result import Estimate
from hubodo.gap.explain.scaffold import Scaffold


def test_text_and_json_of_a_scaffold_list_its_parameters():
    scaffold = Scaffold(
        "bent_axle",
        "left",
        "",
        "left.gx",
        {"gx_cos": Estimate(0.02, 0.001, "rad/s")},
        2.0,
        1.1,
        ("lever_arm",),
    )
    lines = scaffold.describe()
    assert lines[0] == "bent_axle (left): gx_cos 0.0200 ± 0.0010 rad/s"
    assert "gap 2.000 → 1.100" in lines[2] and lines[3] == "  it replaces lever_arm"
    assert scaffold.as_json()["parameters"] == {"gx_cos": {"value": 0.02, "sigma": 0.001, "unit": "rad/s"}}
