"""A calibration added to a model replaces the effects of its nodes."""

from hubodo.calibration.calibrated_model import add_calibration_to_model
from hubodo.calibration.file import CalibratedEffect, Calibration, Quantity
from hubodo.model.model_file import read_model

MODEL = """[vehicle]
wheel_radius = 0.2
track_width = 0.5
[imu]
gyro_noise = 0.004
accel_noise = 0.05
[nodes.left]
side = "left"
facing = "left"
[nodes.left.effects.gyro_bias]
z = 0.5
"""


def test_calibrated_effects_replace_those_of_the_model_and_unknown_nodes_are_reported(tmp_path):
    (tmp_path / "model.toml").write_text(MODEL)
    bias = {"gyro_bias": CalibratedEffect({"z": Quantity(0.01, 0.001)})}
    calibration = Calibration().with_node("left", bias).with_node("other", bias)
    model, notes = add_calibration_to_model(read_model(tmp_path / "model.toml"), calibration)
    (scoped,) = model.effects
    assert (scoped.effect.name, scoped.effect.values()["z"]) == ("gyro_bias", 0.01)
    assert len(notes) == 1 and notes[0].startswith("other: ")
