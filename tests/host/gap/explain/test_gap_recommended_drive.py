"""The drive that a page asks for does what its words say; every manoeuvre of the effects has one."""

from pathlib import Path

import numpy as np
import pytest

from hubodo.effects import EFFECTS
from hubodo.gap.explain.indistinguishable import INDISTINGUISHABLE_CAUSES
from hubodo.gap.explain.recommended_drive import _SEGMENTS_BY_KEYWORD, drive_figure, parse_manoeuvre

WAYS = sorted({direction for effect in EFFECTS for direction in effect.confusable_with.values()})


@pytest.mark.parametrize("words", WAYS)
def test_every_manoeuvre_of_the_effects_is_drawn(words):
    built = drive_figure(parse_manoeuvre(words))
    t, speed = built.data[0].x, np.asarray(built.data[0].y)
    assert speed[0] == speed[-1] == 0.0
    assert np.ptp(t) > 10.0


def test_turns_both_ways_are_turns_both_ways_and_two_speeds_are_two():
    yaw_rate = np.asarray(drive_figure(parse_manoeuvre("turn both ways at speed")).data[1].y)
    assert yaw_rate.max() > 20.0
    assert yaw_rate.min() < -20.0
    straight = drive_figure(parse_manoeuvre("drive at two speeds: a lever arm grows"))
    assert not np.any(straight.data[1].y)
    assert {1.0, 3.0} <= set(np.round(straight.data[0].y, 6))


def test_the_path_is_that_of_the_speed_and_the_turns():
    built = drive_figure(((10.0, 2.0, 0.0),))
    x, y = (np.asarray(getattr(built.data[2], axis)) for axis in "xy")
    assert x[-1] == pytest.approx(20.0, abs=0.2)
    assert not np.any(y)


def test_every_described_manoeuvre_is_used():
    assert [
        word
        for word in _SEGMENTS_BY_KEYWORD
        if not any(word in direction for direction in WAYS) and word != "longer"
    ] == []


def test_the_readme_lists_the_indistinguishable_effects():
    readme = (Path(__file__).parents[4] / "host/hubodo/gap/README.md").read_text("utf-8")
    for one, other, why in INDISTINGUISHABLE_CAUSES:
        assert f"| {one} | {other} | {why} |" in readme
