"""How the speed goes on from window to window: by what sound accelerometers feel, and by that alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import SPEED
from hubodo.fuse.wheel.prediction import Prediction
from hubodo.fuse.wheel.state import initial_state
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.window import WINDOW, Window

FORWARD = 0.4
# A wheel that stands with its node upright feels gravity along x, and 0.4 m/s² of braking along y.
SOUND = Window(
    spin=0.0,
    rate_start=0.0,
    rate_end=0.0,
    across=0j,
    carrier=WINDOW + 0j,
    force=(9.8 + 1j * FORWARD) * WINDOW,
    axial=0.0,
    raw_across=0j,
    raw_force=(9.8 + 1j * FORWARD) * WINDOW,
    axial_variance=0.05,
    swing=0.0,
    lever=0j,
)


def gained(joined: bool = True, part: bool = True, **flags: float) -> float:
    """m/s that the speed gained in a window."""
    begin = initial_state(WheelConfig(0.15, 0.5, {"left": WheelNode("left", "left")}))
    (wheel,) = begin.wheels
    wheel.joined, wheel.part = joined, part
    x, place = list(begin.x), begin.columns.vehicle[SPEED]
    pairs = ((wheel, SOUND._replace(**flags)),)
    noise = SimpleNamespace()
    Prediction(begin.columns, noise).predict(  # type: ignore[arg-type]
        x, np.array(begin.p), pairs, Stillness.MOVING, False, False, 1.0
    )
    return x[place] - begin.x[place]


def test_a_sound_accelerometer_carries_the_speed() -> None:
    assert gained() == pytest.approx(FORWARD * WINDOW)


@pytest.mark.parametrize(
    "unsound", [{"joined": False}, {"part": False}, {"missing": 0.01}, {"force_clipped": 0.01}]
)
def test_one_that_is_not_sound_carries_nothing(unsound: dict[str, float]) -> None:
    assert gained(**unsound) == 0.0  # type: ignore[arg-type]
