"""The wheel filter on a real wheelchair with 18° of camber; the gyro of the frame is the reference."""

import numpy as np
import pytest

import wanted
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import TRACK_WIDTH
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.log.csv_folder import read_folder
from repetitions import first_and_more


@pytest.mark.parametrize("names", first_and_more((("left", "right"),), (("left",),), (("right",),)))
@pytest.mark.parametrize("lag", [0.0, np.inf])
def test_the_heading_from_wheels_equals_that_of_the_frame_gyro(names: tuple[str, ...], lag: float) -> None:
    recording = read_folder(wanted.recording("wheelchair"))
    frame = recording.nodes["frame"]
    rate = frame["gz"]
    reference = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(frame.t))])
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    # The track width was not measured: 0.92 m within 5 %.
    run = run_wheel_filter(
        WheelConfig(0.31, 0.92, nodes, priors={TRACK_WIDTH: Quantity(0.0, 0.05)}), recording.nodes, lag
    )
    error = np.degrees(run.track.heading - np.interp(run.track.t, frame.t, reference))
    error -= error[0]
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert abs(error[-1]) < 2.0
    # Camber is equal on both wheels; the scale error of a spin gyro is below 1.5 %.
    for name in names:
        effects = run.report.nodes[name]
        assert np.degrees(effects["wheel_camber"]["angle"].value) == pytest.approx(18.5, abs=1.5)
        assert abs(effects["gyro_scale_factor"]["z"].value) < 0.015
    if len(names) == 2:
        width = 0.92 * (1.0 + run.report.vehicle["track_width"]["error"].value)
        assert width == pytest.approx(0.91, abs=0.03)
