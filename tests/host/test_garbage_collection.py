"""Garbage collection during long computations."""

from __future__ import annotations

import gc

import pytest

from hubodo.errors import InputError
from hubodo.fuse import fusion
from hubodo.garbage_collection import rare_garbage_collection
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle


@pytest.mark.parametrize(("before", "during"), [(700, 100_000), (200_000, 200_000), (0, 0)])
def test_the_search_for_garbage_is_rare_only_inside_and_stays_disabled(before: int, during: int) -> None:
    original = gc.get_threshold()
    try:
        gc.set_threshold(before, 10, 10)
        with pytest.raises(ZeroDivisionError), rare_garbage_collection():
            assert gc.get_threshold() == (during, 10, 10)
            _ = 1 / 0
        assert gc.get_threshold() == (before, 10, 10)
    finally:
        gc.set_threshold(*original)


def test_a_recording_is_fused_with_rare_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    def check_units(*_: object) -> None:
        raise InputError(f"{gc.get_threshold()[0]}")

    monkeypatch.setattr(fusion, "check_units", check_units)
    with pytest.raises(InputError, match=r"^100000$"):
        fusion.fuse_recording(Recording({}), Vehicle(0.3, 1.0), log="drive.mcap")
