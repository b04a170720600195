"""Playback of recordings reproduces the stored odometry bit by bit."""

import json
from copy import deepcopy
from functools import cache

import pytest
from recordings import REFERENCES, TABLE, TOLERANCE, TOLERANCE_ELSEWHERE, UPDATE, arithmetic, play, reference

END = "x, y, heading, distance"


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Return the result of playing one recording of TABLE, played once."""

    @cache
    def once(place):
        return reference(TABLE[place], play(TABLE[place], tmp_path_factory.mktemp("played")))

    return once


@pytest.mark.parametrize(
    "place",
    # The wheelchair takes longest and adds no other kind of input.
    [
        pytest.param(place, id=replay.name, marks=[pytest.mark.repeat] * (replay.name == "wheelchair"))
        for place, replay in enumerate(TABLE)
    ],
)
def test_playback_gives_the_stored_odometry_bit_by_bit(place, played):
    replay, references = TABLE[place], json.loads(REFERENCES.read_text())
    stored = references.get(replay.name)
    result = deepcopy(played(place))
    tolerance = TOLERANCE
    if references["arithmetic"] != arithmetic():
        tolerance = TOLERANCE_ELSEWHERE
        assert result[END] == pytest.approx(stored[END], rel=0, abs=TOLERANCE_ELSEWHERE)
        for fields in (result, stored):
            del fields[END]
            for topic in replay.outputs:
                del fields[topic]["sha256"]
    off = [field for field in result if stored is None or result[field] != stored.get(field)]
    assert not off, (
        f"{replay.name}: {', '.join(off)} differ (tolerance {tolerance}): stored {stored}, found {result}; "
        f"if intended, run {UPDATE}"
    )


def test_a_second_playback_gives_the_same_bits_and_another_drive_others(played, tmp_path):
    assert reference(TABLE[0], play(TABLE[0], tmp_path)) == played(0)
    assert played(3)["/odom"] != played(0)["/odom"]
