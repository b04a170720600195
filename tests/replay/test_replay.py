"""Recordings through the odometry again: to the last bit what the stored references say."""

import json

import pytest
from recordings import ELSEWHERE, REFERENCES, TABLE, TOLERANCE, UPDATE, arithmetic, play, reference

END = "x, y, heading, distance"


@pytest.mark.parametrize("replay", TABLE, ids=lambda replay: replay.name)
def test_playing_a_recording_gives_the_stored_odometry_bit_for_bit(replay, tmp_path):
    references = json.loads(REFERENCES.read_text())
    stored = references.get(replay.name)
    found = reference(replay, play(replay, tmp_path))
    tolerance = TOLERANCE
    if references["arithmetic"] != arithmetic():
        tolerance = ELSEWHERE
        assert found[END] == pytest.approx(stored[END], rel=0, abs=ELSEWHERE)
        for fields in (found, stored):
            del fields[END]
            for topic in replay.outputs:
                del fields[topic]["sha256"]
    off = [field for field in found if stored is None or found[field] != stored.get(field)]
    assert not off, (
        f"{replay.name}: {', '.join(off)} differ (tolerance {tolerance}): stored {stored}, found {found}; "
        f"if that is meant, run {UPDATE}"
    )


def test_a_second_run_gives_the_same_bits_and_another_drive_others(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    (tmp_path / "c").mkdir()
    first, other = TABLE[0], TABLE[3]
    once = reference(first, play(first, tmp_path / "a"))
    assert reference(first, play(first, tmp_path / "b")) == once
    assert reference(other, play(other, tmp_path / "c"))["/odom"] != once["/odom"]
