"""The push over a tape, on wheel rates in closed form."""

import math

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.fuse.push_check import check_push
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle


def pushed(
    distance: float, radius: float, *, sign: float = 1.0, bias: float = 0.02, quiet: float = 2.0
) -> Recording:
    """Return a log of one wheel that rolls a distance at a speed of half a cosine wave, at rest around it."""
    t = np.arange(0.0, 2.0 * quiet + 4.0, 0.01)
    phase = np.clip((t - quiet) / 4.0, 0.0, 1.0)
    speed = distance / 4.0 * (1.0 - np.cos(2.0 * math.pi * phase)) * (phase > 0) * (phase < 1)
    noise = 0.002 * np.random.default_rng(4).standard_normal(len(t))
    columns = dict.fromkeys(("gx", "gy", "ax", "ay", "az"), np.zeros(len(t)))
    return Recording({"left": Table({"t": t, **columns, "gz": sign * speed / radius + 0.02 + noise})})


def vehicle(radius: float, facing: str = "left") -> Vehicle:
    return Vehicle(radius, 0.55, {"left": NodeMount("left", facing)})


@pytest.mark.parametrize(
    ("in_file", "facing", "sign", "problem"),
    [
        (0.165, "left", 1.0, ""),
        (0.165, "right", -1.0, ""),
        (0.33, "left", 1.0, "diameter"),
        (0.2, "left", 1.0, "1.21 times"),
        (0.165, "right", 1.0, "facing is wrong"),
    ],
)
def test_a_push_gives_the_radius_and_names_what_the_file_has_wrong(in_file, facing, sign, problem):
    (push,) = check_push(pushed(2.0, 0.165, sign=sign), vehicle(in_file, facing), 2.0, "log")
    assert abs(abs(push.angle) - 2.0 / 0.165) < 0.05
    assert abs(push.radius - 0.165) < 3 * push.sigma < 0.01
    assert (problem in push.problem) and bool(push.problem) == bool(problem)


@pytest.mark.parametrize(
    ("log", "problem"),
    [
        (pushed(2.0, 0.165, quiet=0.0), "stand"),
        (pushed(0.01, 0.165), "push further"),
        (Recording({"body": pushed(2.0, 0.165).nodes["left"]}), "no wheel node"),
    ],
)
def test_a_log_that_shows_no_push_is_refused(log, problem):
    with pytest.raises(InputError, match=problem):
        check_push(log, vehicle(0.165), 2.0, "log")
