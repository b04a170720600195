"""Quantities of a verb's result."""

from hubodo.fleet.quantities import MISSING_EFFECT_PREFIX, LogQuantity, extract_quantities


def test_an_effect_found_by_gap_is_a_quantity_with_its_p_value_and_parameters():
    finding = {
        "scope": "left",
        "effect": "gyro_bias",
        "confidence": 0.99,
        "p_value": 1e-4,
        "parameters": {"z": {"value": 0.02, "sigma": 1e-3, "unit": "rad/s"}},
    }
    result = {"gap": {"before": 3.0, "after": 1.1}, "found": [finding]}
    quantities = extract_quantities("gap", result)
    assert LogQuantity("left", MISSING_EFFECT_PREFIX + "gyro_bias", 0.99, p_value=1e-4) in quantities
    assert LogQuantity("left", "gyro_bias.z", 0.02, 1e-3, "rad/s") in quantities
    assert LogQuantity("", "gap.after", 1.1) in quantities


def test_values_that_are_not_numbers_are_omitted():
    result = {"distance": 12.5, "truth": {"final_percent": 0.4, "note": None}}
    assert [quantity.quantity for quantity in extract_quantities("fuse", result)] == [
        "distance",
        "truth.final_percent",
    ]


def test_each_error_of_a_track_has_its_unit():
    truth = {"final_error": 0.1, "final_percent": 0.4, "heading_rms": 0.01, "rotation": 0.002}
    quantities = extract_quantities("fuse", {"distance": 12.5, "truth": truth})
    assert [quantity.unit for quantity in quantities] == ["m", "m", "%", "rad", "rad"]
