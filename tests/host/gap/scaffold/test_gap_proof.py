"""Held-out gaps with and without an effect, the test generated for a scaffolded effect."""

from hubodo.effects import BY_NAME
from hubodo.gap.scaffold.proof import held_out_gaps


def test_the_hidden_effect_reduces_the_held_out_gap_and_another_does_not(camber_case):
    folder, hidden = camber_case
    model = folder / "model.toml"
    gap_without, gap_with = held_out_gaps(folder, model, BY_NAME[hidden.name](), hidden.scope)
    _, gap_with_other = held_out_gaps(folder, model, BY_NAME["gyro_g_sensitivity"](), "left")
    assert gap_with < gap_without - 0.03 and gap_with < gap_with_other - 0.03
