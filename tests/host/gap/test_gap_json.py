"""gap.json has the form that other programs read."""

import numbers

from hubodo.effects import BY_NAME

NUMBER = numbers.Real


def check(value, form, where="gap.json"):
    """value has the form: a type, {key: form}, [form of each], or a tuple of forms of which one must fit."""
    if isinstance(form, tuple):
        assert any(fits(value, one) for one in form), f"{where}: {value!r}"
    elif isinstance(form, dict):
        assert isinstance(value, dict), where
        for key, inner in form.items():
            assert key in value, f"{where}: {key} is missing"
            check(value[key], inner, f"{where}.{key}")
    elif isinstance(form, list):
        assert isinstance(value, list), where
        for k, item in enumerate(value):
            check(item, form[0], f"{where}[{k}]")
    else:
        assert isinstance(value, form), f"{where}: {value!r} is no {form}"
        assert not isinstance(value, bool), where


def fits(value, form):
    try:
        check(value, form)
    except AssertionError:
        return False
    return True


STEP = {"before": NUMBER, "after": NUMBER}
FORM = {
    "verdict": str,
    "gap": {**STEP, "floor": NUMBER},
    "held_out_gap": STEP,
    "found": [
        {
            "effect": str,
            "scope": str,
            "parameters": dict,
            "gap": STEP,
            "held_out_gap": STEP,
            "p_value": NUMBER,
            "confidence": NUMBER,
            "where": str,
            "runner_up": (type(None), {"effect": str, "confidence": NUMBER}),
            "inseparable_from": [str],
        }
    ],
    "remaining": [{"channel": str, "where": str, "looks_like": str}],
}
VERDICTS = ("no_gap", "explained", "partly_explained", "unexplained")


def test_the_result_has_the_fixed_form(named):
    made = named.result
    check(made, FORM)
    assert made["verdict"] in VERDICTS
    assert made["found"]
    for found in made["found"]:
        assert found["effect"] in BY_NAME or found["effect"].startswith("empirical:")
        assert found["scope"] in ("left", "right", "all", "vehicle")
        assert 0.0 <= found["p_value"] <= 1.0
        assert 0.0 <= found["confidence"] <= 1.0
        for parameter in found["parameters"].values():
            check(parameter, {"value": NUMBER, "sigma": (NUMBER, type(None))})
    before = [made["gap"]["before"], *(it["gap"]["after"] for it in made["found"])]
    assert [it["gap"]["before"] for it in made["found"]] == before[:-1]
