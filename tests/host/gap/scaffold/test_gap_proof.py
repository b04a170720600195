"""The test that a scaffolded effect carries with it."""

from hubodo.effects import BY_NAME
from hubodo.gap.scaffold.proof import held_out_gaps


def test_the_hidden_effect_reduces_the_held_out_gap_and_another_does_not(camber):
    folder, hidden = camber
    model = folder / "model.toml"
    without, with_it = held_out_gaps(folder, model, BY_NAME[hidden.name](), hidden.scope)
    _, with_other = held_out_gaps(folder, model, BY_NAME["gyro_g_sensitivity"](), "left")
    assert with_it < without - 0.03 and with_it < with_other - 0.03
